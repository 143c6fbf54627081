"""Dropped weights as a command names them: recordings with their grams."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.inputs import Workplace, read_recording
from cfid.console.options import positive
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.records.tables.angle import AngleRecord, Reading


def read_weights(words: Sequence[str], reading: "Reading", workplace: Workplace) -> list[tuple[float, "AngleRecord"]]:
    """Read GRAMS=FILE, or a RUN whose label says its weight; return grams and recordings.

    Raises ConfigError for what is no weight, DataError for a run without one.
    """
    found = []
    for word in words:
        name, equals, rest = word.partition("=")
        if not equals or Path(word).exists():
            name, rest = "", word
        record = read_recording(rest, reading, workplace)
        if not name and record.label.weight_g is None:
            raise DataError(f"{word}: does not say its weight in grams: write GRAMS={word}.")
        found.append((_grams(name) if name else record.label.weight_g or 0.0, record))
    return found


def _grams(text: str) -> float:
    try:
        return positive(float(text), "GRAMS=")
    except ValueError:
        raise ConfigError(f"'{text}' is no weight in grams: write GRAMS=FILE.") from None
