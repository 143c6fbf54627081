"""The procedure of a staircase: commands held one after the other, with or without readings by an operator."""
