"""Machines that never existed: recordings from terms and from heat conduction."""
