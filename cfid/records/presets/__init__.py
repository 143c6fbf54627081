"""Commented rig.toml files that come with cfid."""
