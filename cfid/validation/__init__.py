"""Validate parameter sets on a recorded flight that none of them was fitted to."""
