"""Find single wrong times of a table, and rows that are in the wrong order."""

import numpy as np

from cfid.counted import counted
from cfid.large import differences, parts, usual_step
from cfid.records.tables.lone import MOST_SHARE, Rows, lone_readings
from cfid.records.tables.table import Array, CsvTable

_WRONG_TIME = 20.0  # usual intervals by which a single wrong time is off
_LOST = 1000.0  # usual intervals of rows that may be lost where a clock of 32 bits starts anew: seconds of its 71 min
_SHORT = 100.0  # usual intervals that a clock of 16 bits counts at least: one of microseconds wraps within a few rows


def wraps(time: Array) -> tuple[Rows, int]:
    """Return the places of times (n,) at which a microcontroller's clock starts anew, and its bits, 32 or 16.

    One of 32 bits is micros(), after 71.6 minutes. Lost rows are accepted there only where times are regular on both
    sides: a single wrong time may be as large.
    """
    back = [begin + 1 + np.flatnonzero(step < 0) for begin, step in differences(time)]
    places = np.concatenate([np.empty(0, np.intp), *back])
    if not len(places):
        return places, 32
    usual = usual_step(time)
    with np.errstate(over="ignore"):  # damaged times of any size
        jump = time[places] - time[places - 1]
        before = time[places - 1] - time[np.maximum(places - 2, 0)]
        after = time[np.minimum(places + 1, len(time) - 1)] - time[places]
    regular = (np.maximum(before, after) < _WRONG_TIME * usual) & (np.minimum(before, after) > 0)
    most = np.where(regular, _LOST, _WRONG_TIME) * usual
    long = places[(jump + 2.0**32 > 0) & (jump + 2.0**32 < most)]
    if len(long) or not (time.min() >= 0 and time.max() < 2.0**16 and _SHORT * usual < 2.0**16):
        return long, 32
    short = (jump + 2.0**16 > 0) & (jump + 2.0**16 < _WRONG_TIME * usual)
    return (places if np.all(short) else long), 16


def unwrapped(table: CsvTable, time: Array) -> tuple[str, ...]:
    """Make times (n,) continue where their counter starts anew, and return a note."""
    finite = finite_places(time)
    some = time[finite]
    found, bits = wraps(some)
    if not len(found):
        return ()
    known = np.arange(len(time))[finite]
    before, after = some[found - 1], some[found]
    longest = float((after - before + 2.0**bits).max()) / usual_step(some)
    lost = f", over as many as {longest:.0f} usual intervals: rows were lost" if longest > _WRONG_TIME else ""
    text = (
        f"the clock of {bits} bits begins anew in line {table.line_of_row(int(known[found[0]]))}, from {before[0]:.0f} "
        f"to {after[0]:.0f}: times go on from there{lost}."
    )
    for place in known[found]:
        time[place:] += 2.0**bits
    return (text,)


def finite_places(time: Array) -> Rows | slice:
    """Return the places of the finite ones of times (n,): where all are, a slice, which copies nothing."""
    if all(np.isfinite(time[part]).all() for part in parts(len(time))):
        return slice(None)
    return np.flatnonzero(np.isfinite(time))


def wrong_times(time: Array) -> Rows:
    """Return the places of single times of a series (n,) that jump off and back, where the others do not go back."""
    if not any(np.any(step < 0) for _, step in differences(time)):
        return np.empty(0, np.intp)
    lone = lone_readings(time, _WRONG_TIME * usual_step(time))
    return lone if _is_few(lone, time) else lone[:0]


def late_rows(time: Array) -> Rows:
    """Return the places of rows (n,) that follow a later one, as in two swapped rows, where no others go back."""
    back = [begin + 1 + np.flatnonzero(step < 0) for begin, step in differences(time)]
    late = np.concatenate([np.empty(0, np.intp), *back])
    return late if _is_few(late, time) else late[:0]


def _is_few(places: Rows, time: Array) -> bool:
    """Return whether `places` are few of all times (n,), and the other times do not go back."""
    if not len(places):
        return True
    others = np.delete(time, places)
    return len(places) <= max(MOST_SHARE * len(time), 1) and bool(np.all(others[1:] >= others[:-1]))


def wrong_times_note(table: CsvTable, time: Array, places: Rows) -> str:
    """Return the note on wrong times (n,) at some places, whose rows are left out."""
    line = table.line_of_row(int(places[0]))
    return (
        f"{counted(len(places), 'row')} whose time is off that of the rows around (first: {time[places[0]]:.6g} in "
        f"line {line}) {'is' if len(places) == 1 else 'are'} left out."
    )
