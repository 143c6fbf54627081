"""Arrays in, fits out: pure functions that neither print nor plot."""
