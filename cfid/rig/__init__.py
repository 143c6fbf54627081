"""Real devices: opens ports, records what they send into runs, and says what is wrong with them."""
