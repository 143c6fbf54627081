"""Dropped weights to Coulomb and viscous friction of the swing's axis."""
