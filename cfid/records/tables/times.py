"""Read what all tables share: named columns, times in seconds, and notes on rows that are left out.

Times are checked before use; the reader of each kind interprets the other columns.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.large import differences, empty, some_steps, usual_step
from cfid.records.tables.column_units import PER_SECOND, SECONDS, column_name, unit_of, unit_word
from cfid.records.tables.schema import TIME, Column, TimeUnit
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.text import TextLine, short
from cfid.records.tables.wrong_times import late_rows, unwrapped, wrong_times, wrong_times_note

TWO_IN_ONE = (
    "Was the clock set, or are two recordings in one file? Cut the file in two before that line (both with the "
    "header), or give `rate_hz` where its rows are evenly spaced."
)
_MOST_CUTS = 3  # recordings in one file: a time that goes back more often is wrong in single rows
_WRONG_IN_MANY = (
    "Rows with single wrong times are left out where they are 1 % at most. Correct the column, or give `rate_hz` where "
    "the rows are evenly spaced."
)
_CUT_LINE = "the last line was cut (it has no end) and is left out."
_UNENDED = "the last line has no end: it is used, but if the file was cut there, its last number may lack digits."

OTHER_UNIT = re.compile(r"[ _/,\[(]+(min|minutes?|h|hrs?|hours?|ns|nanoseconds?)[\])_]?$", re.IGNORECASE)
_UNIT_AT_END = re.compile(r"[ _/,\[(]+([a-zµμ]+)[\])_]?$", re.IGNORECASE)
COUNTER = re.compile(
    r"(?:sample|row|index|count|counter|number|no|nr|n|#)s?(?:[ _.]*(?:index|number|no|nr|#))?\.?", re.I
)
_FASTEST_S, _SLOWEST_S = 1.9e-5, 0.11  # sampling intervals of a rig: 50 kHz to 10 Hz, with margin for jitter
_NO_TIME = "Is this the time column? See `columns` and `rate_hz`."
_FEWEST_ROWS = 16
_LOOKED_AT, _OFF_WHOLE = 1000, 0.01  # times that show whether they are whole numbers; the least fraction that counts
MISSING_SHARE = 0.1  # of a recording's rows that may lack a number
_REPEATED_SHARE = 0.01  # of time stamps that may repeat the previous one without a note
_GAP, _LEAST_GAP_S = 10, 0.1  # usual intervals, and seconds: a busy computer's stamps are late by tens of milliseconds
_UNIX_S = (1e9, 4e9)  # seconds since the epoch, from 2001 to 2096


_TIMES = (
    "t|tout|_*time|time[ _]?stamp|ticks?|time since [a-z]+|elapsed(?:[ _]time)?|relative[ _]time|time_boot|timeus|"
    "seconds?|secs?|millis(?:econds)?|msecs?|micros(?:econds)?|usecs?|zeit|tiempo|x_value"
)
VEHICLE_CLOCK = Column(
    "vehicle_us",
    column_name(r"(?:vehicle|device|drone|crazyflie|cf)(?:[ _-]?(?:time|timestamp|clock))?", ("us", "ms", "s")),
    "of the vehicle's clock (vehicle_us)",
    optional=True,
)
TIME_COLUMN = Column(TIME, column_name(_TIMES, ("s", "ms", "us")), "of time (t, time)")


def unit_at_end(name: str) -> TimeUnit | None:
    """Return the unit of time at the end of any name, as in `Laufzeit [ms]`, None without one."""
    word = _UNIT_AT_END.search(name)
    unit = None if word is None else unit_word(word[1])
    return cast(TimeUnit, unit) if unit in PER_SECOND else None


def line_notes(table: CsvTable) -> tuple[str, ...]:
    """Return notes on the form of a table's lines, and on those left out: words, damaged ones, and a cut last one."""
    lines = table.all_prose()
    words = [line for line in lines if not any(sign.isdigit() for sign in line.text)]
    damaged = [line for line in lines if line not in words]
    return (
        *table.form.notes,
        *_left_out(words, "has no number and is", "without a number are"),
        *_left_out(damaged, f"has not {counted(len(table.names), 'field')} and is", "that are damaged are"),
        *((_CUT_LINE,) if table.cut else ()),
        *((_UNENDED,) if table.unended else ()),
    )


