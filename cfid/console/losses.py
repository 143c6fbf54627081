"""The losses of a recording, by kind, as its summary shows them."""

from collections.abc import Mapping
from typing import Any

from cfid.counted import counted

_ONE = {  # the singular of each kind that run.toml names in the plural
    "duplicates": "duplicate",
    "malformed datagrams": "malformed datagram",
    "foreign datagrams": "foreign datagram",
    "datagrams dropped by this computer": "datagram dropped by this computer",
    "garbled replies": "garbled reply",
    "late replies": "late reply",
    "device errors": "device error",
    "polls without position": "poll without position",
    "lines that do not match": "line that does not match",
}


def counts_of(device: Mapping[str, Any]) -> str:
    """Return the counts of a device's losses in parentheses, or "" where nothing is lost."""
    kinds = ((count, kind.replace("_", " ")) for kind, count in device["kinds"].items() if count)
    counts = [counted(count, _ONE.get(kind, kind), kind) for count, kind in kinds]
    if device["gaps"]:
        counts.append(counted(device["gaps"], "gap"))
    return f" ({', '.join(counts)})" if counts else ""
