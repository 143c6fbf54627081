"""Recordings that other programs made: each kind of file to named channels in SI units."""
