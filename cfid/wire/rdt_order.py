"""Puts RDT records in order and counts lost, duplicate, late and garbled ones; knows no clock and no port."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt

from cfid.wire.rdt import LONGEST_BUFFER, RECORD, Records

_WRAP = 1 << 32
_HALF = 1 << 31
_REMEMBERED = 1 << 12  # missing records; an older one that arrives after all counts as a duplicate


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


@dataclass
class _Stream:
    """The answer to a request: record n has ft_sequence `offset` + `step` n. Those before `next` were taken or lost."""

    step: int
    offset: int
    next: int = 1
    missing: npt.NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))

    @classmethod
    def of(cls, records: Records) -> Self | None:
        """Return the stream of the first three records that advance in step, by their numbers; None without three."""
        numbers = np.unique(np.stack((records["rdt_sequence"], records["ft_sequence"])).astype(np.int64), axis=1)
        apart = np.diff(numbers[0])
        step, rest = np.divmod((np.diff(numbers[1]) + _HALF) % _WRAP - _HALF, np.maximum(apart, 1))
        in_step = (apart > 0) & (step > 0) & (rest == 0)
        agreed = np.flatnonzero(in_step[1:] & in_step[:-1] & (step[1:] == step[:-1]))
        if not len(agreed):
            return None
        first_step, (rdt, ft) = int(step[agreed[0]]), numbers[:, agreed[0]].tolist()
        return cls(first_step, (ft - first_step * rdt) % _WRAP, next=rdt)

    def has(self, records: Records) -> npt.NDArray[np.bool_]:
        """Return which records are of this stream.

        The distances from `next` must agree, not only their remainders modulo 2^32: there, an even step would hide a
        flipped high bit of rdt_sequence.
        """
        passed = _apart(records["ft_sequence"], self.offset + self.step * self.next)
        return np.asarray(passed == self.step * _apart(records["rdt_sequence"], self.next))

    def continues_with(self, records: Records) -> bool:
        """Return whether these are the very next records, in order; then count them as taken."""
        numbers = self.next + np.arange(len(records))
        is_next = np.array_equal(records["rdt_sequence"], numbers % _WRAP) and np.array_equal(
            records["ft_sequence"], (self.offset + self.step * numbers) % _WRAP
        )
        self.next += len(records) if is_next else 0
        return is_next

    def in_order(self, records: Records, arrivals: Arrivals) -> Records:
        """Return the new ones among records of this stream, in order, and count the others and those that are lost."""
        number, arrived = np.unique(self.next + _apart(records["rdt_sequence"], self.next), return_index=True)
        is_new = number >= self.next
        is_late = np.isin(number, self.missing)
        arrivals.late += int(is_late.sum())
        arrivals.duplicates += len(records) - int((is_new | is_late).sum())
        self.missing = self.missing[~np.isin(self.missing, number)]
        number, arrived = number[is_new], arrived[is_new]
        if not len(number):
            return records[:0]
        as_they_came = number[np.argsort(arrived)]
        arrivals.reordered += int(np.sum(as_they_came < np.maximum.accumulate(as_they_came)))
        end = int(number[-1]) + 1
        arrivals.lost += end - self.next - len(number)
        due = np.arange(max(self.next, end - _REMEMBERED), end)
        self.missing = np.concatenate((self.missing, due[~np.isin(due, number)]))[-_REMEMBERED:]
        self.next = end
        return records[arrived]


class RecordOrder:
    """The order of one box' records over any number of requests.

    A record has two counters: its number in the answer to a request, from 1, and the box' own count of samples.
    Three records whose counters advance in step establish how the two are related. A record whose counters disagree
    with that, because it is garbled or left over from the previous request, is rejected, so that a flipped bit never
    looks like a loss. Three such records in a row that agree with each other begin another stream, for example the
    answer to a repeated request.
    """

    def __init__(self) -> None:
        """Start with nothing known of the box."""
        self.arrivals = Arrivals()
        self._stream: _Stream | None = None
        self._previous: _Stream | None = None  # the answer to the request before this one
        self._held = np.empty(0, RECORD)  # of no known stream, since the last record that was of one

    @property
    def step(self) -> int | None:
        """The step of ft_sequence from one record to the next; None until known for this request."""
        return None if self._stream is None else self._stream.step

    def begin(self) -> None:
        """Expect the records of a new request, numbered from 1."""
        self._previous = self._stream or self._previous
        self._stream = None
        self._held = np.empty(0, RECORD)

    def take(self, records: Records) -> Records:
        """Return the records that are new, in order; records are held back until three agree on the stream."""
        if self._stream is not None and not len(self._held) and self._stream.continues_with(records):
            return records
        self.arrivals.rejected -= len(self._held)
        records = np.concatenate((self._held, records))
        taken, fits = np.empty(0, RECORD), np.zeros(len(records), np.bool_)
        if self._stream is not None:
            fits = self._stream.has(records)
            taken = self._stream.in_order(records[fits], self.arrivals)
        self.arrivals.rejected += int(np.sum(~fits))
        others = records[np.flatnonzero(np.append(True, fits))[-1] :]
        if self._previous is not None:
            others = others[~self._previous.has(others)]
        begun = self._begun(others)
        if begun is None:
            self._held = others[-LONGEST_BUFFER:]
            return taken
        self._stream, self._held = begun, others
        return np.concatenate((taken, self.take(np.empty(0, RECORD))))

    def _begun(self, records: Records) -> _Stream | None:
        """Return the stream that three records begin, which goes on from the present one's number or starts at 1."""
        begun = _Stream.of(records)
        if begun is None:
            return None
        if self._stream is not None and (begun.next - self._stream.next) % _WRAP < _HALF:
            begun.next, begun.missing = self._stream.next, self._stream.missing
        else:
            begun.next = 1
        return begun if begun.has(records).any() else None


def _apart(numbers: npt.NDArray[np.uint32], origin: int) -> npt.NDArray[np.int64]:
    """Return how far 32-bit numbers are from an origin, the short way round."""
    return (numbers - np.uint32(origin % _WRAP)).astype(np.int32).astype(np.int64)
