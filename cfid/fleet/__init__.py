"""Compare many campaigns."""
