"""Wind runs: planned, recorded, and reduced to one force a command."""
