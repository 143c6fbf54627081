"""What lies on disk: campaigns and rig.toml, run folders, parameters.toml, fits, and tables that anyone wrote."""
