"""Takes each angle reading once where rows repeat it, and reports that, or that rows are an encoder's edges."""

import math

import numpy as np
import numpy.typing as npt

from cfid.estimate.held_readings import once_each
from cfid.findings import Finding, note
from cfid.friction.turns import count_of_edges

Array = npt.NDArray[np.float64]


def read_once(time_s: Array, angle_rad: Array) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Return the times (m,) and angles (m,) of a record's rows (n,) with a new reading, and notes on what rows are.

    Rows that repeat a reading show an axis that stands still and then jumps. Angles are compared within a turn, where
    they show the sensor's steps; those over many turns of an even speed grow by steps that are not the sensor's.
    """
    if count_of_edges(angle_rad):
        text = "rows are changes of the encoder's count by one: where none was written, the axis stood still."
        return time_s, angle_rad, (note("friction-rows-are-edges", text, "friction.*"),)
    counts, readings = once_each(time_s, angle_rad % (2 * math.pi))
    if not readings.age_s:
        return time_s, angle_rad, ()
    rate_hz, share = 1 / readings.row_s, readings.read / readings.rows
    text = (
        f"each reading of the angle is repeated in about {1 / share:.2g} rows: {rate_hz:.3g} rows a second show "
        f"{rate_hz * share:.3g} readings. The first row of each counts."
    )
    return time_s[counts], angle_rad[counts], (note("friction-angle-repeated", text, "friction.*"),)
