"""Takes each reading of an angle once where rows repeat it, and names that, and rows that are edges of an encoder."""

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, note
from cfid.friction.turns import count_of_edges

Array = npt.NDArray[np.float64]


def read_once(time_s: Array, angle_rad: Array) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Return the times (m,) and angles (m,) of a record's rows (n,) with a new reading, and notes on what rows are.

    Rows that repeat a reading show an axis that stands still, and then one that jumps. Readings within a turn show the
    steps of the sensor: those of an axis that turns evenly for long are alike.
    """
    if count_of_edges(angle_rad):
        text = "rows are changes of the encoder's count by one: where none was written, the axis stood still."
        return time_s, angle_rad, (note("friction-rows-are-edges", text, "friction.*"),)
    return time_s, angle_rad, ()
