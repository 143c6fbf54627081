"""Take each reading once where an encoder's readings come less often than its rows, and report that."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.estimate.held_readings import first_rows, rows_a_reading
from cfid.findings import Finding, warning
from cfid.swing.free_swing import FreeSwing
from cfid.swing.frozen import find_moving_swing

Array = npt.NDArray[np.float64]


def find_read_swing(time_s: Array, angle_rad: Array, **window: Any) -> FreeSwing:
    """Find the free swing in an encoder's record (n,) as `find_moving_swing` does, from the first row of each reading.

    A row that repeats a reading shows an earlier angle: it is late by up to the time between two readings. Raises
    DataError as `find_moving_swing` does.
    """
    swing = find_moving_swing(time_s, angle_rad, **window)
    rows = rows_a_reading(swing.angle_rad[swing.hand_gone : swing.end + 1])
    if rows == 1:
        return swing
    read = first_rows(angle_rad, rows=rows)
    found = find_moving_swing(time_s[read], angle_rad[read], **window)
    return replace(found, findings=(*found.findings, _finding(swing, rows)))


def _finding(swing: FreeSwing, rows: int) -> Finding:
    rate_hz = (swing.end - swing.hand_gone) / float(swing.time_s[swing.end] - swing.time_s[swing.hand_gone])
    text = (
        f"each reading of the angle is repeated in about {rows} rows: {rate_hz:.3g} rows a second show "
        f"{rate_hz / rows:.3g} readings. The first row of each counts. Send a line only where the sensor has a new "
        "reading, and state that rate."
    )
    return warning("swing-angle-repeated", text, "swing.*")
