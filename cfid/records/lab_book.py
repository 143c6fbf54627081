"""The lab book of runs: operator, battery, propellers, temperature, from rig.toml and from notes with `key=value`."""

import re
from collections import Counter
from collections.abc import Sequence
from difflib import get_close_matches

from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.records.rig_file import LabBook
from cfid.records.run import Run, RunHeader

_KNOWN = tuple(LabBook.model_fields)
_COLDEST_C, _WARMEST_C = -90.0, 60.0  # of air on Earth
_SHORTEST = 4  # letters that a key needs to count as the beginning of a known one
_ENTRY = re.compile(r"\s*([a-z][a-z_0-9]*)\s*=\s*(\S.*?)\s*", re.IGNORECASE)
_WITHOUT_VALUE = re.compile(r"\s*([a-z][a-z_0-9]*)\s*=\s*", re.IGNORECASE)


def entries(header: RunHeader) -> dict[str, str]:
    """Return a run's entries by key: those of rig.toml at the time, overridden by those of the run's note.

    A note may have several, separated by semicolons: `battery=B3; operator=Kim`. The last one for a key counts.
    """
    stated = {key: f"{value:g}" if isinstance(value, float) else str(value) for key, value in _stated(header).items()}
    return stated | dict(_entries(header.label.note or ""))


def check(note: str) -> None:
    """Raise ConfigError for a key or value without the other, an impossible air temperature or a misspelt key."""
    for part in note.split(";"):
        if empty := _WITHOUT_VALUE.fullmatch(part):
            raise ConfigError(
                f"{empty[1]}=: has no value: write {empty[1]}=VALUE. An empty text in place of the whole note removes "
                "all notes of a run."
            )
        if part.lstrip().startswith("="):
            raise ConfigError(f"{part.strip()}: has no key: write KEY=VALUE, as in battery=B3.")
    for key, value in _entries(note):
        if key == "temperature_c" and not _is_temperature(value):
            raise ConfigError(
                f"temperature_c={value}: should be a number of degrees Celsius from {_COLDEST_C:g} to {_WARMEST_C:g}, "
                "as in temperature_c=22.5."
            )
        if key not in _KNOWN and (meant := _meant(key)):
            raise ConfigError(
                f"{key}={value}: do you mean {meant}? The lab book knows {', '.join(_KNOWN)}; a key of your own should "
                "be less like these."
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
    found = [_ENTRY.fullmatch(part) for part in note.split(";")]
    return [(entry[1].lower(), entry[2]) for entry in found if entry]


def _meant(key: str) -> str:
    """Return the known key that a key resembles or is the beginning of, "" for none."""
    begun = [known for known in _KNOWN if len(key) >= _SHORTEST and known.startswith(key)]
    return next(iter(begun or get_close_matches(key, _KNOWN, n=1)), "")


def _is_temperature(value: str) -> bool:
    try:
        return _COLDEST_C <= float(value) <= _WARMEST_C
    except ValueError:
        return False


def _stated(header: RunHeader) -> dict[str, object]:
    return header.rig.lab_book.model_dump(exclude_none=True)
