"""Find readings that repeat the one before for longer than usual: their sensor hung, or was not read."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.large import differences

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# A long repeat has so many times the median rows of a value, and times those that this share of values does not exceed.
_ROWS, _TIMES, _RARELY = 10.0, 5.0, 0.99
_LONG_S = 0.05  # shorter ones change nothing
# Rows that are examined on both sides; the usual change there, and the changes at the ends, are below so many steps.
_AROUND, _RESTS, _GOES_ON = 20, 1.5, 2.5


def repeated(time_s: Array, value: Array) -> Mask:
    """Return which readings (n,) at times (n,) repeat one value for long; values of few digits usually last longer.

    Readings that change by at most one step at a time repeat a value without a fault: what is measured barely moves
    there, and continues from the same value.
    """
    begins, step = _changes(value)
    rows = np.diff(begins, append=begins.dtype.type(len(value)))
    found = np.zeros(len(value), bool)
    if rows.max() < _ROWS:
        return found
    least = max(_ROWS * float(np.median(rows)), _TIMES * float(np.quantile(rows, _RARELY)))
    for place in np.flatnonzero(rows >= least):
        begin, end = int(begins[place]), int(begins[place]) + int(rows[place])
        if time_s[end - 1] - time_s[begin] >= _LONG_S and not _rests(value, begin, end, step=step):
            found[begin:end] = True
    return found


def _changes(value: Array) -> tuple[npt.NDArray[np.signedinteger[Any]], float]:
    """Return the rows (k,) at which readings (n,) take a new value, and the smallest change, inf without any."""
    of_row = np.int32 if len(value) <= np.iinfo(np.int32).max else np.int64
    begins, smallest = [np.zeros(1, of_row)], [math.inf]
    for at, step in differences(value):
        changed = np.flatnonzero(step)
        begins.append((at + 1 + changed).astype(of_row))
        smallest.append(np.abs(step[changed]).min(initial=math.inf))
    return np.concatenate(begins), float(np.min(smallest))


def _rests(value: Array, begin: int, end: int, *, step: float) -> bool:
    """Return whether readings (n,) between two rows repeat one value because they barely change, and in steps."""
    before, after = value[max(begin - _AROUND, 0) : begin], value[end : end + _AROUND + 1]
    around = np.abs(np.concatenate([np.diff(before), np.diff(after)]))
    ends = np.abs(np.concatenate([np.diff(value[max(begin - 1, 0) : begin + 1]), np.diff(value[end - 1 : end + 1])]))
    return bool(np.median(around) < _RESTS * step and ends.max() < _GOES_ON * step) if len(around) else False
