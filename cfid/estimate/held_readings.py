"""Distinguish readings that a device repeats in several rows from those of a sensor with coarse steps.

While something moves, a coarse sensor with a reading in each row changes by a step or two; a sensor that is read less
often than rows are sent stands still and then changes by many.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STEPS = 3.0  # of the sensor: the least change that shows that something moves
_SAME = 1e-9  # of the range: smaller changes are rounding
_ALIKE = 0.7  # of a value: values above this part of it are rounded as it is
_FEWEST = 10  # pairs of such changes
_SINGLE = 0.75  # the part of such changes that follow a single row where each row has its own reading
_LONGEST = 0.9  # the part of the readings that last for this number of rows or fewer
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
    readings = value[counts]
    new = first_rows(readings, rows=rows_a_reading(readings, longest=_LONGEST_S / row_s if row_s else np.inf))
    found = Readings(len(new), int(np.count_nonzero(new)), row_s)
    counts[counts] = new
    return counts, found


def rows_a_reading(readings: Array, *, longest: float = np.inf) -> int:
    """Return the number of rows in which a device repeats each reading (n,) or (n, k), 1 where it does not.

    It is 1 also where nothing moves. Axes of one sensor (n, k) are read together. Readings count that last from one
    change by more than steps of the sensor to the next, at most `longest` rows later; where they last unequally, most
    last no longer than the number returned.
    """
    begins, moves = _changes(readings)
    lasted = np.diff(begins)[moves[:-1] & moves[1:]]
    lasted = lasted[lasted <= longest]
    if len(lasted) < _FEWEST or np.mean(lasted == 1) > _SINGLE:
        return 1
    return int(np.quantile(lasted, _LONGEST))


def first_rows(readings: Array, *, rows: int) -> Mask:
    """Return which rows (n,) or (n, k) are the first of a reading that is repeated in about this number of `rows`.

    A value that lasts several times as long counts as several readings.
    """
    begin = np.append(0, _changes(readings)[0])[: len(readings)]
    count = np.maximum(np.rint(np.diff(begin, append=len(readings)) / rows), 1).astype(int)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    first = np.zeros(len(readings), dtype=bool)
    first[np.repeat(begin, count) + rows * place] = True
    return first


def _changes(readings: Array) -> tuple[npt.NDArray[np.intp], Mask]:
    """Return the rows (m,) in which any axis changes, and which of the changes exceed steps of the sensor (m,)."""
    changes, moves = np.zeros((2, len(readings)), dtype=bool)
    for axis in np.atleast_2d(readings.T):
        by = np.abs(np.diff(axis))
        rows = np.flatnonzero(by > _SAME * np.ptp(axis)) + 1 if len(by) else np.zeros(0, dtype=np.intp)
        if len(rows):
            changes[rows] = True
            moves[rows] |= by[rows - 1] > _STEPS * _steps(axis)[rows]
    return np.flatnonzero(changes), moves[changes]


def _steps(readings: Array) -> Array:
    """Return the step (n,) of a sensor at each of its readings (n,): the median distance of values of like size.

    Some sensors are coarser for large values. At a steady speed all changes are alike, and only values of different
    turns show the step; single wrong readings lie between the others.
    """
    values = np.unique(readings)
    size, gaps = np.abs(values), np.diff(values, append=np.inf)
    least = max(_SAME * float(size.max()), np.finfo(float).tiny)
    _, alike = np.unique(np.log(np.maximum(size, least)) // -np.log(_ALIKE), return_inverse=True)
    steps = np.full(alike.max() + 1, np.inf)
    for group in range(len(steps)):
        shown = gaps[(alike == group) & (gaps > least) & np.isfinite(gaps)]
        if len(shown):
            steps[group] = np.median(shown)
    return np.asarray(steps[alike][np.searchsorted(values, readings)])
