"""Values that forces and torques can have in their unit: single others are left out, many are of another unit."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError
from cfid.large import chosen_rows, parts
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.times import MISSING_SHARE

Units = Literal["counts", "n,nm"]

# What no reading exceeds: a count is a signed word of 32 bits, and the largest load cells end at 40 kN.
_LARGEST: dict[Units, float] = {"counts": 2.0**31, "n,nm": 1e5}


class Unit(NamedTuple):
    """The unit of forces and torques, and who states it: an option, the header, or nobody."""

    name: Units
    by: Literal["option", "header"] | None


def possible_rows(
    table: CsvTable, values: Array, wrench: Array, units: Unit
) -> tuple[CsvTable, Array, tuple[str, ...]]:
    """Return a table and its values (n, k) without the few rows that no load cell measures in a unit that is stated."""
    wrong = np.zeros(len(wrench), bool)
    for part in parts(len(wrench)):
        wrong[part] = ~(np.abs(wrench[part]) <= _LARGEST[units.name]).all(axis=1)
    if units.by is None or not 0 < np.count_nonzero(wrong) <= MISSING_SHARE * len(wrong):
        return table, values, ()
    row = int(np.argmax(wrong))
    first = wrench[row][np.abs(wrench[row]) > _LARGEST[units.name]][0]
    note = (
        f"{counted(int(np.count_nonzero(wrong)), 'row')} of {len(wrong)} with a value that no load cell measures "
        f"(first: {first:.9g} in line {table.line_of_row(row)}) left out."
    )
    return table.without(np.flatnonzero(wrong)), chosen_rows(values, ~wrong), (note,)


def check_values(table: CsvTable, axes: Sequence[str], values: Array, units: Unit) -> None:
    """Raise DataError for values (n, k) that have another unit. `axes` are the names of their columns."""
    for part in parts(len(values)):
        wrong = ~(np.abs(values[part]) <= _LARGEST[units.name])
        if units.name == "counts":
            wrong |= values[part] != np.rint(values[part])
        if wrong.any():
            break
    else:
        return
    row, axis = (int(place) for place in np.argwhere(wrong)[0])
    row += part.start
    here = f"{table.path}:{table.line_of_row(row)}: {values[row, axis]:.9g} in column '{axes[axis]}' is"
    if units.name == "counts":
        raise DataError(f"{here} not a count (a whole number of 32 bits): give `units` n,nm if these are N and N m.")
    remedy = "leave out `units` n,nm" if units.by == "option" else "write so in the header, as in Fx_counts"
    raise DataError(f"{here} more than any load cell measures: are they counts? Then {remedy}.")
