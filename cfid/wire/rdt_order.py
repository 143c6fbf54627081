"""Puts RDT records in order and counts what is lost, doubled, late or garbled; knows no clock and no port."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.wire.rdt import Records

_WRAP = 1 << 32
_KNOWN_GAPS = 4096  # remembered; what is older and arrives after all is taken for a duplicate
_LONGEST_STEP = 1 << 16


@dataclass
class Arrivals:
    """How records came in.

    `lost` never came, or too late to be written; `late` of them came after all. `reordered` came after a
    later one but could be put back in place. `rejected` had sequence numbers that contradict the stream's.
    """

    lost: int = 0
    late: int = 0
    reordered: int = 0
    duplicates: int = 0
    rejected: int = 0


class RecordOrder:
    """The order of one box' records over any number of requests.

    Each request numbers its records from 1, and the box counts its own samples beside: the two numbers
    advance in step. A record in which they do not, be it garbled or left over from the request before, is
    rejected, so that a flipped bit in either number never looks like a loss.
    """

    def __init__(self) -> None:
        """Start with nothing known of the box."""
        self.arrivals = Arrivals()
        self.step: int | None = None  # of ft_sequence from one record to the next
        self._offset: int | None = None
        self._earlier_offset: int | None = None
        self._held: Records | None = None
        self._next = 1
        self._gaps: list[tuple[int, int]] = []

    def begin(self) -> None:
        """Expect the records of a new request, numbered from 1."""
        self._earlier_offset, self._offset = self._offset, None
        self._held = None
        self._next = 1
        self._gaps = []

    def take(self, records: Records) -> Records:
        """Return the records that are new, in order; records are held back until two agree on the stream."""
        if self._offset is None:
            records = records if self._held is None else _joined(self._held, records)
            self._held = records
            if not self._learn(records):
                return _chosen(records, slice(0, 0))
            self._held = None
        assert self.step is not None
        fitting = _offsets(records, self.step) == self._offset
        if not fitting.all():
            self.arrivals.rejected += len(fitting) - int(fitting.sum())
            records = _chosen(records, fitting)
        return self._in_order(records)

    def _learn(self, records: Records) -> bool:
        """Find out how the two numbers go together, from two records at least."""
        if self.step is None:
            following = np.diff(records.rdt_sequence) == 1
            steps = np.diff(records.ft_sequence)[following]
            steps = steps[(steps > 0) & (steps < _LONGEST_STEP)]
            if not len(steps):
                return False
            self.step = _most_common(steps)[0]
        offsets = _offsets(records, self.step)
        offsets = offsets[offsets != self._earlier_offset] if self._earlier_offset is not None else offsets
        if not len(offsets):
            return False
        offset, count = _most_common(offsets)
        if count < 2:
            return False
        self._offset = offset
        return True

    def _in_order(self, records: Records) -> Records:
        place = self._next + (records.rdt_sequence - np.uint32(self._next % _WRAP)).astype(np.int32).astype(np.int64)
        count = len(place)
        if not count:
            return records
        if place[0] == self._next and place[-1] == self._next + count - 1 and np.all(np.diff(place) == 1):
            self._next += count
            return records
        self.arrivals.reordered += int(np.sum(place < np.maximum.accumulate(place)))
        order = np.argsort(place, kind="stable")
        place = place[order]
        first = np.concatenate(([True], np.diff(place) > 0))
        self.arrivals.duplicates += count - int(first.sum())
        order, place = order[first], place[first]
        fresh = place >= self._next
        for old in place[~fresh].tolist():
            self._count_old(old)
        order, place = order[fresh], place[fresh]
        self._count_gaps(place)
        return _chosen(records, order)

    def _count_old(self, place: int) -> None:
        """Count a record whose turn is over: late if it was missed, else a duplicate."""
        for i, (begin, end) in enumerate(self._gaps):
            if begin <= place < end:
                self.arrivals.late += 1
                self._gaps[i : i + 1] = [gap for gap in ((begin, place), (place + 1, end)) if gap[0] < gap[1]]
                return
        self.arrivals.duplicates += 1

    def _count_gaps(self, place: npt.NDArray[np.int64]) -> None:
        edges = np.concatenate(([self._next - 1], place))
        for i in np.flatnonzero(np.diff(edges) > 1).tolist():
            self._gaps.append((int(edges[i]) + 1, int(edges[i + 1])))
            self.arrivals.lost += int(edges[i + 1] - edges[i]) - 1
        del self._gaps[:-_KNOWN_GAPS]
        self._next = int(edges[-1]) + 1


def _offsets(records: Records, step: int) -> npt.NDArray[np.uint32]:
    return records.ft_sequence - np.uint32(step) * records.rdt_sequence


def _most_common(values: npt.NDArray[np.uint32]) -> tuple[int, int]:
    found, counts = np.unique(values, return_counts=True)
    best = int(np.argmax(counts))
    return int(found[best]), int(counts[best])


def _chosen(records: Records, which: slice | npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> Records:
    return Records(
        records.rdt_sequence[which], records.ft_sequence[which], records.status[which], records.counts[which]
    )


def _joined(one: Records, other: Records) -> Records:
    return Records(
        np.concatenate((one.rdt_sequence, other.rdt_sequence)),
        np.concatenate((one.ft_sequence, other.ft_sequence)),
        np.concatenate((one.status, other.status)),
        np.concatenate((one.counts, other.counts)),
    )
