"""Thermal machines nobody tuned for: families are fitted on two seasons, the third judges."""
