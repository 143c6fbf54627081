"""Style of figures, saving, and figures of recordings."""
