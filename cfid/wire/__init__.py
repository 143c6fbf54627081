"""Bytes and counts to records: no clock, no port, no thread."""
