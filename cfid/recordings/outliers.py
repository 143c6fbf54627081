"""Find readings that no motion and no force makes: outliers, and those of a stuck sensor.

Arrays in, masks out. A few such readings are faults of a sensor, which a reader leaves out; many show a recording of
another kind, of which none is marked.
"""

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from cfid.large import parts

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]

MOST_SHARE = 0.01  # of the readings; more are no single faults

_AROUND = 3  # readings on each side, with which a reading is compared: as many are found in a row
_WIDTH = 2 * _AROUND + 1
# An outlier leaves the median around it by a fifth of the 0.5 to 99.5 percentile range, and by five times the 95th
# percentile of such distances; far beyond the others is ten times the 1 to 99 percentile range off their median.
_RANGE_SHARE, _RANGE = 0.2, (0.5, 99.5)
_TYPICAL, _TIMES_TYPICAL = 0.95, 5.0
_FAR_TIMES, _FAR_RANGE = 10.0, (1.0, 50.0, 99.0)
_PIECES, _PIECE_ROWS = 100, 200  # of a long series, which show what is usual

# A sensor is stuck for ten times the median length of its runs of equal readings, and five times their 99th percentile.
_MEDIAN_RUNS, _LONG_RUNS, _QUANTILE = 10.0, 5.0, 0.99
_LEAST_S = 0.05  # shorter runs change nothing
# Of readings in steps that barely move: the median change of these rows on both sides, and the changes at the ends.
_BESIDE, _STILL_STEPS, _RESUME_STEPS = 20, 1.5, 2.5


def outliers(values: Array, limit: float | None = None, *, most_share: float = MOST_SHARE) -> Mask:
    """Return which readings of a series (n,) lie off the course of those around them, up to three in a row.

    They are farther than `limit` off the median of the seven around them; without a limit, than a fifth of the series'
    range, and readings far beyond all others are outliers too. Steps stay, and so do readings whose distance is usual
    in the series. Missing readings (nan) are none; more than `most_share` are no faults, and then none is marked.
    """
    known = np.isfinite(values)
    if not known.all():
        mask = np.zeros(len(values), bool)
        mask[known] = outliers(values[known], limit, most_share=most_share)
        return mask
    if len(values) < _WIDTH:
        return np.zeros(len(values), bool)
    pieces = _pieces(len(values))
    some = np.concatenate([values[piece] for piece in pieces])
    usual = np.concatenate([_distance(values, piece) for piece in pieces])
    low, high = np.percentile(some, _RANGE)
    least = max(
        _RANGE_SHARE * float(high - low) if limit is None else limit,
        _TIMES_TYPICAL * float(np.quantile(usual, _TYPICAL)),
    )
    off = np.concatenate([_distance(values, part) > least for part in parts(len(values))])
    off = _still_off(values, off, least)
    if limit is None:
        low, middle, high = np.percentile(some, _FAR_RANGE)
        if high > low:
            for part in parts(len(values)):
                off[part] |= np.abs(values[part] - middle) > _FAR_TIMES * (high - low)
    return off if np.mean(off) <= most_share else np.zeros_like(off)


def stuck(values: Array, time_s: Array | None = None) -> Mask:
    """Return which readings (n,) repeat one value for much longer than usual, and for 50 ms where times (n,) are given.

    Readings that barely move, in steps, repeat a value without a fault: the series continues from the same value. A
    sensor that is slower than its rows is not stuck.
    """
    begins, step = _runs(values)
    rows = np.diff(begins, append=len(values))
    mask = np.zeros(len(values), bool)
    if not len(rows) or rows.max() < _MEDIAN_RUNS:
        return mask
    least = max(_MEDIAN_RUNS * float(np.median(rows)), _LONG_RUNS * float(np.quantile(rows, _QUANTILE)))
    for place in np.flatnonzero(rows >= least):
        begin, end = int(begins[place]), int(begins[place] + rows[place])
        lasts = time_s is None or time_s[end - 1] - time_s[begin] >= _LEAST_S
        mask[begin:end] = lasts and not _barely_moves(values, begin, end, step)
    return mask


def _pieces(rows: int) -> list[slice]:
    """Return pieces of neighbours from all over a long series, and all of a short one."""
    if rows <= _PIECES * _PIECE_ROWS:
        return [slice(0, rows)]
    begins = np.linspace(0, rows - _PIECE_ROWS, _PIECES).astype(int)
    return [slice(begin, begin + _PIECE_ROWS) for begin in begins.tolist()]


def _distance(values: Array, part: slice) -> Array:
    """Return how far the readings of a part of a series (n,) lie off the median of the seven around each."""
    around = values[max(part.start - _AROUND, 0) : part.stop + _AROUND]
    if part.start == 0:
        around = np.concatenate([_before(around), around])
    if part.stop == len(values):
        around = np.concatenate([around, _before(around[::-1])[::-1]])
    return np.asarray(np.abs(around - median_filter(around, _WIDTH)))[_AROUND:-_AROUND]


def _before(values: Array) -> Array:
    """Return readings (3,) that continue a series (n,) before its begin, on the course of its first seven."""
    first = values[:_WIDTH]
    line = float(np.median(np.diff(first))) * np.arange(-_AROUND, len(first))
    return np.asarray(line[:_AROUND] + float(np.median(first - line[_AROUND:])))


def _still_off(values: Array, off: Mask, limit: float) -> Mask:
    """Return the readings among those that are `off` (n,) that also leave the line between the others."""
    places, good = np.flatnonzero(off), np.flatnonzero(~off)
    behind = np.searchsorted(good, places)
    inside = (behind > 0) & (behind < len(good))
    places, right, left = places[inside], good[behind[inside]], good[behind[inside] - 1]
    course = (values[right] - values[left]) * (places - left) / (right - left)
    off[places] = np.abs(values[places] - values[left] - course) > limit
    return off


def _runs(values: Array) -> tuple[Rows, float]:
    """Return the rows (k,) at which readings (n,) take a new value, and the smallest change, inf without any."""
    begins, smallest = [np.zeros(min(len(values), 1), np.intp)], math.inf
    for part in parts(len(values) - 1):
        step = np.diff(values[part.start : part.stop + 1])
        changed = np.flatnonzero(step)
        begins.append(part.start + 1 + changed)
        smallest = min(smallest, float(np.abs(step[changed]).min(initial=math.inf)))
    return np.concatenate(begins), smallest


def _barely_moves(values: Array, begin: int, end: int, step: float) -> bool:
    """Return whether readings (n,) between two rows repeat one value since they barely change, and in steps."""
    before, after = values[max(begin - _BESIDE, 0) : begin], values[end : end + _BESIDE + 1]
    beside = np.abs(np.concatenate([np.diff(before), np.diff(after)]))
    ends = np.abs(np.concatenate([np.diff(values[max(begin - 1, 0) : begin + 1]), np.diff(values[end - 1 : end + 1])]))
    return bool(np.median(beside) < _STILL_STEPS * step and ends.max() < _RESUME_STEPS * step) if len(beside) else False
