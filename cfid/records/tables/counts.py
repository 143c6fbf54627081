"""Convert a column of counts, degrees or radians to a continuous angle."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.records.tables.table import Array, CsvTable
from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, WORD_COUNTS_PER_TURN, decode_words

CountsPerTurn = float | str
Counts = npt.NDArray[np.int64]
Rows = npt.NDArray[np.intp]

_FAILED_SHARE = 0.01  # of 13-bit words that may fail their check
_JUMP_SHARE = 0.01  # of samples that may jump
_JUMP_RAD = np.pi / 2  # between two samples; at half a turn the direction is ambiguous
_LOOKED_AT = 500  # samples whose way shows a swing
_LEAST_SWING_DEG, _TO_AND_FRO = 20.0, 2.5  # range of a swing in degrees, more than radians can be; its way over that
_FOLDED_TURNS = 1.5  # range of an angle that may be wrapped into one turn, with margin for a wrong scale
_EXACT = 2.0**53  # above it, counts lose their last digits; no axis turns that far
_SHORTER_WORD = 1 << 18  # a 22-bit encoder that stays below may as well be one of fewer bits


class Angle(NamedTuple):
    """A continuous angle (n,), its rows in the table (n,), and notes."""

    angle_rad: Array
    rows: Rows
    notes: tuple[str, ...]


def continuous_angle(
    table: CsvTable, column: str, values: Array, *, unit: str | None, counts_per_turn: CountsPerTurn | None
) -> Angle:
    """Read a column's values (n,) as an angle; whole numbers without a unit are counts.

    Raises DataError when the unit or the counts per turn cannot be determined, when too many words fail their check,
    and when samples are too far apart to count whole turns.
    """
    farthest = int(np.argmax(np.abs(values)))
    if abs(values[farthest]) >= _EXACT:
        line = table.line_of_row(farthest)
        raise DataError(
            f"{table.path}:{line}: {values[farthest]:.6g} in column '{column}' is not an angle. Delete that line."
        )
    whole = bool(np.all(values == np.round(values)))
    if unit is None and (whole or counts_per_turn is not None):
        unit = "counts"
    notes: tuple[str, ...] = ()
    if unit is None:
        unit = _unit_by_range(values)
        notes = (f"column '{column}' is read in {unit}, by its range of {np.ptp(values):.4g} (`angle_unit`).",)
    if unit is None:
        raise DataError(
            f"{table.path}: column '{column}' names no unit, is not whole counts, and its range of "
            f"{np.ptp(values):.4g} may be radians or degrees: give `angle_unit` rad or deg."
        )
    if unit != "counts":
        turns = values / (360.0 if unit == "deg" else 2 * np.pi)
        return _joined(table, turns, np.arange(len(values)), notes)
    if not whole:
        raise DataError(
            f"{table.path}: column '{column}' is read as counts but has fractions: give `angle_unit` rad or deg."
        )
    return _from_counts(table, counts_per_turn, values.astype(np.int64))


def _unit_by_range(values: Array) -> str | None:
    """Return the unit of angles (n,): radians within half a turn, degrees to and fro over more, else None."""
    span = float(np.ptp(values))
    if np.abs(values).max() <= np.pi:
        return "rad"
    way = float(np.abs(np.diff(values[:: max(len(values) // _LOOKED_AT, 1)])).sum())
    return "deg" if span > _LEAST_SWING_DEG and way > _TO_AND_FRO * span else None


def _from_counts(table: CsvTable, setting: CountsPerTurn | None, counts: Counts) -> Angle:
    position, valid = decode_words(counts)
    notes: tuple[str, ...] = ()
    if setting is None:
        setting = _guessed(table, counts, valid)
        name = setting if isinstance(setting, str) else f"{setting:.0f}"
        notes = (f"counts are read as `counts_per_turn` {name}.",)
    if setting != RLS_13BIT_IN_22:
        turns = counts / float(setting)
        if np.ptp(turns) > _FOLDED_TURNS and np.mean(valid) > 0.5:
            raise DataError(
                f"{table.path}: counts reach {counts.max()} and pass the check of a 13-bit word in 22 bits, but "
                f"{float(setting):.0f} counts per turn are set: give `counts_per_turn` {RLS_13BIT_IN_22}."
            )
        return _joined(table, turns, np.arange(len(counts)), notes)
    failed = np.flatnonzero(~valid)
    if len(failed) > _FAILED_SHARE * len(counts):
        raise DataError(
            f"{table.path}: {len(failed)} of {len(counts)} samples fail the check of a 13-bit word in 22 bits, more "
            f"than {100 * _FAILED_SHARE:g} %: a loose cable, or another encoder (`counts_per_turn` N, e.g. 4194304)."
        )
    if len(failed):
        line = table.line_of_row(int(failed[0]))
        notes += (
            f"{len(failed)} of {len(counts)} samples fail the 13-bit check (first: line {line}) and are left out.",
        )
    rows = np.flatnonzero(valid)
    return _joined(table, position[rows] / STEPS_PER_TURN, rows, notes)


def _guessed(table: CsvTable, counts: Counts, valid: npt.NDArray[np.bool_]) -> CountsPerTurn:
    """Infer the counts per turn from the counts, where only one answer is possible."""
    # A word passes its check by chance once in 512: a file in which most pass is of that kind.
    if np.mean(valid) > 0.5:
        return RLS_13BIT_IN_22
    if counts.min() < 0 or not _SHORTER_WORD <= counts.max() < WORD_COUNTS_PER_TURN:
        raise DataError(
            f"{table.path}: counts range from {counts.min()} to {counts.max()}, which does not show "
            "the counts per turn: give `counts_per_turn` N, or `angle_unit` if these are not counts."
        )
    return float(WORD_COUNTS_PER_TURN)


def _joined(table: CsvTable, turns: Array, rows: Rows, notes: tuple[str, ...]) -> Angle:
    """Return the continuous angle of turns (n,) that may be wrapped into one."""
    angle = 2 * np.pi * turns
    low, high = np.percentile(turns, (1, 99))  # a few wrong readings must not make it look unwrapped
    if high - low <= _FOLDED_TURNS:
        angle = np.unwrap(angle)
        jumps = np.flatnonzero(np.abs(np.diff(angle)) > _JUMP_RAD) + 1
    else:  # whole turns were counted: a fast rotation is fine, a sudden change of speed is not
        jumps = np.flatnonzero(np.abs(np.diff(angle, n=2)) > _JUMP_RAD) + 2
    if not len(jumps):
        return Angle(angle, rows, notes)
    line = table.line_of_row(int(rows[jumps[0]]))
    what = f"the angle jumps by more than a quarter of a turn in {len(jumps)} of {len(turns)} samples"
    if len(jumps) > _JUMP_SHARE * len(turns):
        raise DataError(
            f"{table.path}:{line}: {what}, here first: a wrong `counts_per_turn` or `angle_unit`, a bad cable, or too "
            "fast for this rate. Whole turns cannot be counted."
        )
    return Angle(angle, rows, (*notes, f"{what} (first: line {line}); whole turns may be miscounted from there on."))
