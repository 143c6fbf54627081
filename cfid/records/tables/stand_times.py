"""Find the times of a table of motors: a recording over time, or settled points taken one after another."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.records.tables.column_units import unit_of
from cfid.records.tables.schema import TimeUnit
from cfid.records.tables.stand_columns import Found
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.times import COUNTER, OTHER_UNIT, TIME_COLUMN, pauses, times_of

STAND_RATE_HZ = 100.0  # of Bitcraze's thrust stand, whose files have no time

_HELD_ROWS = 5  # of one command, on average: from there on a table without times is a recording
_MOST_TYPED = 200  # settled points that a program writes without a time
_SETTLED_S = 1.0  # between rows: a rotor settles in less
_SLOWEST_S = 2.0  # between rows of a recording
_JITTER_S = 0.1  # by which times of a program on a desktop may go back
_JITTER_SHARE = 0.05
# Rows that show a time without a known name; how far off a line it may be, as a share of its range; the least share of
# rows of a held command in which it grows: stamps of 16 ms repeat in several.
_FEWEST_GROWING, _OFF_LINE, _OFTEN = 30, 0.1, 0.05


class Timing(NamedTuple):
    """Times (n,) in seconds, None for settled points; the rate that made them, None where a column gave them.

    `order` puts the rows into the order of their times, None where they are in it already.
    """

    time_s: Array | None
    rate_hz: float | None
    notes: tuple[str, ...]
    order: npt.NDArray[np.intp] | None = None


def _in_order(time: Array) -> tuple[npt.NDArray[np.intp] | None, tuple[str, ...]]:
    """Return the order of rows whose times (n,) go back a little now and then, None where the order stays."""
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if not len(back) or len(back) > max(_JITTER_SHARE * len(time), 1):
        return None, ()
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    if -steps.min() > max(_JITTER_S, 2 * usual):
        return None, ()
    text = (
        f"time goes back in {counted(len(back), 'row')}, by {-steps.min():.3g} at most: rows are taken in "
        "the order of times."
    )
    return np.argsort(time, kind="stable"), (text,)


def timing_of(table: CsvTable, found: Found, command: Array, *, unit: TimeUnit | None, rate_hz: float | None) -> Timing:
    """Return the times of rows with commands (n,), which are nan without any.

    A table with times is a recording, unless its rows are so far apart that each has settled. A table without times is
    a recording where its commands are held and of a kind that programs write. Raises DataError and ConfigError as
    `times_of`, and for pulse widths that are held without a time or rate.
    """
    held = len(command) / (1 + np.count_nonzero(np.diff(command)))
    kind = found["command"].head.kind if "command" in found else ""
    if "time_s" in found and rate_hz is None and len(command) > 1:
        column = found["time_s"]
        raw, (order, jitter) = column.raw[:, 0], _in_order(column.raw[:, 0])
        name = column.names[0]
        stated = unit_of(table, TIME_COLUMN.called, name, unit, "time_unit")
        slowest_s = _SLOWEST_S if stated is None else np.inf
        times, notes = times_of(
            table, name, raw if order is None else raw[order], unit=unit, rate_hz=None, slowest_s=slowest_s
        )
        step_s = float(np.median(np.diff(times)))
        if step_s < _SETTLED_S:
            gaps = () if order is not None else pauses(table, times)
            return Timing(times, None, (*notes, *jitter, *gaps), order)
        text = f"rows are {step_s:.2g} s apart: each is taken as a settled point."
        return Timing(None, None, (*notes, text))
    of_program = kind == "esc" and (held >= 2 or len(command) > _MOST_TYPED)
    if rate_hz is None and (held >= 2 or len(command) > _MOST_TYPED):
        _refuse_unnamed_time(table, found, command)
    if rate_hz is None and not of_program and (not kind or held < _HELD_ROWS):
        return Timing(None, None, ())
    if rate_hz is None and (fault := _fault_of_times(table)):
        raise DataError(fault)
    if rate_hz is None and of_program:
        raise DataError(
            f"{table.path}: {len(command)} rows are a recording, and no column is its time: give `rate_hz`."
        )
    rate = STAND_RATE_HZ if rate_hz is None else rate_hz
    times, notes = times_of(table, None, command, unit=unit, rate_hz=rate)
    assumed = f"a record over time without a time column: {rate:g} Hz is assumed (`rate_hz`)."
    return Timing(times, rate, (*notes, *([assumed] if rate_hz is None else [])))


def _refuse_unnamed_time(table: CsvTable, found: Found, command: Array) -> None:
    """Raise DataError for an unused column that grows evenly while commands (n,) are held: it may be the time."""
    used = {name for columns in found.values() for name in columns.names}
    first = next(table.blocks(), table)
    for place, name in enumerate(table.names, start=1):
        if name in used or COUNTER.fullmatch(name):
            continue
        if _grows(first.known_numbers([str(place)])[:, 0], command):
            if (other := OTHER_UNIT.search(name)) is not None:
                raise DataError(
                    f"{table.path}: column '{name}' may be the time of its rows, in '{other[1]}': times are read in s, "
                    "ms or us. Convert them, and state that in its header, or give `rate_hz`."
                )
            raise DataError(
                f"{table.path}: no known column is the time of its rows, and column '{name}' grows from row to row as "
                f"one does. Name it by `columns`, as in t={place}, with its `time_unit`; if it is no time, give "
                "`rate_hz`."
            )


def _grows(values: Array, command: Array) -> bool:
    """Return whether values (n,) grow evenly with the rows, not by ones as counters do, and while commands are held."""
    steps, held = np.diff(values), np.diff(command[: len(values)]) == 0
    if len(values) < _FEWEST_GROWING or not np.all(steps >= 0) or values[-1] == values[0] or np.all(steps == 1):
        return False
    line = np.linspace(values[0], values[-1], len(values))
    even = float(np.abs(values - line).max()) <= _OFF_LINE * float(values[-1] - values[0])
    return even and (not held.any() or bool(np.mean(steps[held] > 0) > _OFTEN))


def _fault_of_times(table: CsvTable) -> str | None:
    """Return what is wrong with a column that has the name of a time but holds none, such as one of dates."""
    named = (name for name in table.names if TIME_COLUMN.called.fullmatch(name.strip()))
    return next((fault for name in named if (fault := table.fault_in(name))), None)
