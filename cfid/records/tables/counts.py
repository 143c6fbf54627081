"""Convert a column of counts, degrees or radians to a continuous angle."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.large import differences, empty, joined, parts
from cfid.records.tables.lone import MOST_SHARE, displaced_readings, lone_readings, usual_bend
from cfid.records.tables.table import Array, CsvTable
from cfid.wire.rls import RLS_13BIT_IN_22, STEPS_PER_TURN, WORD_COUNTS_PER_TURN, decode_words

CountsPerTurn = float | str
Rows = npt.NDArray[np.intp]

_FAILED_SHARE = 0.01  # of 13-bit words that may fail their check
_JUMP_SHARE = 0.01  # of samples that may jump
_JUMP_RAD = np.pi / 2  # between two samples; at half a turn the direction is ambiguous
# A reading that is off alone is off by this angle, and by so many times the bend that this share of the record does not
# exceed. One in a hundred causes three bends in a hundred; a swing in a twentieth of the record still counts as usual.
_LONE_RAD, _LONE_TIMES, _USUAL = 0.1, 3.0, 0.95
_LOOKED_AT = 500  # samples whose path shows a swing
_LEAST_SWING_DEG, _TO_AND_FRO = 20.0, 2.5  # range of a swing in degrees, more than in radians; its path over that
_LEAST_SWING_RAD = 1.0  # range; in a smaller one, the periods of radians and of degrees agree within a few per cent
_FOLDED_TURNS = 1.5  # range of an angle that may be wrapped into one turn, with margin for a wrong scale
_RANKED, _FEW_WRONG = 1_000_000, (0.5, 99.5)  # samples whose percentiles show the range
_POLLED_ROWS = 10_000  # which are enough to recognise most polled files
_MOST_READ = 0.5  # of rows may differ from the one before where the others repeat a reading
_FEW_REPEATED, _EDGES_SHARE = 0.1, 0.95  # share of repeats among an encoder's edges, at most; share of steps by one
_EXACT = 2.0**53  # above it, counts lose their last digits; no axis turns that far
_SHORTER_WORD = 1 << 18  # counts that stay below may also be those of an encoder with fewer bits


class Angle(NamedTuple):
    """A continuous angle (n,), its rows in the table (n,), or None for all rows, and notes."""

    angle_rad: Array
    rows: Rows | None
    notes: tuple[str, ...]


def is_angle(values: Array) -> npt.NDArray[np.bool_]:
    """Return which values (n,) may be angles in some unit, counts included."""
    found = np.empty(len(values), bool)
    for part in parts(len(values)):
        found[part] = np.abs(values[part]) < _EXACT
    return found


def continuous_angle(
    table: CsvTable,
    column: str,
    values: Array,
    *,
    unit: str | None,
    counts_per_turn: CountsPerTurn | None,
    rig_counts_per_turn: CountsPerTurn | None = None,
) -> Angle:
    """Read a column's values (n,) as an angle; whole numbers without a unit are counts.

    `counts_per_turn` is given for this file; without it, `rig_counts_per_turn`, that of the rig's encoder, is used.

    Raises DataError when the unit or the counts per turn cannot be determined, when too many words fail their check,
    and when samples are too far apart to count whole turns.
    """
    low, high, whole = _seen(values)
    if max(-low, high) >= _EXACT:
        farthest = int(np.argmin(values)) if -low > high else int(np.argmax(values))
        line = table.line_of_row(farthest)
        raise DataError(
            f"{table.path}:{line}: {values[farthest]:.6g} in column '{column}' is not an angle. Delete that line."
        )
    if unit is None and (whole or counts_per_turn is not None):
        unit = "counts"
    notes: tuple[str, ...] = ()
    if unit is None:
        unit, span = _unit_by_range(values)
        notes = (f"column '{column}' is read in {unit}, by its range of {span:.4g} (`angle_unit`).",)
        if unit is None:
            raise DataError(
                f"{table.path}: column '{column}' names no unit, is not whole counts, and its range of "
                f"{span:.4g} may be radians or degrees: give `angle_unit` rad or deg."
            )
    if unit != "counts":
        if counts_per_turn is not None:
            notes += (f"`counts_per_turn` is not used: column '{column}' is in {unit}.",)
        return _joined(table, _turns(values, 360.0 if unit == "deg" else 2 * np.pi), None, notes)
    if not whole:
        raise DataError(
            f"{table.path}: column '{column}' is read as counts but has fractions: give `angle_unit` rad or deg."
        )
    if counts_per_turn is None and rig_counts_per_turn is not None:
        angle = _from_counts(table, rig_counts_per_turn, values, low, high)
        assumed = f"counts are read as rig.toml's `counts_per_turn` {_shown(rig_counts_per_turn)}."
        return angle._replace(notes=(*notes, assumed, *angle.notes))
    return _from_counts(table, counts_per_turn, values, low, high)


def _seen(values: Array) -> tuple[float, float, bool]:
    """Return the lowest and the highest of values (n,), and whether all are whole numbers."""
    whole = all(bool(np.all(values[part] == np.rint(values[part]))) for part in parts(len(values)))
    return float(values.min()), float(values.max()), whole


def _turns(values: Array, per_turn: float) -> Array:
    turns = empty(len(values))
    return np.divide(values, per_turn, out=turns)


def _unit_by_range(values: Array) -> tuple[str | None, float]:
    """Return the unit of angles (n,), and their range without a few wrong readings.

    Values up to pi with a wide swing are radians; larger ones that go to and fro are degrees. The unit is None where
    neither holds.
    """
    low, high = np.percentile(values[:: len(values) // _RANKED + 1], _FEW_WRONG)
    span = float(high - low)
    if max(-low, high) <= np.pi:
        return "rad" if span > _LEAST_SWING_RAD else None, span
    way = float(np.abs(np.diff(values[:: max(len(values) // _LOOKED_AT, 1)].clip(low, high))).sum())
    return "deg" if span > _LEAST_SWING_DEG and way > _TO_AND_FRO * span else None, span


def _shown(setting: CountsPerTurn) -> str:
    return setting if isinstance(setting, str) else f"{setting:.0f}"


def _from_counts(table: CsvTable, setting: CountsPerTurn | None, counts: Array, low: float, high: float) -> Angle:
    """Read whole numbers (n,) between `low` and `high` as an angle."""
    valid = np.concatenate([decode_words(counts[part].astype(np.int64)).valid for part in parts(len(counts))])
    notes: tuple[str, ...] = ()
    if setting is None:
        setting = _guessed(table, int(low), int(high), valid)
        notes = (f"counts are read as `counts_per_turn` {_shown(setting)}.",)
    if setting != RLS_13BIT_IN_22:
        if (high - low) / float(setting) > _FOLDED_TURNS and np.mean(valid) > 0.5:
            raise DataError(
                f"{table.path}: counts reach {high:.0f} and pass the check of a 13-bit word in 22 bits, but "
                f"{float(setting):.0f} counts per turn are set: give `counts_per_turn` {RLS_13BIT_IN_22}."
            )
        if (edges := _at_edges(counts, float(setting))) is None:
            return _joined(table, _turns(counts, float(setting)), None, notes)
        at, rows = edges
        repeats = (
            f"; {counted(len(counts) - len(rows), 'row')} without a change left out" if rows.size < len(counts) else ""
        )
        text = f"rows are changes of the count by one: angles are those of the edges, between two counts{repeats}."
        return _joined(table, _turns(at, float(setting)), rows, (*notes, text))
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
    turns = joined(
        decode_words(counts[part].astype(np.int64)).position[valid[part]] / STEPS_PER_TURN
        for part in parts(len(counts))
    )
    return _joined(table, turns, np.flatnonzero(valid) if len(failed) else None, notes)


def _at_edges(counts: Array, per_turn: float) -> tuple[Array, Rows] | None:
    """Return the counts (m,) of the edges where a row was written at each change, and the rows of these edges (m,).

    None for polled counts. An edge lies half a count before the count that was reached. A polled swing repeats most
    counts where it turns; among rows of edges only few repeat one, as at rest, and few edges are lost. Motion in one
    direction shows neither, and needs no edges.
    """
    if np.mean(np.diff(counts[:_POLLED_ROWS]) == 0) > _FEW_REPEATED:
        return None
    up = down = by_one = 0
    for part in parts(len(counts)):
        steps = _steps(counts, part, per_turn)
        up += int(np.count_nonzero(steps > 0))
        down += int(np.count_nonzero(steps < 0))
        by_one += int(np.count_nonzero(np.abs(steps) == 1))
    moved = up + down
    if not (up and down) or moved < (1 - _FEW_REPEATED) * len(counts) or by_one < _EDGES_SHARE * moved:
        return None
    rows = np.concatenate([part.start + np.flatnonzero(_steps(counts, part, per_turn)) for part in parts(len(counts))])
    return joined(_edges(counts, part, per_turn) for part in parts(len(counts))), rows


def _edges(counts: Array, part: slice, per_turn: float) -> Array:
    steps = _steps(counts, part, per_turn)
    moved = steps != 0
    return np.asarray(counts[part][moved] - 0.5 * np.sign(steps[moved]))


def _steps(counts: Array, part: slice, per_turn: float) -> Array:
    """Return how many counts each row of a part (m,) moved from the row before, the shorter way around."""
    before = counts[part.start - 1] if part.start else 2 * counts[0] - counts[1]
    return np.asarray((np.diff(counts[part], prepend=before) + per_turn / 2) % per_turn - per_turn / 2)


def _guessed(table: CsvTable, low: int, high: int, valid: npt.NDArray[np.bool_]) -> CountsPerTurn:
    """Infer the counts per turn from the counts, where only one answer is possible."""
    # A word passes its check by chance once in 512: a file in which most pass is of that kind.
    if np.mean(valid) > 0.5:
        return RLS_13BIT_IN_22
    if low < 0 or not _SHORTER_WORD <= high < WORD_COUNTS_PER_TURN:
        raise DataError(
            f"{table.path}: counts range from {low} to {high}, which does not show "
            "the counts per turn: give `counts_per_turn` N, or `angle_unit` if these are not counts."
        )
    return float(WORD_COUNTS_PER_TURN)


def _joined(table: CsvTable, turns: Array, rows: Rows | None, notes: tuple[str, ...]) -> Angle:
    """Return the continuous angle of turns (n,) that may be wrapped into one turn; `turns` is overwritten."""
    some = turns[:: len(turns) // _RANKED + 1]
    low, high = np.percentile(some, (1, 99))  # a few wrong readings must not make it look unwrapped
    angle = np.multiply(turns, 2 * np.pi, out=turns)
    wrapped = high - low <= _FOLDED_TURNS
    angle, rows, lone_notes = _without_lone(table, angle, rows, period=2 * np.pi if wrapped else None)
    notes += lone_notes
    if wrapped:
        for part in parts(len(angle)):
            begin = max(part.start - 1, 0)  # unwrapped already
            angle[begin : part.stop] = np.unwrap(angle[begin : part.stop])
        jumps = _beyond(differences(angle)) + 1
    else:  # whole turns were counted: a fast rotation is fine, a sudden change of speed is not
        jumps = _beyond(differences(angle, order=2)) + 2
        read = np.flatnonzero(np.diff(angle, prepend=np.nan)) if len(jumps) else jumps
        if len(read) <= _MOST_READ * len(angle):  # rows that repeat a reading stand still, and then jump
            jumps = read[_beyond(differences(angle[read], order=2)) + 2]
    if not len(jumps):
        return Angle(angle, rows, notes)
    line = _line(table, jumps, rows)
    what = f"the angle jumps by more than a quarter of a turn in {len(jumps)} of {len(turns)} samples"
    if len(jumps) > _JUMP_SHARE * len(turns):
        raise DataError(
            f"{table.path}:{line}: {what}, here first: a wrong `counts_per_turn` or `angle_unit`, a bad cable, or too "
            "fast for this rate. Whole turns cannot be counted."
        )
    return Angle(angle, rows, (*notes, f"{what} (first: line {line}); whole turns may be miscounted from there on."))


def _without_lone(
    table: CsvTable, angle: Array, rows: Rows | None, *, period: float | None
) -> tuple[Array, Rows | None, tuple[str, ...]]:
    """Return an angle (n,) without readings that are off the others' course, its rows, and notes on them.

    These are up to three readings in a row, and readings between a jump and the jump back. More than one in a hundred
    are not single faults, and stay. `period` is that of a wrapped angle.
    """
    limit = max(_LONE_RAD, _LONE_TIMES * usual_bend(angle, _USUAL, period=period))
    off = lone_readings(angle, limit, period=period)
    if not 0 < len(off) <= MOST_SHARE * len(angle):
        off = off[:0]
    angle, rows, notes = _without(table, angle, rows, off, "off alone")
    off = displaced_readings(angle, limit, period=period)
    angle, rows, more = _without(table, angle, rows, off, "between a jump and one back")
    return angle, rows, notes + more


def _without(
    table: CsvTable, angle: Array, rows: Rows | None, off: Rows, what: str
) -> tuple[Array, Rows | None, tuple[str, ...]]:
    """Return an angle (n,) without the readings at some places, its rows, and a note on what they are."""
    if not len(off):
        return angle, rows, ()
    text = f"{counted(len(off), 'reading')} of {len(angle)} {what} left out (first: line {_line(table, off, rows)})."
    kept = np.delete(np.arange(len(angle)) if rows is None else rows, off)
    return np.delete(angle, off), kept, (text,)


def _line(table: CsvTable, places: Rows, rows: Rows | None) -> int:
    return table.line_of_row(int(places[0] if rows is None else rows[places[0]]))


def _beyond(steps: Iterable[tuple[int, Array]]) -> Rows:
    """Return the places of first or second differences of an angle that no axis makes between two samples."""
    found = [begin + np.flatnonzero(np.abs(step) > _JUMP_RAD) for begin, step in steps]
    return np.concatenate([np.empty(0, np.intp), *found])
