"""Find voltages that a supply cannot have had: those beyond any supply's, and a few far off the others.

A lithium cell has 2.5 to 4.35 V: a battery of any number of cells stays within a third of its median, and sags under
load by less than that. A supply that is set to other voltages has many beyond.
"""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

RANGE_V = (1.0, 60.0)  # from less than that of one cell to more than that of twelve
_FAR = 1 / 3  # of the median
_MOST_SHARE = 0.1  # of the voltages; more are those of a supply that is set to others


def impossible(volts: Array) -> Mask:
    """Return which voltages (n,) of a recording are numbers that its supply cannot have had."""
    known = np.isfinite(volts)
    beyond = known & ~((volts > RANGE_V[0]) & (volts < RANGE_V[1]))
    middle = usual(volts, beyond)
    far = known & ~beyond & (np.abs(volts - middle) > _FAR * middle)
    return beyond | far if np.count_nonzero(far) <= _MOST_SHARE * len(volts) else beyond


def usual(volts: Array, wrong: Mask) -> float:
    """Return the median of the voltages (n,) that are possible, nan where there is none."""
    values = volts[np.isfinite(volts) & ~wrong]
    return float(np.median(values)) if len(values) else np.nan
