"""Single measurements of a motor's recording that stand off alone: faults of a sensor, which no rotor makes."""

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.records.tables.lone import spikes_in
from cfid.records.tables.stand_columns import Found
from cfid.records.tables.table import Array, CsvTable

_MEASURED = ("thrust_n", "torque_nm", "vbat_v", "speeds_rad_s")


def without_spikes(
    table: CsvTable, found: Found, command: Array, order: npt.NDArray[np.intp] | None
) -> tuple[str, ...]:
    """Set single measurements off those before and after to nan, and return notes; `order` is that of the rows.

    A command (n,) that jumps off and back for as long explains one.
    """
    commanded = spikes_in(command)
    notes = []
    for quantity in _MEASURED:
        columns = found.get(quantity)
        for name, value in zip(columns.names, columns.raw.T, strict=True) if columns else ():
            lone = np.setdiff1d(spikes_in(value), np.concatenate([commanded, commanded + 1]))
            if not len(lone):
                continue
            first = int(lone[0])
            line = table.line_of_row(first if order is None else int(order[first]))
            notes.append(
                f"{counted(len(lone), 'value')} of '{name}' off alone left out (first: {value[first]:g} in line "
                f"{line})."
            )
            value[lone] = np.nan
    return tuple(notes)
