"""Provide what fits share: propagation, least squares, spectra, steady segments. Arrays in, numbers out."""
