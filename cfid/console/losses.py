"""What a recording lost, by kind, as the summary at its end has it."""

from collections.abc import Mapping
from typing import Any

from cfid.counted import counted

_ONE = {  # loss of a kind of which run.toml has the plural
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
    """Return the counts of a device's losses in parentheses, "" where nothing is lost."""
    kinds = ((count, kind.replace("_", " ")) for kind, count in device["kinds"].items() if count)
    counts = [counted(count, _ONE.get(kind, kind), kind) for count, kind in kinds]
    if device["gaps"]:
        counts.append(counted(device["gaps"], "gap"))
    return f" ({', '.join(counts)})" if counts else ""
