"""Sensors watched, doubted and replaced: learnt from healthy readings, lowered to driver operations."""
