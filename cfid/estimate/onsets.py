"""Find when a thrust started to follow each change, and with what lag: thrust is the square of a first-order speed."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.signals import Slow
from cfid.estimate.windows import CHANGE_SEEN_S, Interval, level

Array = npt.NDArray[np.float64]

_EARLY_S, _LATE_S = 0.1, 0.6  # limits of an onset relative to a stamped command
_STEP_S, _LEAST_LAG_S = 0.04, 0.01
_EXPLAINED, _FEWEST_SEEN = 0.9, 10
_LOOK_S, _USUAL_LAG_S = 2.0, 0.1


class Onset(NamedTuple):
    """The time at which thrust started to follow a change, its time constant, and the variance explained by them."""

    time_s: float
    lag_s: float
    explained: float


def onsets(slow: Slow, intervals: Sequence[Interval], *, baseline: float, lag_s: float | None = None) -> list[Onset]:
    """Return the onset of each interval except the first, which has none; a given lag applies to all.

    Thrust above `baseline` is the square of a first-order speed. Where no onset explains the record (a step in the
    noise, or one that is shorter than its onset), the median lag of the others is used instead, and after a command
    also their median delay.
    """
    levels = [0.0 if each.pause else level(slow, each.begin_s, each.end_s) - baseline for each in intervals]
    steps = list(zip(intervals[:-1], intervals[1:], map(_share, levels[:-1], levels[1:]), strict=True))
    found = [_onset(slow, *step, lag_s=lag_s) for step in steps]
    pairs = list(zip(intervals[1:], found, strict=True))
    sure = [(onset.time_s - each.begin_s, onset.lag_s) for each, onset in pairs if onset.explained > _EXPLAINED]
    delay_s, usual_s = np.median(sure, axis=0).tolist() if sure else (0.0, lag_s or _USUAL_LAG_S)
    for i, (interval, onset) in enumerate(pairs):
        if onset.explained <= _EXPLAINED and interval.commands is None:
            found[i] = _onset(slow, *steps[i], lag_s=usual_s)
        elif onset.explained <= _EXPLAINED:
            found[i] = Onset(interval.begin_s + delay_s, usual_s, onset.explained)
    return found


def _share(before: float, after: float) -> float:
    """Return the first of two speeds relative to their sum, from the thrusts."""
    first, second = math.sqrt(abs(before)), math.sqrt(abs(after))
    return first / (first + second) if first + second > 0 else 0.5


def _onset(slow: Slow, before: Interval, interval: Interval, share: float, *, lag_s: float | None) -> Onset:
    """Fit onset and lag of a step by a search that becomes finer and narrower."""
    seen_change = interval.commands is None  # the time lies in the middle of the rise, as does that of the next change
    early_s, late_s = (_LATE_S, _EARLY_S) if seen_change else (_EARLY_S, _LATE_S)
    begin_s, length_s = interval.begin_s, interval.end_s - interval.begin_s
    from_s = max(begin_s - early_s, (before.begin_s + before.end_s) / 2)
    to_s = begin_s + min(_LOOK_S, max(length_s - seen_change * CHANGE_SEEN_S, length_s / 2))
    times = np.arange(from_s, begin_s + min(late_s, length_s / 2), _STEP_S)
    lags = np.geomspace(_LEAST_LAG_S, max(length_s / 2, 2 * _LEAST_LAG_S), 8) if lag_s is None else np.array([lag_s])
    best = Onset(begin_s, lag_s or _USUAL_LAG_S, 0.0)
    for finer in (None, 1.0, 1.0, 0.3, 0.1):
        if finer is not None:
            near = finer * np.linspace(-1, 1, 5)
            times, lags = best.time_s + _STEP_S * near, best.lag_s * 1.8**near if lag_s is None else lags
        seen = slow.between(times[0] - 2 * _EARLY_S, to_s)
        if len(seen.value) < _FEWEST_SEEN or np.ptp(seen.value) == 0:
            return best
        best = _search(seen, times, lags, share)
    return best


def _search(seen: Slow, times: Array, lags: Array, share: float) -> Onset:
    """Return the onset that explains most of the observed variance, among the given times and lags."""
    time_s, value = seen.time_s[::2], seen.value[::2] - seen.value[::2].mean()
    gone = 1 - np.exp(-np.maximum(time_s - times[:, np.newaxis], 0)[:, np.newaxis] / lags[:, np.newaxis])
    response = 2 * share * gone + (1 - 2 * share) * gone**2
    response -= response.mean(axis=-1, keepdims=True)
    explained = (response @ value) ** 2 / np.maximum(np.einsum("tln,tln->tl", response, response), 1e-300)
    at, lag = np.unravel_index(np.argmax(explained), explained.shape)
    return Onset(float(times[at]), float(lags[lag]), float(explained[at, lag] / max(value @ value, 1e-300)))
