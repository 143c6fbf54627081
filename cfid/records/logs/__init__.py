"""Read recordings that other programs made: each kind of file becomes named channels in SI units."""
