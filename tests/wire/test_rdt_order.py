"""The order of RDT records compared with a simple model of sets: which records are taken, and how all others count."""

from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfid.wire.rdt import Records
from cfid.wire.rdt_order import Arrivals, RecordOrder

FEW = settings(max_examples=200, deadline=None, derandomize=True)
MANY = settings(FEW, max_examples=100_000, suppress_health_check=list(HealthCheck))

STEPS = (1, 2, 4, 7, 8, 70, 700, 7000)
WRAP = 1 << 32


class Kind(Enum):
    INTACT = "intact"
    GARBLED = "garbled"
    LEFT_OVER = "left over from the request before"


class Came(NamedTuple):
    """A record as it arrived: its place in its stream, what happened to it, and which of its 64 bits is flipped."""

    place: int
    kind: Kind = Kind.INTACT
    flip: int = 0


class Stream(NamedTuple):
    step: int
    start: int


class Model:
    """The expected result of each arrival; a stream is known after three intact records with different places."""

    def __init__(self, *, next_place: int = 1) -> None:
        self.arrivals = Arrivals()
        self.next_place = next_place
        self.known = next_place > 1
        self.waiting: list[Came] = []
        self.missed: set[int] = set()

    def take(self, batch: list[Came]) -> list[int]:
        self.arrivals.rejected += len(batch)
        self.waiting += batch
        self.known = self.known or len({came.place for came in self.waiting if came.kind is Kind.INTACT}) >= 3
        if not self.known:
            return []
        places = [came.place for came in self.waiting if came.kind is Kind.INTACT]
        self.waiting = []
        self.arrivals.rejected -= len(places)
        return self.in_order(places)

    def in_order(self, places: list[int]) -> list[int]:
        fresh: list[int] = []
        for place in places:
            if place in self.missed:
                self.arrivals.late += 1
                self.missed.remove(place)
            elif place < self.next_place or place in fresh:
                self.arrivals.duplicates += 1
            else:
                self.arrivals.reordered += place < max(fresh, default=0)
                fresh.append(place)
        missing = set(range(self.next_place, max(fresh, default=0))) - set(fresh)
        self.arrivals.lost += len(missing)
        self.missed |= missing
        self.next_place = max([self.next_place, *(place + 1 for place in fresh)])
        return sorted(fresh)


def records_of(came: list[Came], now: Stream, before: Stream) -> Records:
    """Return arrivals as records; the counts encode the place, so that rows can be distinguished."""
    places = np.array([one.place for one in came], np.int64)
    streams = [before if one.kind is Kind.LEFT_OVER else now for one in came]
    numbers = places % WRAP << 32 | np.array(
        [(s.start + s.step * p) % WRAP for s, p in zip(streams, places.tolist(), strict=True)], np.int64
    )
    flips = np.array([1 << one.flip if one.kind is Kind.GARBLED else 0 for one in came], np.uint64)
    words = numbers.astype(np.uint64) ^ flips
    counts = np.repeat(places[:, np.newaxis] % 1000, 6, axis=1)
    return Records(
        (words >> np.uint64(32)).astype(np.uint32),
        (words & np.uint64(WRAP - 1)).astype(np.uint32),
        (places % 997).astype(np.uint32),
        counts.astype(np.int32),
    )


def arrivals_of(plan: bytes, first: int, left_over: range) -> list[Came]:
    """Return arrivals by a plan of one byte per record: low bits select the record's fate, high bits a distance."""
    came: list[Came] = []
    for place, fate in enumerate(plan, first):
        off = fate >> 5
        if fate & 7 == 0:
            continue
        if fate & 7 == 1 and left_over:
            came.append(Came(left_over[fate % len(left_over)], Kind.LEFT_OVER))
        if fate & 7 == 2:
            came.append(Came(max(first, place - off)))
        came.insert(max(0, len(came) - off) if fate & 7 == 3 else len(came), Came(place))
    return came


def with_flips(came: list[Came], flips: list[tuple[int, int]], *, known: bool) -> list[Came]:
    """Garble some records: at most two with no intact one between them, and at most one until the stream is known."""
    wanted = dict(flips)
    seen: set[int] = set()
    since = 0 if known else 1
    result = []
    for i, one in enumerate(came):
        if i in wanted and one.kind is Kind.INTACT and since < 2:
            since += 1
            result.append(Came(one.place, Kind.GARBLED, wanted[i]))
            continue
        if one.kind is Kind.INTACT:
            seen.add(one.place)
            since = 0 if known or len(seen) >= 3 else since
        result.append(one)
    return result


def batches_of(came: list[Came], sizes: list[int]) -> list[list[Came]]:
    ends = [0]
    while ends[-1] < len(came):
        ends.append(ends[-1] + sizes[len(ends) % len(sizes)])
    return [came[begin:end] for begin, end in pairwise(ends)]


def check_against_the_model(
    order: RecordOrder, model: Model, batches: list[list[Came]], now: Stream, before: Stream
) -> None:
    taken: list[int] = []
    for batch in batches:
        expected = model.take(batch)
        found = order.take(records_of(batch, now, before))
        assert found.rdt_sequence.tolist() == [place % WRAP for place in expected]
        assert found.ft_sequence.tolist() == [(now.start + now.step * place) % WRAP for place in expected]
        assert found.status.tolist() == [place % 997 for place in expected]
        assert found.counts[:, 5].tolist() == [place % 1000 for place in expected]
        assert order.arrivals == model.arrivals
        taken += expected
    assert taken == sorted(set(taken))
    assert order.step == (now.step if model.known else None)


