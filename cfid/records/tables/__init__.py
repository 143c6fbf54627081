"""Readers of CSV files into arrays in SI units: columns found by name, times checked, faults named by line."""
