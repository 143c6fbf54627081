"""Single readings that stand off alone between two that agree: faults of a sensor or its wire, and no motion."""

import numpy as np
import numpy.typing as npt

from cfid.large import differences

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

MOST_SHARE = 0.01  # of the readings: more are no single faults
_RANKED = 100_000  # readings whose bends show what is usual


def usual_bend(value: Array, share: float) -> float:
    """Return the second difference that a share of a series (n,) does not exceed, by parts of a long one."""
    length = _RANKED // 10
    some = [value[at : at + length] for at in range(0, len(value), max(len(value) // 10, length))]
    return float(np.quantile(np.concatenate([np.zeros(1), *(np.abs(np.diff(one, n=2)) for one in some)]), share))


def lone_readings(value: Array, limit: float) -> Rows:
    """Return the places of a series (n,) that are farther off their neighbours than a limit, within which these agree.

    The first and the last reading are off alone where they miss the line through the next two.
    """
    bent = [begin + 1 + np.flatnonzero(np.abs(step) > 2 * limit) for begin, step in differences(value, order=2)]
    places = np.concatenate([np.empty(0, np.intp), *bent])
    before, here, after = value[places - 1], value[places], value[places + 1]
    lone = places[(np.abs(here - (before + after) / 2) > limit) & (np.abs(after - before) < limit)]
    return np.concatenate([_end(value[:4], limit), lone, len(value) - 1 - _end(value[:-5:-1], limit)])


def _end(value: Array, limit: float) -> Rows:
    """Return the place of a first reading of four that is farther off the line of the others than they bend."""
    if len(value) < 4 or abs(value[0] - 2 * value[1] + value[2]) <= 2 * limit:
        return np.empty(0, np.intp)
    return np.zeros(int(abs(value[1] - 2 * value[2] + value[3]) < limit), np.intp)
