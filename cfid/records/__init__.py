"""The files on disk: campaigns and rig.toml, run folders, parameters.toml, fits, and CSV tables of any origin."""
