"""Keeps the extremes of signals over time at ever coarser resolutions: pictures of any span in bounded memory."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

BINS = 8192  # of each level: more than a screen has columns, and more than a second at 7 kHz


class Envelope(NamedTuple):
    """The start (b,) of each bin, and the smallest and largest values (b, c) within it."""

    time_s: Array
    low: Array
    high: Array

    def zigzag(self) -> tuple[Array, Array]:
        """Return a line through all extremes: times (2 b,) and values (2 b, c)."""
        return np.repeat(self.time_s, 2), np.stack([self.low, self.high], axis=1).reshape(-1, self.low.shape[1])


class Extremes:
    """A pyramid of bins: level k has bins of 2^k samples, of which it keeps the newest.

    The last level of `BINS` or fewer bins reaches back to the first sample, so that every span can be drawn: a recent
    one sample by sample, an old one as coarsely as memory demands.
    """

    def __init__(self, channels: int, *, bins: int = BINS) -> None:
        """Start without a sample; each level keeps `bins` to twice as many bins."""
        self._channels, self._bins = channels, bins
        self._levels: list[_Level] = []

    def add(self, time_s: Array, values: Array) -> None:
        """Add samples (n,), (n, channels) after the previous ones. A NaN is left out of its bin."""
        for begin in range(0, len(time_s), self._bins):
            part = slice(begin, begin + self._bins)
            self._add(0, Envelope(time_s[part], values[part], values[part]))

    def view(self, begin_s: float, end_s: float, most: int) -> Envelope:
        """Return at most `most` bins, and one beyond each end, of the finest level that covers the span."""
        empty = np.empty((0, self._channels))
        if not self._levels:
            return Envelope(np.empty(0), empty, empty)
        parts: list[Envelope] = []
        for level in self._levels:
            found = level.between(begin_s, end_s)
            if len(found.time_s) <= most + 2 and level.reaches(begin_s):
                break
            if len(level.carry.time_s) and level.carry.time_s[0] <= end_s:  # not in any coarser bin yet
                parts.insert(0, level.carry)
        parts.insert(0, found)
        return Envelope(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def newest(self) -> tuple[Array, Array]:
        """Return the newest samples, `BINS` or more of them: times (n,), values (n, c)."""
        kept = self._levels[0].kept if self._levels else self.view(0.0, 0.0, 0)
        return kept.time_s, kept.low

    def _add(self, k: int, new: Envelope) -> None:
        """Append bins to a level, and each pair of them to the next as one."""
        if k == len(self._levels):
            self._levels.append(_Level(self._bins, self._channels))
        pairs = self._levels[k].append(new)
        if len(pairs.time_s):
            self._add(k + 1, pairs)


class _Level:
    """The newest bins of one resolution; `carry` is the last bin as long as it has no partner."""

    def __init__(self, bins: int, channels: int) -> None:
        self._bins, self._fill, self._dropped = bins, 0, False
        self._time = np.empty(2 * bins)
        self._low, self._high = np.empty((2 * bins, channels)), np.empty((2 * bins, channels))
        self.carry = Envelope(np.empty(0), self._low[:0], self._high[:0])

    @property
    def kept(self) -> Envelope:
        return Envelope(self._time[: self._fill], self._low[: self._fill], self._high[: self._fill])

    def reaches(self, begin_s: float) -> bool:
        return not self._dropped or bool(self._time[0] <= begin_s)

    def between(self, begin_s: float, end_s: float) -> Envelope:
        first, last = np.searchsorted(self._time[: self._fill], [begin_s, end_s])
        part = slice(max(first - 1, 0), last + 1)
        return Envelope(*(column[part] for column in self.kept))

    def append(self, new: Envelope) -> Envelope:
        """Append bins and return the pairs that became complete."""
        count = len(new.time_s)
        if self._fill + count > 2 * self._bins:
            keep = slice(self._fill - self._bins, self._fill)
            for column in (self._time, self._low, self._high):
                column[: self._bins] = column[keep].copy()
            self._fill, self._dropped = self._bins, True
        place = slice(self._fill, self._fill + count)
        self._time[place], self._low[place], self._high[place] = new
        self._fill += count
        waiting = Envelope(*(np.concatenate(pair) for pair in zip(self.carry, new, strict=True)))
        even = len(waiting.time_s) // 2 * 2
        self.carry = Envelope(*(column[even:] for column in waiting))
        return Envelope(
            waiting.time_s[:even:2],
            np.fmin(waiting.low[:even:2], waiting.low[1:even:2]),
            np.fmax(waiting.high[:even:2], waiting.high[1:even:2]),
        )
