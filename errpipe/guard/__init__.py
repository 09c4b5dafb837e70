"""Sensor guard: monitors, rejects and replaces temperature readings; learnt from healthy ones, lowered to drivers."""
