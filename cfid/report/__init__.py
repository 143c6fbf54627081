"""Figures and pages drawn from recordings, fits and parameters."""
