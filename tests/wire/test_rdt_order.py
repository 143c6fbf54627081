"""The order of RDT records compared with a simple model of sets: which records are taken, and how all others count."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire.rdt import RECORD
from cfid.wire.rdt_order import Arrivals, RecordOrder
from tests.wire.pieces import FEW

STEPS = (1, 2, 4, 7, 8, 70, 700, 7000)
WRAP = 1 << 32


class Sent(NamedTuple):
    """Both counters of a record as it arrives, and its place in the request, 0 where it has to be rejected."""

    rdt: int
    ft: int
    place: int = 0


def stream(first: int, last: int, *, start: int = 1000, step: int = 7) -> list[Sent]:
    """Return records `first` to `last` of a request that began at ft_sequence `start`."""
    return [Sent(place % WRAP, (start + step * place) % WRAP, place) for place in range(first, last + 1)]


def garbled(record: Sent, bit: int) -> Sent:
    """Return a record with one of its 64 bits of both counters flipped."""
    counters = (record.rdt << 32 | record.ft) ^ 1 << bit
    return Sent(counters >> 32, counters % WRAP)


def places(records: Sequence[Sent]) -> list[int]:
    return [record.place for record in records]


def in_blocks(records: list[Sent], sizes: Sequence[int]) -> list[list[Sent]]:
    ends = [0]
    while ends[-1] < len(records):
        ends.append(ends[-1] + sizes[len(ends) % len(sizes)])
    return [records[begin:end] for begin, end in pairwise(ends)]


def take(order: RecordOrder, records: list[Sent]) -> list[int]:
    """Return the rdt_sequence of the records that are taken, each of which has to be still whole."""
    rows = [(rdt, ft, rdt ^ ft, (rdt % 1000,) * 6) for rdt, ft, _ in records]
    block = np.array(rows, RECORD)
    taken = order.take(block)
    assert np.array_equal(taken["status"], taken["rdt_sequence"] ^ taken["ft_sequence"])
    assert np.array_equal(taken["counts"][:, 5], taken["rdt_sequence"] % 1000)
    return list(map(int, taken["rdt_sequence"]))


def took(order: RecordOrder, records: list[Sent], *, block: int = 40) -> list[int]:
    return [number for part in in_blocks(records, [block]) for number in take(order, part)]


# A stream that is known


class Model:
    """The expected result of each arrival, once the stream is known."""

    def __init__(self, *, next_place: int) -> None:
        self.arrivals = Arrivals()
        self.next_place = next_place
        self.missed: set[int] = set()

    def take(self, records: list[Sent]) -> list[int]:
        new: list[int] = []
        for place in places(records):
            if not place:
                self.arrivals.rejected += 1
            elif place in self.missed:
                self.arrivals.late += 1
                self.missed.remove(place)
            elif place < self.next_place or place in new:
                self.arrivals.duplicates += 1
            else:
                self.arrivals.reordered += place < max(new, default=0)
                new.append(place)
        missing = set(range(self.next_place, max(new, default=0))) - set(new)
        self.arrivals.lost += len(missing)
        self.missed |= missing
        self.next_place = max([self.next_place, *(place + 1 for place in new)])
        return sorted(new)


def arrivals_of(plan: bytes, records: list[Sent], left_over: list[Sent], flips: list[tuple[int, int]]) -> list[Sent]:
    """Return arrivals by a plan of one byte per record: low bits select the record's fate, high bits a distance.

    At most two records with no intact one between them are garbled: three may look like another stream.
    """
    came: list[Sent] = []
    for i, (fate, record) in enumerate(zip(plan, records, strict=False)):
        off = fate >> 5
        if fate & 7 == 0:
            continue
        if fate & 7 == 1 and left_over:
            came.append(left_over[fate % len(left_over)]._replace(place=0))
        if fate & 7 == 2:
            came.append(records[max(0, i - off)])
        came.insert(max(0, len(came) - off) if fate & 7 == 3 else len(came), record)
    in_a_row, bits = 0, dict(flips)
    for i, record in enumerate(came):
        if record.place:
            in_a_row = in_a_row + 1 if i in bits and in_a_row < 2 else 0
            came[i] = garbled(record, bits[i]) if in_a_row else record
    return came


def check(order: RecordOrder, model: Model, came: list[Sent], sizes: list[int]) -> None:
    for part in in_blocks(came, sizes):
        assert take(order, part) == [place % WRAP for place in model.take(part)]
        assert order.arrivals == model.arrivals


plans = st.binary(max_size=40)
flips_of = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 63)), max_size=5)
block_sizes = st.lists(st.integers(1, 40), min_size=1, max_size=4)
steps = st.sampled_from(STEPS)
starts = st.integers(0, WRAP - 1) | st.integers(WRAP - 200, WRAP - 1)
requests = st.tuples(steps, starts, steps, st.integers(1, 5000))


@FEW
@given(plan=plans, flips=flips_of, sizes=block_sizes, request=requests)
def test_each_record_of_a_request_is_taken_once_in_order_or_counted(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], request: tuple[int, int, int, int]
) -> None:
    """Check a request that follows another one, whose records are left over wherever the plan has them."""
    step_before, start_before, step, pause = request
    before = stream(1, 60, start=start_before, step=step_before)
    now = stream(1, 43, start=before[-1].ft + pause, step=step)
    order, model = RecordOrder(), Model(next_place=4)
    took(order, before[:50])
    order.begin()
    assert order.step is None
    assert took(order, now[:3]) == [1, 2, 3]
    check(order, model, arrivals_of(plan, now[3:], before[40:], flips), sizes)
    assert order.step == step


@FEW
@given(plan=plans, flips=flips_of, sizes=block_sizes, start=starts, step=st.sampled_from((1, 2, 4, 7)))
def test_the_number_of_a_record_wraps_like_any_other(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], start: int, step: int
) -> None:
    order, end, stride = RecordOrder(), WRAP - 20, 2**30 // step
    came = [1, 2, 3, *range(stride, end, stride), end]
    for place in came:
        took(order, stream(place, place, start=start, step=step))
    model = Model(next_place=end + 1)
    model.arrivals.lost = end - len(came)
    check(order, model, arrivals_of(plan, stream(end + 1, end + 40, start=start, step=step), [], flips), sizes)


@pytest.mark.parametrize("step", [1, 2, 7, 7000])
@pytest.mark.parametrize("start", [0, WRAP - 100])
@pytest.mark.parametrize("place", [1, 2, 3, 20])
def test_any_flipped_bit_of_either_counter_costs_that_record_and_no_other(step: int, start: int, place: int) -> None:
    for bit in range(64):
        order, sent = RecordOrder(), stream(1, 40, start=start, step=step)
        sent[place - 1] = garbled(sent[place - 1], bit)
        taken = [number for part in in_blocks(sent, [7, 1, 2, 10]) for number in take(order, part)]
        assert taken == [number for number in range(1, 41) if number != place]
        assert order.arrivals == Arrivals(lost=1, rejected=1)
        assert order.step == step


# Where a stream begins

BEGINNINGS: dict[str, tuple[list[Sent], list[Sent], Arrivals]] = {  # the request before, what came, how it counts
    "whole": ([], stream(1, 200), Arrivals()),
    "lost before the first": ([], stream(81, 200), Arrivals(lost=80)),
    "no two in a row": ([], stream(1, 201)[::4], Arrivals(lost=150)),
    "two garbled that agree": (
        [],
        [*(garbled(record, 20) for record in stream(1, 2)), *stream(3, 60)],
        Arrivals(lost=2, rejected=2),
    ),
    "one garbled many times": (
        stream(1, 60),
        [Sent(1, 99999)] * 100 + stream(2, 60, start=5000),
        Arrivals(lost=1, rejected=100),
    ),
    "another rate": (stream(1, 60), stream(1, 60, start=5000, step=14), Arrivals()),
    "a restarted box": (stream(1, 60, start=4_000_000_000), stream(1, 60, start=12), Arrivals()),
    "left over": (
        stream(1, 60),
        [*(record._replace(place=0) for record in stream(61, 80)), *stream(1, 60, start=5000)],
        Arrivals(rejected=20),
    ),
    "a first one twice": ([], [*stream(1, 1), Sent(1, 1007), *stream(2, 60)], Arrivals(duplicates=1)),
    "a repeated request": ([], stream(1, 30) + stream(1, 60, start=5000), Arrivals()),
    "a stream since days": (
        [],
        [Sent(3 * 2**30 + i, 1000 + 7 * i) for i in range(60)] + stream(1, 60, start=90000),
        Arrivals(rejected=60),
    ),
    "a count that slips": ([], stream(1, 50) + stream(51, 120, start=1007), Arrivals()),
    "a count that jumps": ([], stream(1, 50) + stream(51, 120, start=1_001_000), Arrivals()),
    "a rate that changes": ([], stream(1, 50) + stream(51, 120, start=650, step=14), Arrivals()),
}


@pytest.mark.parametrize(("before", "came", "arrivals"), BEGINNINGS.values(), ids=BEGINNINGS.keys())
@pytest.mark.parametrize("block", [1, 7, 40])
def test_a_stream_is_found_wherever_it_begins(
    before: list[Sent], came: list[Sent], arrivals: Arrivals, block: int
) -> None:
    order = RecordOrder()
    took(order, before)
    order.begin()
    order.begin()  # the request was repeated before any answer
    assert took(order, came, block=block) == [place for place in places(came) if place]
    assert order.arrivals == arrivals
