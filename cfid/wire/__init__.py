"""Encodes and decodes what devices send and receive; no clock, no port, no thread."""