def _left_out(lines: Sequence[TextLine], one: str, many: str) -> tuple[str, ...]:
    if not lines:
        return ()
    first, text = lines[0].number, short(lines[0].text.strip())
    if len(lines) == 1:
        return (f"line {first}, '{text}', {one} left out.",)
    return (f"{len(lines)} lines {many} left out (first: line {first}, '{text}').",)


def pauses(table: CsvTable, time_s: Array) -> tuple[str, ...]:
    """Return a note on the longest interval without a row at times (n,), where one is much longer than usual.

    Where it is more than half of the recording, the note asks whether the clock was set.
    """
    usual_s = usual_step(time_s)
    least_s = max(_GAP * usual_s, _LEAST_GAP_S)
    found = [
        (begin + at, float(step[at])) for begin, step in differences(time_s) for at in np.flatnonzero(step > least_s)
    ]
    if not found:
        return ()
    row, longest_s = max(found, key=lambda each: each[1])
    longest = f"{longest_s:.3g}" if longest_s < 1000 else f"{longest_s:.0f}"
    question = " Was the clock set?" if longest_s > (time_s[-1] - time_s[0]) / 2 else ""
    return (
        f"{counted(len(found), 'gap')} without rows, the longest of {longest} s after line "
        f"{table.line_of_row(int(row))} "
        f"({time_s[row] - time_s[0]:.4g} s); rows are usually {1e3 * usual_s:.3g} ms apart.{question}",
    )


def vehicle_us(table: CsvTable, places: Mapping[str, str], columns: Mapping[str, Array]) -> Array | None:
    """Return the vehicle's clock (n,) in microseconds, which a name without a unit means, too; None without a clock."""
    if VEHICLE_CLOCK.key not in places:
        return None
    unit = unit_of(table, VEHICLE_CLOCK.called, places[VEHICLE_CLOCK.key], None, "") or "us"
    return columns[VEHICLE_CLOCK.key] * (SECONDS[unit] / SECONDS["us"])


def numbers_of(table: CsvTable, columns: Sequence[str]) -> Array:
    """Return the named columns, shape (rows, columns).

    Raises DataError when they are not numbers, or too few for a recording.
    """
    return _enough(table, table.numbers(columns))


def _enough(table: CsvTable, values: Array) -> Array:
    if len(values) < _FEWEST_ROWS:
        raise DataError(f"{table.path}: {counted(len(values), 'row')}; a recording has at least {_FEWEST_ROWS}.")
    return values


def complete_rows(
    table: CsvTable, columns: Sequence[str], *, own: bool, timed: bool
) -> tuple[CsvTable, Array, tuple[str, ...]]:
    """Return the table without its few unusable rows, the named columns as `numbers_of`, and notes.

    Unusable rows lack a number or, where the first column is the time (`timed`), have a wrong time. In a file of cfid's
    `own` every row is complete. Raises DataError naming the first row that lacks a number, where many do.
    """
    if own:
        return table, numbers_of(table, columns), ()
    table, known, notes = known_rows(table, columns, timed=timed)
    return table, _enough(table, known), notes


def known_rows(table: CsvTable, columns: Sequence[str], *, timed: bool) -> tuple[CsvTable, Array, tuple[str, ...]]:
    """Return the columns (rows, columns) of another program's table as `complete_rows`, however few rows it has."""
    known, notes = table.known_numbers(columns), list[str]()
    if len(bad := np.flatnonzero(~np.isfinite(known).all(axis=1))):
        if len(bad) > MISSING_SHARE * len(known):
            return table, table.numbers(columns), ()
        line, table = table.line_of_row(int(bad[0])), table.without(bad)
        where = f" in column '{columns[0]}'" if len(columns) == 1 else ""
        lack, are = ("lacks", "is") if len(bad) == 1 else ("lack", "are")
        notes.append(f"{len(bad)} of {len(known)} rows {lack} a number{where} (first: line {line}) and {are} left out.")
        known = np.delete(known, bad, axis=0)
    notes += unwrapped(table, known[:, 0]) if timed else ()
    wrong = wrong_times(known[:, 0]) if timed else np.empty(0, np.intp)
    if timed and not len(wrong):
        wrong = late_rows(known[:, 0])
    if len(wrong):
        notes.append(wrong_times_note(table, known[:, 0], wrong))
        table, known = table.without(wrong), np.delete(known, wrong, axis=0)
    return table, known, tuple(notes)


