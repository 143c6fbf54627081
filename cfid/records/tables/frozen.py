"""Readings that stand still while what they show moves on: a sensor or its wire that hung for a moment."""

import numpy as np
import numpy.typing as npt

from cfid.large import differences, some_steps

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

_MOST_STRETCHES = 0.002  # over the readings: more show a sensor that is slower than the rows
_FEWEST = 4  # equal readings, as many as show the speed before and after them
# By how many of the smallest usual steps a value moves on meanwhile. A slow motion that turns back stays within one of
# them for a while, and makes at most eight of them in that time by its speed before and after.
_STEPS, _SMALLEST = 16, 0.01


def frozen_readings(value: Array) -> Rows:
    """Return the places of equal readings of a series (n,) before and after which it moves fast, but for the first.

    A rest begins or ends slowly, or ends the series, and is none. Many such stretches are those of a slow sensor.
    """
    steps = np.abs(some_steps(value))
    if not np.any(steps > 0):
        return np.empty(0, np.intp)
    least = _STEPS * float(np.quantile(steps[steps > 0], _SMALLEST))
    found = [np.empty(0, np.intp)]
    for begin, step in differences(value):
        changes = begin + 1 + np.flatnonzero(step)  # where another value begins
        first, behind = changes[:-1], changes[1:]
        held = (behind - first >= _FEWEST) & (first >= _FEWEST) & (behind + _FEWEST < len(value))
        first, behind = first[held], behind[held]
        before = np.abs(value[first] - value[first - _FEWEST]) / _FEWEST
        after = np.abs(value[behind + _FEWEST] - value[behind]) / _FEWEST
        frozen = np.minimum(before, after) * (behind - first) > least
        found += [np.arange(one + 1, end) for one, end in zip(first[frozen], behind[frozen], strict=True)]
    return np.concatenate(found) if len(found) - 1 <= _MOST_STRETCHES * len(value) else found[0]
