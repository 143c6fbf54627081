"""Puts RDT records in order and counts lost, duplicate, late and garbled ones; knows no clock and no port."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.wire.rdt import LONGEST_BUFFER, Records

_WRAP = 1 << 32
_HALF = 1 << 31
_KNOWN_GAPS = 4096  # remembered; a record of an older gap that arrives after all counts as a duplicate
_LONGEST_STEP = 1 << 16
_LOOKED_AT = LONGEST_BUFFER  # latest records, in which a stream is sought
_AGREEING_PAIRS = 3  # of three records: two records always lie on some line, garbled or not


@dataclass
class Arrivals:
    """How records came in.

    `lost` records never came, or came too late to be written; `late` of these came after all. `reordered` ones
    came after a later one but could be put back in place. `rejected` ones had sequence numbers that contradict the
    stream's, or are still held back because the stream is not known yet. Every record that was not taken is counted
    in one of `late`, `duplicates` and `rejected`.
    """

    lost: int = 0
    late: int = 0
    reordered: int = 0
    duplicates: int = 0
    rejected: int = 0


class _Line(NamedTuple):
    """A stream: record n has ft_sequence offset + step n."""

    step: int
    offset: int


class RecordOrder:
    """The order of one box' records over any number of requests.

    Each request numbers its records from 1, and the box also counts its own samples: the two numbers
    advance in step. A record whose two numbers do not, because it is garbled or left over from the previous
    request, is rejected, so that a flipped bit in either number never looks like a loss.

    The first three records that agree establish how the two numbers are related. Three others that agree with each
    other, with no record between them that fits, begin another stream, for example the answer to a repeated request.
    """

    def __init__(self) -> None:
        """Start with nothing known of the box."""
        self.arrivals = Arrivals()
        self.step: int | None = None  # of ft_sequence from one record to the next; None until known for this request
        self._line: _Line | None = None
        self._earlier: tuple[_Line, int] | None = None
        self._held: Records | None = None  # records that fit no known stream, since the last that fitted
        self._next = 1
        self._gaps: list[tuple[int, int]] = []

    def begin(self) -> None:
        """Expect the records of a new request, numbered from 1."""
        if self._line is not None:
            self._earlier = self._line, self._next
        self._line = self.step = self._held = None
        self._next = 1
        self._gaps = []

    def take(self, records: Records) -> Records:
        """Return the records that are new, in order; records are held back until three agree on the stream."""
        fits = self._fit(records)
        if fits.all():
            if len(fits):
                self._held = None
            return self._in_order(records)
        self.arrivals.rejected += int(np.sum(~fits))
        taken = self._in_order(_chosen(records, fits))
        held = self._hold(records, fits)
        line = _common_line(held)
        if line is None:
            return taken
        self._follow(line, held)
        self.arrivals.rejected -= len(held.rdt_sequence)
        return _joined(taken, self.take(held))

    def _fit(self, records: Records) -> npt.NDArray[np.bool_]:
        if self._line is None:
            return np.zeros(len(records.rdt_sequence), np.bool_)
        return _lie_on(records, self._line, near=self._next)

    def _hold(self, records: Records, fits: npt.NDArray[np.bool_]) -> Records:
        """Return all records since the last that fitted, and hold the last few of them."""
        if fits.any():
            self._held = None
            records = _chosen(records, slice(int(np.flatnonzero(fits)[-1]) + 1, None))
        if self._earlier is not None:
            line, near = self._earlier
            records = _chosen(records, ~_lie_on(records, line, near=near))
        held = records if self._held is None else _joined(self._held, records)
        self._held = _chosen(held, slice(-_LOOKED_AT, None))
        return held

    def _follow(self, line: _Line, held: Records) -> None:
        """Adopt a line as the stream's: it continues where the previous line ended, or starts anew from 1."""
        self._line, self.step, self._held = line, line.step, None
        first = held.rdt_sequence[_lie_on(held, line, near=1)].min()
        if first < self._next:
            self._next, self._gaps = 1, []

    def _in_order(self, records: Records) -> Records:
        place = self._next + _apart(records.rdt_sequence, self._next)
        count = len(place)
        if not count:
            return records
        if place[0] == self._next and place[-1] == self._next + count - 1 and np.all(np.diff(place) == 1):
            self._next += count
            return records
        order = np.argsort(place, kind="stable")
        first = np.concatenate(([True], np.diff(place[order]) > 0))
        self.arrivals.duplicates += count - int(first.sum())
        order = order[first]
        fresh = place[order] >= self._next
        for old in place[order[~fresh]].tolist():
            self._count_old(old)
        order = order[fresh]
        as_come = place[np.sort(order)]
        self.arrivals.reordered += int(np.sum(as_come < np.maximum.accumulate(as_come)))
        self._count_gaps(place[order])
        return _chosen(records, order)

    def _count_old(self, place: int) -> None:
        """Count a record that comes after later ones were taken: late if it was missing, else a duplicate."""
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


def _apart(numbers: npt.NDArray[np.uint32], origin: int) -> npt.NDArray[np.int64]:
    """Return how far 32-bit numbers are from an origin, the short way round."""
    return (numbers - np.uint32(origin % _WRAP)).astype(np.int32).astype(np.int64)


def _lie_on(records: Records, line: _Line, *, near: int) -> npt.NDArray[np.bool_]:
    """Return which records lie on a line, up to whole wraps of either number.

    The distances from `near` must agree, not only their remainders modulo 2^32: there, an even step would hide a
    flipped high bit of rdt_sequence.
    """
    along = _apart(records.ft_sequence, line.offset + line.step * near)
    return np.asarray(along == line.step * _apart(records.rdt_sequence, near))


def _common_line(records: Records) -> _Line | None:
    """Return the line on which most of the last few records lie, at least three with different numbers, or None."""
    few = _chosen(records, slice(-_LOOKED_AT, None))
    rdt, ft = np.unique(np.stack((few.rdt_sequence, few.ft_sequence)).astype(np.int64), axis=1)
    one, other = np.triu_indices(len(rdt), 1)
    one, other = one[rdt[one] < rdt[other]], other[rdt[one] < rdt[other]]
    step, rest = np.divmod((ft[other] - ft[one] + _HALF) % _WRAP - _HALF, rdt[other] - rdt[one])
    possible = (rest == 0) & (step > 0) & (step < _LONGEST_STEP) & (step * rdt[other] < _HALF)
    step, one = step[possible], one[possible]
    lines, pairs = np.unique(step << 32 | (ft[one] - step * rdt[one]) % _WRAP, return_counts=True)
    if not len(lines) or pairs.max() < _AGREEING_PAIRS:
        return None
    best = int(lines[np.argmax(pairs)])
    return _Line(step=best >> 32, offset=best % _WRAP)


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
