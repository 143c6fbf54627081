"""Many campaigns side by side."""
