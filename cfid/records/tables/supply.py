"""Find voltages that a supply cannot have had: those beyond any supply's, and those that jump off the others and back.

A lithium cell has 2.5 to 4.35 V: a battery of any number of cells stays within a third of its median, and sags under
load by less than that. A supply that is swept leaves this range, but continues from there.
"""

import numpy as np
import numpy.typing as npt

from cfid.large import chosen_rows, differences, parts

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

RANGE_V = (1.0, 60.0)  # from less than that of one cell to more than that of twelve
_JUMP = 1 / 3  # of the median
_MOST, _MOST_AT_ENDS = 0.1, 0.01  # of the values; more are those of a supply that is set to other voltages
_RANKED = 1_000_000  # values that show the median


def impossible(volts: Array) -> Mask:
    """Return which voltages (n,) of a recording are numbers that its supply cannot have had at that time."""
    found = np.isfinite(volts) & ~((volts > RANGE_V[0]) & (volts < RANGE_V[1]))
    possible = np.isfinite(volts) & ~found
    found[possible] = displaced(chosen_rows(volts, possible))
    return found


def displaced(volts: Array, *, jump: float = _JUMP) -> Mask:
    """Return which voltages (n,) are in segments that jump off the others and back, and are never near the median.

    All voltages are numbers; `jump` is relative to the median. The few before the first jump need not have jumped off,
    and the few after the last one need not jump back.
    """
    middle = usual(volts, np.zeros(len(volts), bool))
    limit = jump * middle
    jumps = [begin + 1 + np.flatnonzero(np.abs(step) > limit) for begin, step in differences(volts)]
    begins = np.concatenate([np.zeros(1, np.intp), *jumps])
    if len(begins) == 1 or not middle > 0:
        return np.zeros(len(volts), bool)
    lengths = np.diff(begins, append=len(volts))
    near = np.concatenate([np.abs(volts[part] - middle) <= limit for part in parts(len(volts))])
    is_near, place = np.logical_or.reduceat(near, begins), np.arange(len(begins))
    before = np.maximum.accumulate(np.where(is_near, place, -1))
    behind = np.minimum.accumulate(np.where(is_near, place, len(place))[::-1])[::-1]
    at_end = (before < 0) | (behind == len(place))
    first, last = volts[begins], volts[begins + lengths - 1]
    back = ~at_end & (np.abs(last[before] - first[np.minimum(behind, len(place) - 1)]) <= limit)
    off = ~is_near & (back | (at_end & (lengths[at_end].sum() <= _MOST_AT_ENDS * len(volts))))
    if lengths[off].sum() > _MOST * len(volts):
        off[:] = False
    return np.repeat(off, lengths)


def usual(volts: Array, wrong: Mask) -> float:
    """Return the median of the voltages (n,) that are possible, nan where there is none."""
    some = slice(None, None, len(volts) // _RANKED + 1)
    values = volts[some][np.isfinite(volts[some]) & ~wrong[some]]
    return float(np.median(values)) if len(values) else np.nan
