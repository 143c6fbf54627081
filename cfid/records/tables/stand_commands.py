"""Convert the commands of a table of motors, which may be pulse widths, to a scale from 0 to 65535."""

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.large import stored
from cfid.records.tables.stand_columns import Found
from cfid.records.tables.table import Array, CsvTable
from cfid.units import FULL_COMMAND

USUAL_ESC_US = (1000.0, 2000.0)  # pulse widths of standstill and full throttle, by convention


def commands_of(table: CsvTable, found: Found, esc_us: tuple[float, float] | None) -> tuple[Array, tuple[str, ...]]:
    """Return commands (n,) from 0 to 65535, nan where the file has none, and notes on how pulse widths were read.

    Raises ConfigError for `esc_us` where the column is no pulse width, DataError for pulses beyond the range.
    """
    column = found.get("command")
    if column is None:
        return np.full(len(next(iter(found.values())).raw), np.nan), ()
    if column.head.kind != "esc":
        if esc_us is not None:
            raise ConfigError(f"{table.path}: `esc_us` is for pulse widths, but '{column.names[0]}' has another unit.")
        return column.value[:, 0], ()
    low, high = esc_us or USUAL_ESC_US
    raw = column.raw[:, 0]
    if raw.max() > high:
        line = table.line_of_row(int(np.argmax(raw)))
        raise DataError(
            f"{table.path}:{line}: {raw.max():g} us in '{column.names[0]}' is longer than the full throttle of "
            f"`esc_us` {low:g},{high:g}: give the range of this motor controller."
        )
    notes = [f"pulse widths are read as `esc_us` {low:g},{high:g}, commands 0 to {FULL_COMMAND}."] if not esc_us else []
    if (below := int(np.count_nonzero(raw < low))) > 0:
        notes.append(
            f"{counted(below, 'row has', 'rows have')} pulses below {low:g} us: motors stand there, command 0."
        )
    return stored(np.rint((raw.clip(low) - low) / (high - low) * FULL_COMMAND)), tuple(notes)
