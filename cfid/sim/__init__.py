"""Simulated devices over plants that integrate their own physics, sharing no code with the analysis."""
