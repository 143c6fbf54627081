"""Leave out the few rows of another program's table that have impossible values."""

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.large import chosen_rows
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.times import MISSING_SHARE


def without_few(
    table: CsvTable, values: Array, wrong: npt.NDArray[np.bool_], shown: Array, what: str
) -> tuple[CsvTable, Array, tuple[str, ...]]:
    """Return a table and its values (n, k) without the rows that are `wrong` (n,), and a note on them.

    `shown` (n,) are the values that the note quotes, `what` completes its "with a value that". Where more than
    one row in ten is wrong, all stay: such a table is of another kind.
    """
    if not 0 < np.count_nonzero(wrong) <= MISSING_SHARE * len(wrong):
        return table, values, ()
    row = int(np.argmax(wrong))
    note = (
        f"{counted(int(np.count_nonzero(wrong)), 'row')} of {len(wrong)} with a value that {what} (first: "
        f"{shown[row]:.9g} in line {table.line_of_row(row)}) left out."
    )
    return table.without(np.flatnonzero(wrong)), chosen_rows(values, ~wrong), (note,)
