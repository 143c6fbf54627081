"""A column of counts, degrees or radians as a continuous angle: what a turn is, and how turns are joined."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.records.tables.table import Array, Table
from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, WORD_COUNTS_PER_TURN, decode_words

CountsPerTurn = float | str
Counts = npt.NDArray[np.int64]
Rows = npt.NDArray[np.intp]

_FAILED_SHARE = 0.01  # of 13-bit words that may fail their check
_JUMP_SHARE = 0.01  # of samples that may jump
_JUMP_RAD = np.pi / 2  # from a sample to the next: half a turn could go either way
_FOLDED_TURNS = 1.5  # range of an angle that may have been folded into one turn, with room for a wrong scale
_EXACT = 2.0**53  # beyond, counts lose their last digits; no axis turns that far
_SHORTER_WORD = 1 << 18  # a 22-bit encoder that never gets beyond may as well be one of fewer bits


class Angle(NamedTuple):
    """A continuous angle (n,), the rows of the table it stands in (n,), and what is to be said about it."""

    angle_rad: Array
    rows: Rows
    said: tuple[str, ...]


def continuous_angle(
    table: Table, column: str, values: Array, *, unit: str | None, counts_per_turn: CountsPerTurn | None
) -> Angle:
    """Read a column's values (n,) as an angle; whole numbers without a unit are counts.

    Raises DataError when the unit or the counts of a turn cannot be told, when too many words fail their check,
    and when samples lie too far apart to count whole turns.
    """
    farthest = int(np.argmax(np.abs(values)))
    if abs(values[farthest]) >= _EXACT:
        line = table.line_of_row(farthest)
        raise DataError(f"{table.path}:{line}: {values[farthest]:.6g} in column '{column}' is no angle. Cut that line.")
    whole = bool(np.all(values == np.round(values)))
    if unit is None and (whole or counts_per_turn is not None):
        unit = "counts"
    if unit is None:
        raise DataError(
            f"{table.path}: column '{column}' does not say its unit, and whole counts it is not: "
            "say --angle-unit rad|deg."
        )
    if unit != "counts":
        turns = values / (360.0 if unit == "deg" else 2 * np.pi)
        return _joined(table, turns, np.arange(len(values)), ())
    if not whole:
        raise DataError(
            f"{table.path}: column '{column}' is read as counts but has fractions: say --angle-unit rad|deg."
        )
    return _from_counts(table, counts_per_turn, values.astype(np.int64))


def _from_counts(table: Table, setting: CountsPerTurn | None, counts: Counts) -> Angle:
    position, valid = decode_words(counts)
    said: tuple[str, ...] = ()
    if setting is None:
        setting = _guessed(table, counts, valid)
        name = setting if isinstance(setting, str) else f"{setting:.0f}"
        said = (f"counts are read as --counts-per-turn {name}.",)
    if setting != RLS_13BIT_IN_22:
        turns = counts / float(setting)
        if np.ptp(turns) > _FOLDED_TURNS and np.mean(valid) > 0.5:
            raise DataError(
                f"{table.path}: counts run up to {counts.max()} and pass the check of a 13-bit word in 22 bits, where "
                f"{float(setting):.0f} counts make a turn: say --counts-per-turn {RLS_13BIT_IN_22}."
            )
        return _joined(table, turns, np.arange(len(counts)), said)
    failed = np.flatnonzero(~valid)
    if len(failed) > _FAILED_SHARE * len(counts):
        raise DataError(
            f"{table.path}: {len(failed)} of {len(counts)} samples fail the check of a 13-bit word in 22 bits, more "
            f"than {100 * _FAILED_SHARE:g} %: a loose cable, or another encoder (--counts-per-turn N, e.g. 4194304)."
        )
    if len(failed):
        line = table.line_of_row(int(failed[0]))
        said += (
            f"{len(failed)} of {len(counts)} samples fail the 13-bit check (first: line {line}) and are left out.",
        )
    rows = np.flatnonzero(valid)
    return _joined(table, position[rows] / STEPS_PER_TURN, rows, said)


def _guessed(table: Table, counts: Counts, valid: npt.NDArray[np.bool_]) -> CountsPerTurn:
    """Tell from the counts what a turn is, where they leave one answer only."""
    # A word passes its check by chance once in 512: a file in which most pass is of that kind.
    if np.mean(valid) > 0.5:
        return RLS_13BIT_IN_22
    if counts.min() < 0 or not _SHORTER_WORD <= counts.max() < WORD_COUNTS_PER_TURN:
        raise DataError(
            f"{table.path}: counts run from {counts.min()} to {counts.max()}, from which a turn cannot be told: say "
            "--counts-per-turn N, or --angle-unit if these are no counts."
        )
    return float(WORD_COUNTS_PER_TURN)


def _joined(table: Table, turns: Array, rows: Rows, said: tuple[str, ...]) -> Angle:
    """Return the continuous angle of turns that may have been folded into one."""
    angle = 2 * np.pi * turns
    low, high = np.percentile(turns, (1, 99))  # a few wrong readings must not make it look unfolded
    if high - low <= _FOLDED_TURNS:
        angle = np.unwrap(angle)
        jumps = np.flatnonzero(np.abs(np.diff(angle)) > _JUMP_RAD) + 1
    else:  # whole turns were counted: it may turn fast, but not of a sudden
        jumps = np.flatnonzero(np.abs(np.diff(angle, n=2)) > _JUMP_RAD) + 2
    if not len(jumps):
        return Angle(angle, rows, said)
    line = table.line_of_row(int(rows[jumps[0]]))
    what = f"the angle jumps by more than a quarter of a turn in {len(jumps)} of {len(turns)} samples"
    if len(jumps) > _JUMP_SHARE * len(turns):
        raise DataError(
            f"{table.path}:{line}: {what}, here first: a wrong --counts-per-turn or --angle-unit, a bad cable, or too "
            "fast for this rate. Whole turns cannot be counted."
        )
    return Angle(angle, rows, (*said, f"{what} (first: line {line}); whole turns may be miscounted from there on."))
