"""Readings that repeat the one before for longer than readings usually do: their sensor hung, or was not read."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_ROWS, _TIMES, _RARELY = 10.0, 5.0, 0.99  # times as many as usual, and as a share of all values takes at most
_LONG_S = 0.05  # shorter ones change nothing


def repeated(time_s: Array, value: Array) -> Mask:
    """Return which readings (n,) at times (n,) are of one value for long; those of few digits usually last longer."""
    begins = np.concatenate([np.zeros(1, np.intp), np.flatnonzero(np.diff(value) != 0) + 1])
    rows = np.diff(begins, append=len(value))
    lasts_s = time_s[begins + rows - 1] - time_s[begins]
    least = max(_ROWS * float(np.median(rows)), _TIMES * float(np.quantile(rows, _RARELY)))
    return np.repeat((rows >= least) & (lasts_s >= _LONG_S), rows)
