"""Fitting: from a recording and a list of terms to parameters with confidence intervals."""
