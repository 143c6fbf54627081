"""Motors on the stand: staircases recorded, maps, steps, rotor speed from vibration."""
