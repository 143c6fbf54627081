"""Finds readings of a steady level that show another one: a sensor that drops out, whose mean is of neither."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_FAR = 6.0  # times what half of the readings are within: four deviations of noise, and beyond any vibration's crest
_MOVED = 0.005  # of the level, by which the mean is off the middle: less is what gusts and skewed noise do
_MOST_SHARE = 0.02  # of the readings, that may be far on one side more than on the other, or repeat one value
_OFTEN, _FEWEST_VALUES = 4.0, 10  # times as often as any other of so many values, as no noise has one
_FEWEST_TIMES = 3  # that another level comes back: what settles, or stands still, reaches it once


def other_level(value: Array, *, finest: float = 0.0) -> str:
    """Return how many of the readings (n,) of a steady level show another one, and which, "" where they do not.

    Again and again, they lie far from the others on one side: what is far on both sides alike, as a vibration that
    comes and goes, leaves the mean right, and so does what is not far enough, as of gusts. Or they repeat one value
    between others, within a vibration too. Steps of a coarse scale, and what is smaller than `finest`, are not far.
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
    """Return whether readings (n,) are found again and again between others: what still settles is no other level."""
    return bool(np.count_nonzero(np.diff(those, prepend=False, append=False)) >= 2 * _FEWEST_TIMES)


def _share(count: int, value: Array) -> str:
    return f"{100 * count / len(value):.0f} % of its readings"
