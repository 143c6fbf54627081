"""Parse swings on the command line: AXIS=FILE, known axis inertias, and numbers of peaks."""

from collections.abc import Sequence

from cfid.console.inputs import Workplace, read_recording, split_label
from cfid.errors import ConfigError
from cfid.recordings.angle import AxisRecord, labelled
from cfid.records.choose import Matches
from cfid.swing.data import FIXTURE, KnownInertia


def read_swings(words: Sequence[str], workplace: Workplace, suits: Matches) -> list[AxisRecord | KnownInertia]:
    """Read AXIS=FILE, AXIS=NUMBER, AXIS=NUMBER:STD, fixture=FILE, or a RUN whose label has the axis.

    `suits` describes the runs among which `last` is.

    Raises ConfigError for numbers that are not an inertia.
    """
    return [_swing(word, workplace, suits) for word in words]


def _swing(word: str, workplace: Workplace, suits: Matches) -> AxisRecord | KnownInertia:
    label, rest = split_label(word, workplace)
    if label and (known := _known_inertia(label, rest)):
        return known
    record = read_recording(rest, workplace, suits)
    if label == FIXTURE:
        return labelled(record, body=FIXTURE)
    return labelled(record, axis=label) if label else record


def _known_inertia(name: str, text: str) -> KnownInertia | None:
    value, colon, std = text.partition(":")
    try:
        numbers = float(value), float(std) if colon else 0.0
    except ValueError:
        return None
    return KnownInertia(name, *numbers)


def parse_peaks(text: str | None) -> int | dict[str, int] | None:
    """Return the number of peaks for all axes, or for each: one number, or `x=11,z=16`.

    Raises ConfigError when it is neither.
    """
    if text is None:
        return None
    try:
        if "=" not in text:
            return int(text)
        pairs = (part.split("=") for part in text.split(","))
        return {axis.strip(): int(count) for axis, count in pairs}
    except ValueError:
        raise ConfigError(f"`peaks` {text}: expected a number, or AXIS=NUMBER,AXIS=NUMBER,...") from None
