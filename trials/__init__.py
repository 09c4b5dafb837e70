"""Sealed blind trials of the diagnosis: cases are drawn, the answers hashed, the cases diagnosed, then opened."""
