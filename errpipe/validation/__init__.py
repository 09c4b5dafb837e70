"""Whether to believe it: ISO 230-2 figures, cross-validation over groups, champion against challenger, drift."""
