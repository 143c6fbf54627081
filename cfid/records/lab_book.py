"""The lab book of runs: operator, battery, propellers, temperature, from rig.toml and from notes with `key=value`."""

import re
from collections import Counter
from collections.abc import Sequence

from cfid.records.run import Run, RunHeader

_ENTRY = re.compile(r"\s*([a-z][a-z_0-9]*)\s*=\s*(\S.*?)\s*", re.IGNORECASE)


def entries(header: RunHeader) -> dict[str, str]:
    """Return a run's entries by key: those of rig.toml at the time, and over them those of its note, the last first.

    A note may have several, with semicolons between: `battery=B3; operator=Kim`.
    """
    stated = {key: f"{value:g}" if isinstance(value, float) else str(value) for key, value in _stated(header).items()}
    found = [_ENTRY.fullmatch(part) for part in (header.label.note or "").split(";")]
    return stated | {entry[1].lower(): entry[2] for entry in found if entry}


def summary(runs: Sequence[Run]) -> dict[str, dict[str, int]]:
    """Return how many runs have each value of each key."""
    counts: dict[str, Counter[str]] = {}
    for run in runs:
        for key, value in entries(run.header).items():
            counts.setdefault(key, Counter())[value] += 1
    return {key: dict(values) for key, values in counts.items()}


def lines(book: dict[str, dict[str, int]]) -> list[str]:
    """Return a summary as text: "battery: B3 (12 runs), B4 (1 run)"."""
    return [
        f"{key}: " + ", ".join(f"{value} ({count} run{'s' * (count != 1)})" for value, count in values.items())
        for key, values in book.items()
    ]


def _stated(header: RunHeader) -> dict[str, object]:
    return header.rig.lab_book.model_dump(exclude_none=True)
