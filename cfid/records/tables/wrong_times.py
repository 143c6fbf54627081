"""Single times of a table that are wrong, and rows that stand in the wrong order."""

import numpy as np

from cfid.counted import counted
from cfid.large import differences, usual_step
from cfid.records.tables.lone import MOST_SHARE, Rows, lone_readings
from cfid.records.tables.table import Array, CsvTable

_WRAP = 2.0**32  # values of a microcontroller's clock
_WRONG_TIME = 20.0  # usual intervals, by which a single time is wrong


def wraps(time: Array) -> Rows:
    """Return the places of times (n,) at which a clock of 32 bits begins anew, as micros() after 71.6 minutes."""
    back = [begin + 1 + np.flatnonzero(step < 0) for begin, step in differences(time)]
    places = np.concatenate([np.empty(0, np.intp), *back])
    if not len(places):
        return places
    with np.errstate(over="ignore"):  # damaged times of any size
        onwards = time[places] - time[places - 1] + _WRAP
    return np.asarray(places[(onwards > 0) & (onwards < _WRONG_TIME * usual_step(time))])


def unwrapped(table: CsvTable, time: Array) -> tuple[str, ...]:
    """Let times (n,) go on where their counter begins anew, and return a note."""
    known = np.flatnonzero(np.isfinite(time))
    places = known[wraps(time[known])]
    if not len(places):
        return ()
    line = table.line_of_row(int(places[0]))
    text = (
        f"the clock of 32 bits begins anew in line {line}, from {time[places[0] - 1]:.0f} to {time[places[0]]:.0f}: "
        "times go on from there."
    )
    for place in places:
        time[place:] += _WRAP
    return (text,)


def wrong_times(time: Array) -> Rows:
    """Return the places of single times of a series (n,) that jump off and back, where the others do not go back."""
    if not any(np.any(step < 0) for _, step in differences(time)):
        return np.empty(0, np.intp)
    lone = lone_readings(time, _WRONG_TIME * usual_step(time))
    return lone if _is_few(lone, time) else lone[:0]


def late_rows(time: Array) -> Rows:
    """Return the places of rows (n,) that stand behind a later one, as of two swapped ones, where no others go back."""
    back = [begin + 1 + np.flatnonzero(step < 0) for begin, step in differences(time)]
    late = np.concatenate([np.empty(0, np.intp), *back])
    return late if _is_few(late, time) else late[:0]


def _is_few(places: Rows, time: Array) -> bool:
    """Return whether few of all times (n,) stand at some places, and the others do not go back."""
    others = np.delete(time, places)
    return len(places) <= max(MOST_SHARE * len(time), 1) and bool(np.all(others[1:] >= others[:-1]))


def wrong_times_note(table: CsvTable, time: Array, places: Rows) -> str:
    """Return the note on wrong times (n,) at some places, whose rows are left out."""
    line = table.line_of_row(int(places[0]))
    return (
        f"{counted(len(places), 'row')} whose time is off that of the rows around (first: {time[places[0]]:.6g} in "
        f"line {line}) {'is' if len(places) == 1 else 'are'} left out."
    )
