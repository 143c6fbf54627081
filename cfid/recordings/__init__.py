"""Recordings of any origin, as columns with units, times and typed facts."""
