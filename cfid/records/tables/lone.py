"""Find readings that are off alone between others that agree, or far off all: faults of a sensor, not motion."""

import numpy as np
import numpy.typing as npt

from cfid.large import differences, parts

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

MOST_SHARE = 0.01  # of the readings; more are not single faults
_MOST_IN_ROW = 3  # readings that are off together
_PIECES, _PIECE_ROWS = 100, 200  # of a series, which show what is usual
# A spike: relative to a signal's range without its extremes, and times the bend that a share of it does not exceed.
_SPIKE, _FARTHEST, _SPIKE_TIMES, _USUAL = 0.2, (0.5, 99.5), 10.0, 0.95
_ALMOST_ALL, _FAR_TIMES = (1.0, 99.0), 10.0  # percentiles of a signal, and times their distance from each other

_steps_may_overflow = np.errstate(over="ignore", invalid="ignore")  # a damaged number may have any size


@_steps_may_overflow
def usual_bend(value: Array, share: float, *, period: float | None = None) -> float:
    """Return the second difference that a share of a series (n,) does not exceed, from pieces of a long one.

    `period` is the length of a circle on which the values lie.
    """
    bends = np.abs(_shortest(np.diff(_pieces(value), n=2), period))
    return float(np.quantile(bends, share)) if bends.size else 0.0


@_steps_may_overflow
def lone_readings(value: Array, limit: float, *, period: float | None = None) -> Rows:
    """Return the places of up to three readings in a row that are all farther than a limit off the others' course.

    Without them, the series (n,) stays on its course within that limit, or they begin or end it. `period` is the length
    of a circle on which the values lie.
    """
    left_of = [  # the course bends before the first of them
        begin + 1 + np.flatnonzero(np.abs(_shortest(bend, period)) > limit / 2)
        for begin, bend in differences(value, order=2)
    ]
    lefts = np.concatenate([np.zeros(1, np.intp), *left_of])
    found = [_end(value[:4], limit, period), len(value) - 1 - _end(value[:-5:-1], limit, period)]
    for width in range(1, _MOST_IN_ROW + 1):
        left = lefts[lefts + width + 1 < len(value)]
        left = left[_goes_on(value, left, left + width + 1, limit, period)][:, np.newaxis]
        inside = np.arange(1, width + 1)
        course = _shortest(value[left + width + 1] - value[left], period) * inside / (width + 1)
        off = np.abs(_shortest(value[left + inside] - value[left] - course, period)) > limit
        found.append((left + inside)[off.all(axis=1)].ravel())
    return np.unique(np.concatenate(found))


@_steps_may_overflow
def displaced_readings(value: Array, limit: float, *, period: float | None = None) -> Rows:
    """Return the places of readings between a jump by more than a limit and the next one, which reverses it.

    At most one in a hundred of all readings (n,) lie between such jumps. `period` is the length of a circle on which
    the values lie.
    """
    bent = [
        begin + 1 + np.flatnonzero(np.abs(_shortest(bend, period)) > limit)
        for begin, bend in differences(value, order=2)
    ]
    left = np.concatenate([np.empty(0, np.intp), *bent])
    left = left[(left > 1) & (left + 3 < len(value))]
    jump = _jump(value, left, period)
    neighbours = np.maximum(*(np.abs(_jump(value, left + side, period)) for side in (-1, 1)))
    is_one = (np.abs(jump) > limit) & (np.abs(jump) > neighbours)  # next to a jump, the course bends by half of it
    left, jump = left[is_one], jump[is_one]
    back = (np.abs(_shortest(jump[:-1] + jump[1:], period)) < limit) & (np.diff(left) <= MOST_SHARE * len(value))
    places, at = [np.empty(0, np.intp)], 0
    while at < len(back):
        if back[at]:
            places.append(np.arange(left[at] + 1, left[at + 1] + 1))
        at += 1 + int(back[at])  # a jump that reverses another begins no segment of its own
    found = np.concatenate(places)
    return found if len(found) <= MOST_SHARE * len(value) else found[:0]


def spikes_in(value: Array) -> Rows:
    """Return the places of samples of a signal (n,) that are off alone by a fifth of the signal's range.

    Samples that are nan do not count, and more than one in a hundred are not single faults.
    """
    if not all(np.isfinite(value[part]).all() for part in parts(len(value))):
        known = np.flatnonzero(np.isfinite(value))
        return known[spikes_in(value[known])]
    low, high = np.percentile(_pieces(value), _FARTHEST) if len(value) else (0.0, 0.0)
    limit = max(_SPIKE * float(high - low), _SPIKE_TIMES * usual_bend(value, _USUAL))
    places = lone_readings(value, limit) if limit > 0 else np.empty(0, np.intp)
    return places if len(places) <= MOST_SHARE * len(value) else places[:0]


def far_in(value: Array) -> Rows:
    """Return the places of samples of a signal (n,) that are off the middle by ten times the range of almost all.

    Any number may be next to each other, but more than one in a hundred are not faults.
    """
    some = _pieces(value)
    some = some[np.isfinite(some)]
    if not len(some):
        return np.empty(0, np.intp)
    low, middle, high = np.percentile(some, [_ALMOST_ALL[0], 50.0, _ALMOST_ALL[1]])
    off = (np.abs(value[part] - middle) > _FAR_TIMES * (high - low) for part in parts(len(value)))
    found = np.flatnonzero(np.concatenate(list(off)))
    return found if high > low and len(found) <= MOST_SHARE * len(value) else found[:0]


def _pieces(value: Array) -> Array:
    """Return pieces (m, k) of neighbours from all over a long series (n,), and all of a short one (1, n)."""
    if len(value) <= _PIECES * _PIECE_ROWS:
        return value[np.newaxis]
    begins = np.linspace(0, len(value) - _PIECE_ROWS, _PIECES).astype(np.intp)
    return np.asarray(value[begins[:, np.newaxis] + np.arange(_PIECE_ROWS)])


def _jump(value: Array, left: Rows, period: float | None) -> Array:
    """Return by how much values (n,) change after places (m,) beyond the mean of the changes before and after."""
    before, here, after = (_shortest(value[left + i + 1] - value[left + i], period) for i in (-1, 0, 1))
    return _shortest(here - (before + after) / 2, period)


def _goes_on(value: Array, left: Rows, right: Rows, limit: float, period: float | None) -> npt.NDArray[np.bool_]:
    """Return whether the values at places `left` and `right` (m,) lie on one course, by the slope before or after."""
    way = _shortest(value[right] - value[left], period)
    before = _shortest(value[left] - value[left - 1], period)
    after = _shortest(value[np.minimum(right + 1, len(value) - 1)] - value[right], period)
    before = np.where(left > 0, before, after)
    after = np.where(right + 1 < len(value), after, before)
    slopes = np.stack([before, after, (before + after) / 2])
    return np.asarray((np.abs(way - (right - left) * slopes) < limit).any(axis=0))


def _shortest(step: Array, period: float | None) -> Array:
    """Return steps, on a circle the shorter way around."""
    return step if period is None else step - period * np.rint(step / period)


def _end(value: Array, limit: float, period: float | None) -> Rows:
    """Return the place of the first of four readings where it alone is off the course of the others, else none."""
    bends = np.abs(_shortest(np.diff(value, n=2), period))
    return np.zeros(int(len(bends) == 2 and bends[0] > 2 * limit and bends[1] < limit), np.intp)
