"""Leave out measurements that no rotor makes: those off alone, those far beyond others, and a hung sensor's."""

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.large import parts
from cfid.records.tables import supply
from cfid.records.tables.lone import MOST_SHARE, Rows, spikes_in
from cfid.records.tables.stand_columns import Found
from cfid.records.tables.table import Array, CsvTable

_MEASURED = ("thrust_n", "torque_nm", "vbat_v", "speeds_rad_s")
_FOLLOWS = ("thrust_n", "torque_nm", "speeds_rad_s")  # a change of the command
_SUPPLY_JUMP = 0.9  # of the usual voltage: a bench supply may be set to another for a step, and back
# The largest value over the usual one at any command. A rotor that is sped up takes several times its torque.
_MOST_TIMES = {"thrust_n": 5.0, "torque_nm": 10.0, "speeds_rad_s": 3.0}
_USUAL, _LEVELS = 0.98, 20  # share of all values; number of parts of the command's range
_RANKED = 1_000_000  # values that show what is usual
_HUNG, _LATE = 10, 5  # times the usual rows of one value; rows of it after a change of the command


def without_faults(
    table: CsvTable, found: Found, command: Array, order: npt.NDArray[np.intp] | None
) -> tuple[str, ...]:
    """Set to nan single measurements off those before and after, far ones, and those of a sensor that hangs.

    Returns notes. A command (n,) that jumps off and back with a single measurement explains it. A sensor hangs where it
    repeats one value while the command changes, unless its motor stands still. `order` is the order of the rows.
    """
    commanded = spikes_in(command)
    notes = []
    for quantity in _MEASURED:
        columns = found.get(quantity)
        for name, value in zip(columns.names, columns.raw.T, strict=True) if columns else ():
            lone = np.setdiff1d(spikes_in(value), np.concatenate([commanded, commanded + 1]))
            hung = _hung(value, command) if quantity in _FOLLOWS else lone[:0]
            far = np.setdiff1d(_far(quantity, value, command), lone)
            for places, what in (
                (lone, "off alone"),
                (far, "far beyond the others"),
                (hung, "that repeat the one before while the command changes"),
            ):
                if len(places):
                    row = int(places[0] if order is None else order[places[0]])
                    first = f"first: {value[places[0]]:g} in line {table.line_of_row(row)}"
                    notes.append(f"{counted(len(places), 'value')} of '{name}' {what} left out ({first}).")
            value[np.concatenate([lone, far, hung])] = np.nan
    return tuple(notes)


def _far(quantity: str, value: Array, command: Array) -> Rows:
    """Return the places of values (n,) that jump off their supply's voltage, or far exceed what any command (n,) gives.

    Of the latter, more than one in a hundred are not faults.
    """
    if quantity not in _MOST_TIMES:
        known = np.flatnonzero(np.isfinite(value))
        return known[supply.displaced(value[known], jump=_SUPPLY_JUMP)]
    some = slice(None, None, len(value) // _RANKED + 1)
    seen = np.isfinite(value[some])
    size, drive = np.abs(value[some][seen]), np.nan_to_num(command[some][seen])
    level = np.floor(_LEVELS * drive / max(float(drive.max(initial=0.0)), 1.0))
    usual = [float(np.median(size[level == one])) for one in np.unique(level)]
    limit = _MOST_TIMES[quantity] * max([*usual, float(np.quantile(size, _USUAL)) if len(size) else 0.0])
    far = np.concatenate([part.start + np.flatnonzero(np.abs(value[part]) > limit) for part in parts(len(value))])
    return far if len(far) <= MOST_SHARE * len(value) else far[:0]


def _hung(value: Array, command: Array) -> Rows:
    """Return the places of values (n,) that repeat the one before over a change of the command, except zeros."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(value) != 0) + 1, [len(value)]])
    longer = np.diff(edges) >= _HUNG * np.median(np.diff(edges))
    changes = np.flatnonzero(np.diff(command)) + 1
    found = [np.empty(0, np.intp)]
    for begin, end in zip(edges[:-1][longer], edges[1:][longer], strict=True):
        followed = np.any((changes > begin) & (changes <= end - _LATE))
        if followed and value[begin] != 0:
            found.append(np.arange(begin + 1, end))
    return np.concatenate(found)
