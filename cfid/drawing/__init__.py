"""The style of figures, their files, and figures of recordings."""
