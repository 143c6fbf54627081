"""A whole campaign on the simulated rig, compared with its truth."""
