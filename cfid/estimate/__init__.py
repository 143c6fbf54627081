"""What every fit shares: propagation, least squares, spectra, steady segments. Arrays in, numbers out."""