def total(arrivals: Arrivals) -> int:
    return arrivals.late + arrivals.duplicates + arrivals.rejected


plans = st.binary(max_size=40)
flips_of = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 63)), max_size=5)
batch_sizes = st.lists(st.integers(1, 40), min_size=1, max_size=4)
streams = st.builds(Stream, st.sampled_from(STEPS), st.integers(0, WRAP - 1) | st.integers(WRAP - 200, WRAP - 1))


def check_a_request(plan: bytes, flips: list[tuple[int, int]], sizes: list[int], stream: Stream) -> None:
    order, model = RecordOrder(), Model()
    came = with_flips(arrivals_of(plan, 1, range(0)), flips, known=False)
    check_against_the_model(order, model, batches_of(came, sizes), stream, stream)
    taken = model.next_place - 1 - order.arrivals.lost
    assert len(came) == taken + total(order.arrivals)


@FEW
@given(plan=plans, flips=flips_of, sizes=batch_sizes, stream=streams)
def test_each_record_of_a_request_is_taken_once_in_order_or_counted(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], stream: Stream
) -> None:
    check_a_request(plan, flips, sizes, stream)


@pytest.mark.slow
@MANY
@given(plan=plans, flips=flips_of, sizes=batch_sizes, stream=streams)
def test_each_record_of_very_many_requests_is_taken_once_in_order_or_counted(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], stream: Stream
) -> None:
    check_a_request(plan, flips, sizes, stream)


@FEW
@given(
    plan=plans,
    flips=flips_of,
    sizes=batch_sizes,
    before=streams,
    step=st.sampled_from(STEPS),
    pause=st.integers(1, 5000),
)
def test_leftovers_of_the_request_before_are_rejected_wherever_they_come(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], before: Stream, step: int, pause: int
) -> None:
    order, model = RecordOrder(), Model()
    check_against_the_model(order, model, [[Came(place) for place in range(1, 51)]], before, before)
    now = Stream(step, (before.start + 60 * before.step + pause) % WRAP)
    order.begin()
    model.next_place, model.known, model.waiting, model.missed = 1, False, [], set()
    came = with_flips(arrivals_of(plan, 1, range(40, 60)), flips, known=False)
    check_against_the_model(order, model, batches_of(came, sizes), now, before)


@FEW
@given(
    plan=plans, flips=flips_of, sizes=batch_sizes, start=st.integers(0, WRAP - 1), step=st.sampled_from((1, 2, 4, 7))
)
def test_the_number_of_a_record_wraps_like_any_other(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], start: int, step: int
) -> None:
    order, stream = RecordOrder(), Stream(step, start)
    near_the_wrap = WRAP - 20
    stride = 2**30 // step
    places = [1, 2, 3, *range(stride, near_the_wrap, stride), near_the_wrap]
    for place in places:
        order.take(records_of([Came(place)], stream, stream))
    assert order.arrivals == Arrivals(lost=near_the_wrap - len(places))
    model = Model(next_place=near_the_wrap + 1)
    model.arrivals.lost = order.arrivals.lost
    came = with_flips(arrivals_of(plan, near_the_wrap + 1, range(0)), flips, known=True)
    check_against_the_model(order, model, batches_of(came, sizes), stream, stream)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("start", [0, WRAP - 100, 2**31 - 100])
def test_any_flipped_bit_of_either_number_costs_that_record_and_no_other(step: int, start: int) -> None:
    for flip in range(64):
        order, stream = RecordOrder(), Stream(step, start)
        came = [Came(place, Kind.GARBLED if place == 20 else Kind.INTACT, flip) for place in range(1, 41)]
        taken = [order.take(records_of(batch, stream, stream)) for batch in batches_of(came, [10, 7, 1, 2])]
        assert sum(len(part.rdt_sequence) for part in taken) == 39
        assert order.arrivals == Arrivals(lost=1, rejected=1)


def test_a_garbled_record_that_comes_right_after_all_is_late() -> None:
    order, stream = RecordOrder(), Stream(7, 1000)
    order.take(
        records_of([Came(place, Kind.GARBLED if place == 5 else Kind.INTACT) for place in range(1, 9)], stream, stream)
    )
    assert order.take(records_of([Came(5)], stream, stream)).rdt_sequence.tolist() == []
    assert order.arrivals == Arrivals(lost=1, late=1, rejected=1)


def test_a_late_record_that_came_behind_a_newer_one_is_late_and_not_reordered() -> None:
    order, stream = RecordOrder(), Stream(7, 1000)
    order.take(records_of([Came(place) for place in (1, 2, 3, 5)], stream, stream))
    assert order.take(records_of([Came(7), Came(4), Came(6)], stream, stream)).rdt_sequence.tolist() == [6, 7]
    assert order.arrivals == Arrivals(lost=1, late=1, reordered=1)


def test_nothing_taken_is_nothing_counted() -> None:
    order, stream = RecordOrder(), Stream(7, 1000)
    for came in ([], [Came(1), Came(2), Came(3)], []):
        assert len(order.take(records_of(came, stream, stream)).rdt_sequence) == len(came)
    assert order.arrivals == Arrivals()
