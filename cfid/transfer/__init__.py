"""Sines of many frequencies to the transfer function of motor and rotor."""
