"""Times samples on the host's monotonic clock, which steps of the wall clock do not shift, and on a device's clock."""

import time
from collections import deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

REMEMBERED_BLOCKS = 40  # two seconds' worth: several quick arrivals, and hardly any drift


def ahead_s(read: Callable[[], float]) -> float:
    """Return how far a clock is ahead of the monotonic one; the least interrupted of a few readings counts."""
    tries = [(time.monotonic(), read(), time.monotonic()) for _ in range(5)]
    before, there, after = min(tries, key=lambda times: times[2] - times[0])
    return there - (before + after) / 2


def unwrapped(ticks: npt.NDArray[np.int64], last: int | None) -> npt.NDArray[np.int64]:
    """Continue a count of 32 bits (n,) from the last one known; none comes late by half of their range."""
    begin = int(ticks[0]) if last is None else last
    half = 1 << 31
    steps = (np.diff(ticks, prepend=begin % (2 * half)) + half) % (2 * half) - half
    return np.asarray(begin + np.cumsum(steps))


class SampleClock:
    """Instants of samples that a device counts, on the host's clock.

    Arrivals are late by a delay with a lower bound. So the device's count, times its nominal step, gives the instants
    up to an offset, which the quickest arrivals of the last two seconds determine. The offset is corrected so slowly
    that neighbouring samples keep their distance. The smallest delay itself stays in the times: on a dedicated cable
    it is a constant well below a millisecond.
    """

    def __init__(self, *, ticks_per_s: float) -> None:
        """Take the nominal rate of the count."""
        self._ticks_per_s = ticks_per_s
        self._last_ticks: int | None = None
        self._offset_s = 0.0
        self._at_s = 0.0  # of the last sample, on the device's clock
        self._quickest: deque[float] = deque(maxlen=REMEMBERED_BLOCKS)

    def restart(self) -> None:
        """Forget the count: the device started a new one."""
        self._last_ticks = None
        self._quickest.clear()

    def predicted_s(self, ticks: int) -> float:
        """Return when a sample with this count is expected to arrive."""
        return float(self._unwrapped(np.array([ticks], np.uint32))[0] / self._ticks_per_s + self._offset_s)

    def instants_s(
        self, ticks: npt.NDArray[np.uint32], *, arrived: npt.NDArray[np.intp], arrival_s: Array, read_s: float
    ) -> Array:
        """Return the instants of samples with the counts `ticks` (n,), which wrap at 2^32.

        `arrived` (m,) are the samples that ended a datagram, `arrival_s` (m,) the times at which it arrived. `read_s`
        is when the samples were read: it replaces the last arrival as long as none is known.
        """
        counts = self._unwrapped(ticks)
        self._last_ticks = int(counts[-1])
        device_s = counts / self._ticks_per_s
        delays_s = arrival_s - device_s[arrived]
        fresh = not self._quickest
        if len(delays_s):
            self._quickest.append(float(delays_s.min()))
        if not self._quickest:
            return np.asarray(device_s + (read_s - device_s[-1]))
        if fresh:
            self._offset_s, self._at_s = self._quickest[-1], float(device_s[0])
        # The fastest correction is 0.07 microseconds from one sample to the next at 7 kHz.
        most_s = 5e-4 * max(float(device_s[-1]) - self._at_s, 0.0)
        change_s = float(np.clip(min(self._quickest) - self._offset_s, -most_s, most_s))
        grown = np.interp(device_s, (self._at_s, device_s[-1]), (0.0, change_s)) if most_s else 0.0
        instants_s = device_s + self._offset_s + grown
        self._offset_s, self._at_s = self._offset_s + change_s, float(device_s[-1])
        return np.asarray(instants_s)

    def _unwrapped(self, ticks: npt.NDArray[np.uint32]) -> Array:
        """Continue a count (n,) from the last one known."""
        begin = int(ticks[0]) if self._last_ticks is None else self._last_ticks
        steps = (ticks - np.uint32(begin % (1 << 32))).astype(np.int32).astype(np.int64)
        return np.asarray(begin + steps, dtype=np.float64)
