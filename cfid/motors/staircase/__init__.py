"""The procedure of a staircase: commands held one after the other, with or without an operator who reads."""
