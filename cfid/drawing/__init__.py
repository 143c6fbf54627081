"""Style of figures, panels, saving, and recordings drawn as they came."""
