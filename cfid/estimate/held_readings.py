"""Distinguish readings that a device repeats in several rows from those of a sensor with coarse steps."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# In steps of the sensor: a coarse sensor never changes by more in one row after it stood still for some rows.
_STEPS = 3.0
_FEWEST, _SHARE = 10, 0.1  # such changes, and their part of all: gaps in rows also cause some
_OTHERS = 0.1  # of these changes: the part that may follow a single row, as the end of a spike does
_SAME = 1e-9  # of the range: smaller changes are rounding
# The part of such changes that follow a single row where each row has its own reading, with noise of a step or more.
_SINGLE = 0.75
_LONGEST = 0.9  # the part of the readings that last for this number of rows or fewer
_ALIKE = 0.7  # of a value: values above this part of it are rounded as it is
_LONGEST_S = 0.3  # of readings that show a lag: during longer ones, nothing moves


class Readings(NamedTuple):
    """The numbers of rows and of readings, and the interval between rows, by which a reading may be older."""

    rows: int
    read: int
    row_s: float

    @property
    def age_s(self) -> float:
        """The interval between rows where readings are repeated, 0 where each row has its own."""
        return self.row_s if self.read < self.rows else 0.0


def once_each(time_s: Array, value: Array) -> tuple[Mask, Readings]:
    """Return which values (n,), or rows of several axes (n, k), at times (n,) are new readings, and how many there are.

    Values that are not numbers do not count. A row that repeats a reading shows an earlier value: it is late by up to
    the time between two readings.
    """
    counts: Mask = np.all(np.atleast_2d(np.isfinite(value).T), axis=0)
    row_s = float(np.median(np.diff(time_s[counts]))) if np.count_nonzero(counts) > 1 else 0.0
    new = new_rows(value[counts], longest=_LONGEST_S / row_s if row_s else np.inf)
    found = Readings(len(new), int(np.count_nonzero(new)), row_s)
    counts[counts] = new
    return counts, found


def rows_a_reading(readings: Array) -> int:
    """Return the number of rows in which a device repeats each reading (n,), 1 where it does not, or nothing moves.

    While something moves, a coarse sensor that repeated a reading changes by one step; a sensor that is read less often
    than rows are sent changes by many.
    """
    changes, by = _changes(readings)
    if len(changes) < 2:
        return 1
    lasted = np.diff(changes)[by[1:] > _STEPS * by.min()]
    if len(lasted) < max(_FEWEST, _SHARE * len(changes)) or np.quantile(lasted, _OTHERS) < 2:
        return 1
    return int(np.median(lasted))


def first_rows(readings: Array, *, rows: int) -> Mask:
    """Return which rows (n,) are the first of a reading that is repeated in about this number of `rows`.

    A value that lasts several times as long counts as several readings.
    """
    begin = np.r_[0, _changes(readings)[0]]
    count = np.maximum(np.rint(np.diff(np.r_[begin, len(readings)]) / rows), 1).astype(int)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    kept = np.zeros(len(readings), dtype=bool)
    kept[np.repeat(begin, count) + rows * place] = True
    return kept


def new_rows(readings: Array, *, longest: float) -> Mask:
    """Return which rows have a new reading (n,), all rows where nearly each has its own.

    Axes of one sensor (n, k) are read together: a row is new where any of them changes. The number of rows per reading
    is found from rows in which readings change by more than steps of the sensor, after a similar change at most
    `longest` rows before: other rows may show a coarse sensor of something steady. A value that lasts longer than
    readings do is several readings, and the first row of each is new.
    """
    new, changed, moved = np.zeros((3, len(readings)), dtype=bool)
    for axis in np.atleast_2d(readings.T):
        rows, by = _changes(axis)
        changed[rows] = True
        if len(rows):
            moved[rows] |= by > _STEPS * _steps(axis)[rows]
    begins = np.flatnonzero(changed)
    if len(begins) < _FEWEST:
        return ~new
    far = moved[begins]
    lasted = np.diff(begins)[far[:-1] & far[1:]]
    lasted = lasted[lasted <= longest]
    if len(lasted) < _FEWEST or np.mean(lasted == 1) > _SINGLE:
        return ~new
    longer = int(np.quantile(lasted, _LONGEST))
    for first, last in zip([0, *begins], [*begins, len(readings)], strict=True):
        new[first : max(last - longer, first) + 1 : longer] = True
    return new


def _steps(readings: Array) -> Array:
    """Return the step (n,) of a sensor at each of its readings (n,); it may be coarser for larger readings."""
    sizes = np.unique(np.abs(readings))
    least = max(_SAME * float(sizes[-1]), np.finfo(float).tiny)
    gaps = np.diff(sizes, append=np.inf)
    gaps[gaps <= least] = np.inf
    alike = (np.log(np.maximum(sizes, least)) // -np.log(_ALIKE)).astype(int)
    smallest = np.full(np.ptp(alike) + 1, np.inf)
    np.minimum.at(smallest, alike - alike.min(), gaps)
    return np.asarray(smallest[alike - alike.min()][np.searchsorted(sizes, np.abs(readings))])


def _changes(readings: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Return the rows (m,) whose reading differs from the previous one, and the size of the change (m,)."""
    by = np.abs(np.diff(readings))
    changed = by > _SAME * (np.ptp(readings) if len(readings) else 0.0)
    return np.flatnonzero(changed) + 1, by[changed]
