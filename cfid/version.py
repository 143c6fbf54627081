"""The version of cfid, in a module that imports nothing, so that every module may import it."""

__version__ = "0.2.0"