def seconds_of(table: CsvTable, column: str, raw: Array, *, unit: TimeUnit | None) -> Array:
    """Return a time column's values (n,) in seconds, by the file's own clock.

    Raises ConfigError when the given unit contradicts the column's name.
    """
    return raw / PER_SECOND[unit_of(table, TIME_COLUMN.called, column, unit, "time_unit") or "s"]


def times_of(
    table: CsvTable,
    column: str | None,
    raw: Array,
    *,
    unit: TimeUnit | None,
    rate_hz: float | None,
    own: bool = False,
    slowest_s: float = _SLOWEST_S,
) -> tuple[Array, tuple[str, ...]]:
    """Return the times (n,) in seconds since the first, and notes.

    `raw` (n,) are the column's values; a rate replaces them, and a note then names the column. `own` marks a run of
    cfid, whose unit is known at any rate. A unit that neither the column's name nor `unit` states is the only one in
    which intervals are at most `slowest_s`. Raises DataError when time goes back, stands still or has another unit,
    ConfigError for an invalid rate, or for a rate together with a unit.
    """
    if rate_hz is not None:
        if not 0 < rate_hz < np.inf:
            raise ConfigError(f"`rate_hz` {rate_hz:g}: has to be above zero.")
        if unit is not None:
            raise ConfigError("`time_unit` is that of a time column, and `rate_hz` stands for one: give one of them.")
        return np.arange(len(raw)) / rate_hz, _unused_times(table, rate_hz)
    stated = unit_of(table, TIME_COLUMN.called, column or "", unit, "time_unit")
    _refuse_nanoseconds(table.path, raw[0])
    _refuse_newest_first(table, column or "", raw)
    row = next((at + 1 + int(np.argmax(step < 0)) for at, step in differences(raw) if np.any(step < 0)), 0)
    if row:
        times = sum(int(np.count_nonzero(step < 0)) for _, step in differences(raw))
        often, advice = ("", TWO_IN_ONE) if times <= _MOST_CUTS else (f" {times} times, first", _WRONG_IN_MANY)
        raise DataError(
            f"{table.path}:{table.line_of_row(row)}: time goes back{often} from {raw[row - 1]:.16g} to {raw[row]:.16g} "
            f"{stated or 's'}. {advice}"
        )
    interval = usual_step(raw)
    if raw[-1] == raw[0]:
        raise DataError(
            f"{table.path}: time stands still at {raw[0]:.12g}. Were its last digits cut off, are there decimal "
            "commas, or is this not the time column? See `columns` and `rate_hz`."
        )
    known = "s" if own and stated is None else time_unit_of(table, column or "", raw, unit=unit, slowest_s=slowest_s)
    notes = () if own else _check_unit(table.path, raw[0], interval, known, slowest_s)
    if not own and stated is None and known != "s":
        notes += (f"time is read in {known}, by its step of {interval:g} (`time_unit`).",)
    repeated = sum(int(np.count_nonzero(step == 0)) for _, step in differences(raw))
    if repeated > _REPEATED_SHARE * len(raw):
        notes += (f"{repeated} of {len(raw)} samples repeat the time of the previous one.",)
    time_s = empty(len(raw))
    np.subtract(raw, raw[0], out=time_s)
    time_s /= PER_SECOND[known]
    return time_s, notes


def _unused_times(table: CsvTable, rate_hz: float) -> tuple[str, ...]:
    """Return a note on a time column that a rate replaces. Raises DataError where its rows are newest first."""
    place = next((at for at, name in enumerate(table.names) if TIME_COLUMN.called.fullmatch(name)), None)
    if place is None or not table.has_head:
        return ()
    name, first = table.names[place], next(table.blocks(), table)
    _refuse_newest_first(table, name, first.known_numbers([str(1 + place)])[:, 0])
    return (f"times are those of `rate_hz` {rate_hz:g}: column '{name}' is not used.",)


