"""Readings that repeat the one before for longer than readings usually do: their sensor hung, or was not read."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_ROWS, _TIMES, _RARELY = 10.0, 5.0, 0.99  # times as many as usual, and as a share of all values takes at most
_LONG_S = 0.05  # shorter ones change nothing
_AROUND, _RESTS, _GOES_ON = 20, 1.5, 2.5  # rows on both sides; steps that usual changes have, and those at the ends


def repeated(time_s: Array, value: Array) -> Mask:
    """Return which readings (n,) at times (n,) are of one value for long; those of few digits usually last longer.

    Where readings change by one step at a time or not at all, they stay what they are without a fault: what is measured
    barely moves there, and goes on from the same value.
    """
    change = np.abs(np.diff(value))
    begins = np.concatenate([np.zeros(1, np.intp), np.flatnonzero(change != 0) + 1])
    rows = np.diff(begins, append=len(value))
    if rows.max() < _ROWS:
        return np.zeros(len(value), bool)
    lasts_s = time_s[begins + rows - 1] - time_s[begins]
    least = max(_ROWS * float(np.median(rows)), _TIMES * float(np.quantile(rows, _RARELY)))
    long = (rows >= least) & (lasts_s >= _LONG_S)
    for place in np.flatnonzero(long):
        long[place] = not _rests(change, int(begins[place]), int(begins[place] + rows[place]))
    return np.repeat(long, rows)


def _rests(change: Array, begin: int, end: int) -> bool:
    """Return whether readings between two rows repeat one value since they barely change, by the changes (n - 1,)."""
    step = float(change[change != 0].min())
    around = np.concatenate([change[max(begin - _AROUND, 0) : max(begin - 1, 0)], change[end : end + _AROUND]])
    ends = np.concatenate([change[max(begin - 1, 0) : begin], change[end - 1 : end]])
    return bool(np.median(around) < _RESTS * step and ends.max() < _GOES_ON * step) if len(around) else False
