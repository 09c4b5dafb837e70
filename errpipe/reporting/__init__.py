"""Figures and self-contained HTML pages from plain results; equal results give equal bytes."""