def _refuse_newest_first(table: CsvTable, column: str, raw: Array) -> None:
    """Raise DataError where times (n,) go back in most rows."""
    steps = some_steps(raw)
    if np.count_nonzero(steps < 0) > len(steps) / 2:
        raise DataError(
            f"{table.path}: time goes back from row to row, from {raw[0]:.6g} to {raw[-1]:.6g} in column '{column}': "
            "the rows are newest first, and would be read backwards. Sort them by that column, smallest first."
        )


def time_unit_of(
    table: CsvTable, column: str, raw: Array, *, unit: TimeUnit | None, slowest_s: float = _SLOWEST_S
) -> TimeUnit:
    """Return the unit of a time column's values (n,): the one given or in its name, else the one that its step allows.

    The latter is the only unit that gives a possible sampling interval, or s where several do.
    """
    stated = unit_of(table, TIME_COLUMN.called, column, unit, "time_unit")
    if stated is not None:
        return cast(TimeUnit, stated)
    name = table.names[table.place(column)] if table.has_head and column else column
    if (other := OTHER_UNIT.search(name)) is not None:
        raise ConfigError(
            f"{table.path}: column '{name}' is in '{other[1]}'; times are read in s, ms or us. Convert them, or give "
            "`time_unit` where the name is wrong."
        )
    if COUNTER.fullmatch(name):
        raise ConfigError(
            f"{table.path}: column '{name}' counts rows: give `rate_hz` (`columns` then without it), or `time_unit` "
            "where it is a time."
        )
    step = usual_step(raw)
    fitting = _fitting(step, slowest_s)
    some = raw[:_LOOKED_AT]
    if fitting == ["ms"] and np.any(np.abs(some - np.rint(some)) > _OFF_WHOLE):  # clocks in ms count whole ones
        raise ConfigError(
            f"{table.path}: column '{column}' names no unit, and rows that are {step:.4g} apart may be slow ones in s, "
            "or in ms: give `time_unit`."
        )
    counts = some[0] in (0, 1) and bool(np.all(np.diff(some) == 1))
    if fitting == ["ms"] and counts and TIME_COLUMN.called.fullmatch(name) is None:
        raise ConfigError(
            f"{table.path}: column '{name}' counts rows, or is a time in ms: give `rate_hz` (`columns`, where given, "
            "then without it), or `time_unit` ms."
        )
    few_repeat = sum(int(np.count_nonzero(step == 0)) for _, step in differences(raw)) < (len(raw) - 1) / 2
    return cast(TimeUnit, fitting[0]) if len(fitting) == 1 and few_repeat else "s"


def _fitting(interval: float, slowest_s: float) -> list[str]:
    # The usual step is that of positive ones: time stamps of a block repeat, and a pause is one long interval.
    return [name for name, scale in SECONDS.items() if _FASTEST_S <= interval * scale <= slowest_s]


def _refuse_nanoseconds(path: Path, first: float) -> None:
    """Raise DataError for times that begin with a date in ns, whatever unit was given or assumed."""
    if _UNIX_S[0] <= 1e-9 * first <= _UNIX_S[1]:
        raise DataError(
            f"{path}: the time column starts at {first:.0f}, a date (Unix time) in ns; times are read in s, ms or "
            "us. Divide the column by 1e9."
        )


def _check_unit(path: Path, first: float, interval: float, unit: str, slowest_s: float) -> tuple[str, ...]:
    """Refuse a time unit that gives an impossible sampling interval, and propose a possible one."""
    fitting = _fitting(interval, slowest_s)
    dates = [name for name, scale in SECONDS.items() if _UNIX_S[0] <= first * scale <= _UNIX_S[1]]
    dated = f" It starts at {first:.0f}, which is a date (Unix time) in {dates[0]}." if dates else ""
    better = dates if dates and dates[0] in fitting else fitting
    if unit not in fitting or (better is dates and unit not in dates):
        advice = f"Give `time_unit` {' or '.join(better)}." if better else _NO_TIME
        seconds = f"{interval * SECONDS[unit]:.3g}"
        raise DataError(f"{path}: read in {unit}, the time column has {seconds} s between samples.{dated} {advice}")
    if unit == better[0] or interval * SECONDS[better[0]] > _SLOWEST_S:
        return ()
    # A slow rate in one unit is a very fast one in the next, which few instruments have.
    rate = f"{1 / (interval * SECONDS[unit]):.0f} Hz"
    return (f"time is read in {unit}, which makes {rate}: is it not in {better[0]}?",)
