"""Times the records of a load cell's stream on the host's clock, by the box' own count."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.rig.clock import Array, SampleClock
from cfid.wire import rdt

_RESOLUTION_S = 1e-6  # of the time column
_CONTRADICTION_S = 0.2  # between a record's arrival and the time of its count: the box started a new count


class TimedArrivals(NamedTuple):
    """The records that ended a datagram (m,), their arrival times (m,), and the time at which all were read."""

    record: npt.NDArray[np.intp]
    came_s: Array
    read_s: float


def arrivals_of(records: rdt.Records, ended: npt.NDArray[np.uint32], came_s: Array, *, read_s: float) -> TimedArrivals:
    """Find the ends of datagrams among records in order; `ended` (m,) are their ft_sequence in order of arrival."""
    first = records["ft_sequence"][0]
    passed, passed_at_end = records["ft_sequence"] - first, ended - first
    place = np.searchsorted(passed, passed_at_end).clip(max=len(passed) - 1)
    there = passed[place] == passed_at_end
    return TimedArrivals(place[there], came_s[there], read_s)


class RecordTimes:
    """Times of records, which never decrease. The box states `rate_hz` in whole hertz: 7000/3 as 2333."""

    def __init__(self, *, rate_hz: float) -> None:
        """Take the rate as the box states it."""
        self.rate_hz = float(rate_hz)
        self.jumped = 0  # samples by which the count jumped against the host's clock, in all
        self._samples: SampleClock | None = None
        self._last_ft: int | None = None
        self._last_s = -np.inf

    def learn(self, step: int) -> None:
        """Take the step of ft_sequence from one record to the next, which gives the exact rate."""
        if self._samples is None:
            ticks_per_s = ticks_per_s_of(self.rate_hz, step)
            self._samples = SampleClock(ticks_per_s=ticks_per_s)
            self.rate_hz = ticks_per_s / step

    def began_anew(self, records: rdt.Records, arrivals: TimedArrivals) -> bool:
        """Return whether the count of the first records after a silence contradicts their arrival."""
        if self._samples is None:
            return False
        record, came_s = (arrivals.record[0], arrivals.came_s[0]) if len(arrivals.record) else (-1, arrivals.read_s)
        predicted_s = self._samples.predicted_s(int(records["ft_sequence"][record]))
        return bool(abs(came_s - predicted_s) > _CONTRADICTION_S)

    def restart(self) -> None:
        """Forget the count: the box started a new one."""
        self._last_ft = None
        if self._samples is not None:
            self._samples.restart()

    def instants_s(self, records: rdt.Records, arrivals: TimedArrivals) -> Array:
        """Return when records in order were sampled. The step has to be known.

        Where the count jumps back, or beyond the present time, a new count begins.
        """
        at = self._jump(records, arrivals.read_s)
        if at is None:
            return self._counted_s(records, arrivals)
        parts = [records[:at], records[at:]]
        early = arrivals.record < at
        came = [
            TimedArrivals(arrivals.record[early], arrivals.came_s[early], arrivals.read_s),
            TimedArrivals(arrivals.record[~early] - at, arrivals.came_s[~early], arrivals.read_s),
        ]
        before_s = self._counted_s(parts[0], came[0]) if at else np.empty(0)
        self.restart()
        return np.concatenate([before_s, self._counted_s(parts[1], came[1])])

    def _jump(self, records: rdt.Records, read_s: float) -> int | None:
        """Return the first record after a jump of the count, None without one; count the samples of the jump."""
        assert self._samples is not None
        if self._last_ft is None:
            return None
        counts = np.concatenate([np.array([self._last_ft], np.uint32), records["ft_sequence"]])
        steps = np.diff(counts).astype(np.int32)
        at = int(np.argmax(np.abs(steps.astype(np.int64))))
        early_s = self._samples.predicted_s(int(records["ft_sequence"][-1])) - read_s
        if steps[at] > 0 and early_s < _CONTRADICTION_S:
            return None
        self.jumped += abs(int(steps[at])) // max(int(np.median(np.abs(steps))), 1)
        return at

    def _counted_s(self, records: rdt.Records, arrivals: TimedArrivals) -> Array:
        """Return the instants of records of one count."""
        assert self._samples is not None
        instants_s = self._samples.instants_s(
            records["ft_sequence"], arrived=arrivals.record, arrival_s=arrivals.came_s, read_s=arrivals.read_s
        )
        if instants_s[0] <= self._last_s:  # the anchor after a restart may lie before the end of the gap
            instants_s = instants_s + (self._last_s + _RESOLUTION_S - instants_s[0])
        self._last_s, self._last_ft = float(instants_s[-1]), int(records["ft_sequence"][-1])
        return instants_s


def ticks_per_s_of(rate_hz: float, step: int) -> float:
    """Return the counts of ft_sequence per second: a Net F/T's 7000, unless no rounding of the rate explains that."""
    rounded = (rate_hz - 1) * step < rdt.INTERNAL_HZ < (rate_hz + 1) * step
    return float(rdt.INTERNAL_HZ if rounded else rate_hz * step)
