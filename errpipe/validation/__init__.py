"""Validation: ISO 230-2 figures, cross-validation over groups, champion against challenger, plausibility, drift."""
