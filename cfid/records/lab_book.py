"""The lab book of runs: operator, battery, propellers, temperature, from rig.toml and from notes with `key=value`."""

import re
from collections import Counter
from collections.abc import Sequence

from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.records.run import Run, RunHeader

_KEY = re.compile(r"\s*[a-z][a-z_0-9]*\s*", re.IGNORECASE)


def entries(header: RunHeader) -> dict[str, str]:
    """Return a run's entries by key: those of rig.toml at the time, overridden by those of the run's note.

    A note may have several, separated by semicolons: `battery=B3; operator=Kim`. The last one for a key counts.
    """
    book = header.rig.lab_book.model_dump(exclude_none=True)
    stated = {key: f"{value:g}" if isinstance(value, float) else str(value) for key, value in book.items()}
    return stated | dict(_entries(header.label.note or ""))


def check(note: str) -> None:
    """Raise ConfigError for a key or a value without the other."""
    for part in note.split(";"):
        key, equals, value = part.partition("=")
        if equals and not key.strip():
            raise ConfigError(f"{part.strip()}: has no key: write KEY=VALUE, as in battery=B3.")
        if _KEY.fullmatch(key) and equals and not value.strip():
            raise ConfigError(
                f"{key.strip()}=: has no value: write {key.strip()}=VALUE. An empty text in place of the whole note "
                "removes all notes of a run."
            )


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
        f"{key}: " + ", ".join(f"{value} ({counted(count, 'run')})" for value, count in values.items())
        for key, values in book.items()
    ]


def _entries(note: str) -> list[tuple[str, str]]:
    parts = [part.partition("=") for part in note.split(";")]
    return [
        (key.strip().lower(), value.strip())
        for key, equals, value in parts
        if equals and _KEY.fullmatch(key) and value.strip()
    ]
