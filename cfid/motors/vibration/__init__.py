"""Rotor speed estimated from the vibration of a load cell."""
