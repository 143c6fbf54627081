"""Swings as a command names them: recordings with their mounts, and axis inertias already known."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.inputs import Workplace, read_recording
from cfid.console.options import positive
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.records.tables.angle import AngleRecord, Reading

FIXTURE = "fixture"


@dataclass(frozen=True)
class KnownInertia:
    """An axis inertia given as a number, `x=3.12e-05:4e-08`."""

    name: str
    value_kg_m2: float
    std_kg_m2: float


@dataclass(frozen=True)
class Named:
    """A recording and the name it goes by: a mount, or grams."""

    name: str
    record: "AngleRecord"


def read_swings(
    words: Sequence[str], reading: "Reading", workplace: Workplace, *, body: str
) -> list[Named | KnownInertia]:
    """Read AXIS=FILE, AXIS=NUMBER, AXIS=NUMBER:DEVIATION, or a RUN whose label says axis and body.

    A run labelled as the empty fixture is the fixture's swing, whatever its axis.

    Raises ConfigError for a word that is none of these, and for a run of another body; DataError for a run
    without an axis.
    """
    found: list[Named | KnownInertia] = []
    for word in words:
        name, equals, rest = word.partition("=")
        if not equals or Path(word).exists():
            name, rest = "", word
        elif known := _known_inertia(name, rest):
            found.append(known)
            continue
        record = read_recording(rest, reading, workplace)
        found.append(Named(_axis(record, name, rest, body), record))
    return found


def check_mounts(names: Iterable[str], mounts: Mapping[str, object], *, table: str) -> None:
    """Check that every name is a mount.

    Raises ConfigError naming the mounts there are.
    """
    for name in names:
        if name not in mounts:
            there = ", ".join(mounts) or "none"
            raise ConfigError(f"'{name}' is no mount of this rig.toml (it has: {there}): add [{table}.{name}].")


def _known_inertia(name: str, text: str) -> KnownInertia | None:
    value, colon, std = text.partition(":")
    try:
        known = KnownInertia(name, float(value), float(std) if colon else 0.0)
    except ValueError:
        return None
    positive(known.value_kg_m2, f"{name}=")
    if not 0 <= known.std_kg_m2 < float("inf"):
        raise ConfigError(f"{name}={text}: a standard deviation is a number of zero or more.")
    return known


def _axis(record: "AngleRecord", name: str, word: str, body: str) -> str:
    """Return the mount a recording was swung on: the name given, else its label."""
    label = record.label
    if label.body == FIXTURE:
        return FIXTURE
    if label.body is not None and label.body != body and name != FIXTURE:
        raise ConfigError(f"{word}: is labelled as a swing of the {label.body}, not of the {body}.")
    if not name and label.axis is None:
        raise DataError(f"{word}: does not say its axis: write AXIS={word}.")
    return name or label.axis or ""
