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
        """Start without a sample; each level keeps `bins`, an even number, to twice as many bins."""
        self._bins, self._first_s = bins, np.inf
        # A bin is a row of its start, its smallest values, and its largest ones negated: the minimum of two rows is
        # then the bin of both. The last of an odd number of bins has no partner yet, and is in no coarser bin.
        self._buffers, self._filled = [np.empty((2 * bins, 1 + 2 * channels))], [0]

    @property
    def _levels(self) -> list[Array]:
        return [buffer[:filled] for buffer, filled in zip(self._buffers, self._filled, strict=True)]

    def add(self, time_s: Array, values: Array) -> None:
        """Add samples (n,), (n, channels) after the previous ones. A NaN is left out of its bin."""
        if len(time_s):
            self._first_s = min(self._first_s, float(time_s[0]))
        samples = np.column_stack([time_s, values, -values])
        for begin in range(0, len(samples), self._bins):
            self._append(samples[begin : begin + self._bins])

    def _append(self, new: Array) -> None:
        """Append bins to the finest level, and each pair that became complete to the next one as one bin."""
        for k, buffer in enumerate(self._buffers):
            filled = self._filled[k]
            waiting = np.concatenate([buffer[filled // 2 * 2 : filled], new])
            if filled + len(new) > len(buffer):
                dropped = (filled - self._bins + 1) // 2 * 2
                buffer[: filled - dropped] = buffer[dropped:filled].copy()
                filled -= dropped
            self._filled[k] = filled + len(new)
            buffer[filled : self._filled[k]] = new
            pairs = len(waiting) // 2 * 2
            new = np.fmin(waiting[:pairs:2], waiting[1:pairs:2])
            if not len(new):
                return
            if k + 1 == len(self._buffers):
                self._buffers.append(np.empty_like(buffer))  # which this loop reaches next
                self._filled.append(0)

    def view(self, begin_s: float, end_s: float, most: int) -> Envelope:
        """Return at most `most` bins, and one beyond each end, of the finest level that covers the span."""
        parts: list[Array] = []
        for level in self._levels:
            first, last = np.searchsorted(level[:, 0], [begin_s, end_s])
            found = level[max(first - 1, 0) : last + 1]
            if len(found) <= most + 2 and (level[:1, 0] <= max(begin_s, self._first_s)).all():
                break
            if len(level) % 2 and level[-1, 0] <= end_s:
                parts.insert(0, level[-1:])
        return _envelope(np.concatenate([found, *parts]))

    def newest(self) -> tuple[Array, Array]:
        """Return the newest samples, `BINS` or more of them: times (n,), values (n, c)."""
        return _envelope(self._levels[0])[:2]


def _envelope(bins: Array) -> Envelope:
    low, negated = np.split(bins[:, 1:], 2, axis=1)
    return Envelope(bins[:, 0], low, -negated)
