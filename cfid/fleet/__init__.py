"""Compare and refit many campaigns."""
