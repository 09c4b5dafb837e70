"""Simulated machines: recordings from terms and from heat conduction."""
