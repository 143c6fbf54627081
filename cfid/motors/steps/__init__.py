"""How fast rotors follow steps of the command."""
