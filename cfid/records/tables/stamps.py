"""Place samples by the stamps of the device that took them: a busy computer gets them late, never early."""

from typing import NamedTuple

import numpy as np

from cfid.records.tables.table import Array

_PARTS, _FEWEST_OF_A_PART = 12, 8  # of a recording, each with one quickest arrival
_FEWEST_PARTS = 4
_LARGEST_SKEW = 1e-3  # of two crystals, with margin: beyond it stamps count something else than microseconds
_LARGEST_SCATTER_S = 2e-3  # of the quickest arrivals about a line: beyond it the device's clock jumped


class StampedTimes(NamedTuple):
    """Times (n,) in s on this computer's clock, and the relative standard uncertainty of their scale."""

    time_s: Array
    scale_std: float


def stamped_times(arrival_s: Array, stamp_us: Array) -> StampedTimes | None:
    """Return when samples (n,) were taken, by a line through the quickest arrivals over the device's stamps.

    The quickest arrivals at both ends may differ by what the median arrival is late: so uncertain is the line's slope.
    None where the stamps are no steady clock in microseconds: a device without power starts a new count.
    """
    parts = min(len(arrival_s) // _FEWEST_OF_A_PART, _PARTS)
    device_s = 1e-6 * (stamp_us - stamp_us[0])
    span_s = float(device_s[-1])
    if parts < _FEWEST_PARTS or span_s <= 0:
        return None
    late_s = arrival_s - arrival_s[0] - device_s
    quickest = np.array([rows[late_s[rows].argmin()] for rows in np.array_split(np.arange(len(late_s)), parts)])
    skew, level_s = np.polyfit(device_s[quickest], late_s[quickest], 1)
    above_s = late_s - level_s - skew * device_s
    if abs(skew) > _LARGEST_SKEW or np.ptp(above_s[quickest]) > _LARGEST_SCATTER_S:
        return None
    median_s = float(np.median(above_s) - above_s.min())
    return StampedTimes(arrival_s + above_s.min() - above_s, median_s / span_s)
