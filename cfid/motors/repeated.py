"""Takes each reading of a speed once where a log or a stand repeats it in several rows, and names that."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.held_readings import Mask, new_rows
from cfid.findings import Finding, note

Array = npt.NDArray[np.float64]

_LONGEST_S = 0.3  # of readings that show a lag: what lasts longer is a speed that rests


class Readings(NamedTuple):
    """How many rows show how many readings, and the interval between rows, by which a reading may be older."""

    rows: int
    read: int
    row_s: float

    @property
    def age_s(self) -> float:
        """The interval between rows where readings are repeated, 0 where each row has its own."""
        return self.row_s if self.read < self.rows else 0.0


def once_each(time_s: Array, value: Array) -> tuple[Mask, Readings]:
    """Return which values (n,) at times (n,) count, and how many rows show how many readings.

    What is no number does not count. A row that repeats a reading shows a speed that was: it comes late by up to the
    time between two readings.
    """
    counts = np.isfinite(value)
    row_s = float(np.median(np.diff(time_s[counts]))) if np.count_nonzero(counts) > 1 else 0.0
    new = new_rows(value[counts], longest=_LONGEST_S / row_s if row_s else np.inf)
    found = Readings(len(new), int(np.count_nonzero(new)), row_s)
    counts[counts] = new
    return counts, found


def repeated_finding(readings: Readings) -> Finding:
    """Return a note on readings that are repeated."""
    rows, read, row_s = readings
    rate_hz = 1 / row_s
    text = (
        f"each reading is repeated in about {rows / read:.2g} rows: {rate_hz:.3g} rows a second show "
        f"{rate_hz * read / rows:.3g} readings. The first row of each counts, and may show it up to {1e3 * row_s:.3g} "
        f"ms late: the delay's standard uncertainty contains {1e3 * row_s / 3**0.5:.2g} ms for that."
    )
    return note("speeds-repeated", text, "dynamics.*")
