"""Tell readings that a device repeats in several rows from those of a sensor with coarse steps."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STEPS = 3.0  # of the sensor, by which a coarse one changes in no row after it stood still for some
_FEWEST, _SHARE = 10, 0.1  # such changes, and of all: gaps in rows make some, too
_OTHERS = 0.1  # of them, which may follow a single row: what ends a spike does
_SAME = 1e-9  # of the range: what rounding changes


def rows_a_reading(readings: Array) -> int:
    """Return in how many rows a device repeats each of its readings (n,), 1 where it does not, or where nothing moves.

    While something moves, a coarse sensor that repeated a reading goes on by one step; one that is read less often
    than rows are sent goes on by many.
    """
    changes, by = _changes(readings)
    if len(changes) < 2:
        return 1
    lasted = np.diff(changes)[by[1:] > _STEPS * by.min()]
    if len(lasted) < max(_FEWEST, _SHARE * len(changes)) or np.quantile(lasted, _OTHERS) < 2:
        return 1
    return int(np.median(lasted))


def first_rows(readings: Array, *, rows: int) -> Mask:
    """Return which rows (n,) are the first of a reading that is repeated in about so many `rows`.

    A value that lasts several times as long is several readings.
    """
    begin = np.r_[0, _changes(readings)[0]]
    count = np.maximum(np.rint(np.diff(np.r_[begin, len(readings)]) / rows), 1).astype(int)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    kept = np.zeros(len(readings), dtype=bool)
    kept[np.repeat(begin, count) + rows * place] = True
    return kept


def _changes(readings: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Return the rows (m,) whose reading differs from that before, and by how much (m,)."""
    by = np.abs(np.diff(readings))
    changed = by > _SAME * np.ptp(readings)
    return np.flatnonzero(changed) + 1, by[changed]
