"""Every parameter once: its key, unit, shape, symbol, title, what gives it and which values are plausible."""
