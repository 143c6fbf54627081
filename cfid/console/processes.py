"""Starts cfid in a process of its own, without importing from the working directory."""

import sys


def cfid_command(*words: str) -> list[str]:
    """Return the command line of `cfid` with these arguments.

    A campaign may hold a file such as queue.py, which Python would import in place of its own module without -P.
    """
    return [sys.executable, "-P", "-m", "cfid.cli.main", *words]
