"""Forces in wind to drag coefficients."""
