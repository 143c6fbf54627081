"""Find readings of a steady level that show another one: a sensor that drops out, with a mean between two levels."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_FAR = 6.0  # times the median distance: four standard deviations of noise, and beyond any vibration's crest
_MOVED = 0.005  # of the level: a smaller distance of the mean from the median may be due to gusts and skewed noise
_MOST_SHARE = 0.02  # of the readings: the most that may be far on one side more than on the other, or repeat one value
# Times as often as any other of at least this many values, which does not occur in noise.
_OFTEN, _FEWEST_VALUES = 4.0, 10
_FEWEST_TIMES = 3  # the least returns of another level: a signal that settles or stands still reaches it once


def other_level(value: Array, *, finest: float = 0.0) -> str:
    """Return how many of the readings (n,) of a steady level show another one, and which, "" where they do not.

    These readings are repeatedly far from the others on one side: if they are far on both sides, as in a vibration that
    comes and goes, the mean is still right, and so it is if they are not far enough, as in gusts. Or the readings
    repeat one value between others, even within a vibration. Steps of a coarse scale, and distances below `finest`, are
    not far.
    """
    if not len(value):
        return ""
    return _far(value, finest) or _repeated(value)


def _far(value: Array, finest: float) -> str:
    middle = float(np.median(value))
    off = value - middle
    steps = np.diff(np.unique(value))
    step = float(steps[steps > finest].min(initial=np.inf))
    limit = _FAR * max(float(np.median(np.abs(off))), step if np.isfinite(step) else 0.0, finest)
    above, below = off > limit, off < -limit
    high, low = int(np.count_nonzero(above)), int(np.count_nonzero(below))
    far = above if high > low else below
    moved = abs(float(np.mean(value)) - middle) > _MOVED * abs(middle)
    if not moved or abs(high - low) <= _MOST_SHARE * len(value) or not _comes_back(far):
        return ""
    other = float(np.median(value[far]))
    return f"{_share(high + low, value)} lie far from the others, at about {other:.3g} where those show {middle:.3g}"


def _repeated(value: Array) -> str:
    values, counts = np.unique(value, return_counts=True)
    if len(values) < _FEWEST_VALUES:
        return ""
    usual, most = np.sort(counts)[-2:]
    if most < _OFTEN * usual or most <= _MOST_SHARE * len(value):
        return ""
    one = float(values[np.argmax(counts)])
    return f"{_share(int(most), value)} repeat {one:.3g} between others" if _comes_back(value == one) else ""


def _comes_back(those: npt.NDArray[np.bool_]) -> bool:
    """Return whether these readings (n,) recur between others: a signal that is still settling has no other level."""
    return bool(np.count_nonzero(np.diff(those, prepend=False, append=False)) >= 2 * _FEWEST_TIMES)


def _share(count: int, value: Array) -> str:
    return f"{100 * count / len(value):.0f} % of its readings"
