"""Sine runs: planned, recorded, and put on one time base."""
