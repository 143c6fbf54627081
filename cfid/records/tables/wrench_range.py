"""Check that forces and torques are possible in their unit: few impossible ones are left out, many are refused."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from cfid.errors import DataError
from cfid.large import parts
from cfid.records.tables.few_rows import without_few
from cfid.records.tables.table import Array, CsvTable

Units = Literal["counts", "n,nm"]

# What no reading exceeds: a count is a signed word of 32 bits, and the largest load cells end at 40 kN.
_LARGEST: dict[Units, float] = {"counts": 2.0**31, "n,nm": 1e5}


class Unit(NamedTuple):
    """The unit of forces and torques, what states it (an option, the header or nothing), and factors (k,) to N and N m.

    The factors of counts are one.
    """

    name: Units
    by: Literal["option", "header"] | None
    factors: Array


def possible_rows(
    table: CsvTable, values: Array, wrench: Array, units: Unit
) -> tuple[CsvTable, Array, tuple[str, ...]]:
    """Return a table and its values (n, k) without the few rows that no load cell measures in the stated unit."""
    wrong, farthest = np.zeros(len(wrench), bool), np.zeros(len(wrench))
    for part in parts(len(wrench) if units.by else 0):
        loads = np.abs(wrench[part] * units.factors)
        largest = np.argmax(loads, axis=1)[:, None]
        farthest[part] = np.take_along_axis(wrench[part], largest, axis=1)[:, 0]
        wrong[part] = ~(np.take_along_axis(loads, largest, axis=1)[:, 0] <= _LARGEST[units.name])
    return without_few(table, values, wrong, farthest, "no load cell measures")


def check_values(table: CsvTable, axes: Sequence[str], values: Array, units: Unit) -> None:
    """Raise DataError for values (n, k) that have another unit. `axes` are the names of their columns."""
    for part in parts(len(values)):
        wrong = ~(np.abs(values[part] * units.factors) <= _LARGEST[units.name])
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
