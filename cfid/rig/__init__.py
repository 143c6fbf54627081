"""Real devices: opens ports, records what they send into runs, and reports what is wrong with them."""
