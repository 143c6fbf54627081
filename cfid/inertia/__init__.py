"""Swings about six axes or more to the inertia matrix; the test body against its drawing."""
