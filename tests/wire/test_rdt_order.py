"""The order of RDT records compared with a simple model of sets: which records are taken, and how all others count."""

import pickle
import random
from collections.abc import Sequence
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfid.wire.rdt import RECORD, Records
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
    """The expected result of each arrival, once the stream is known."""

    def __init__(self, *, next_place: int) -> None:
        self.arrivals = Arrivals()
        self.next_place = next_place
        self.missed: set[int] = set()

    def take(self, batch: list[Came]) -> list[int]:
        places = [came.place for came in batch if came.kind is Kind.INTACT]
        self.arrivals.rejected += len(batch) - len(places)
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
    records = np.empty(len(came), RECORD)
    records["rdt_sequence"] = words >> np.uint64(32)
    records["ft_sequence"] = words & np.uint64(WRAP - 1)
    records["status"] = places % 997
    records["counts"] = places[:, np.newaxis] % 1000
    return records


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


def with_flips(came: list[Came], flips: list[tuple[int, int]]) -> list[Came]:
    """Garble some intact records, at most two with no intact one between them: three may look like another stream."""
    result, garbled = list(came), 0
    bits = dict(flips)
    for i, arrival in enumerate(came):
        if arrival.kind is Kind.INTACT:
            garbled = garbled + 1 if i in bits and garbled < 2 else 0
            if garbled:
                result[i] = Came(arrival.place, Kind.GARBLED, bits[i])
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
        assert found["rdt_sequence"].tolist() == [place % WRAP for place in expected]
        assert found["ft_sequence"].tolist() == [(now.start + now.step * place) % WRAP for place in expected]
        assert found["status"].tolist() == [place % 997 for place in expected]
        assert found["counts"][:, 5].tolist() == [place % 1000 for place in expected]
        assert order.arrivals == model.arrivals
        taken += expected
    assert taken == sorted(set(taken))
    assert order.step == now.step


plans = st.binary(max_size=40)
flips_of = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 63)), max_size=5)
batch_sizes = st.lists(st.integers(1, 40), min_size=1, max_size=4)
streams = st.builds(Stream, st.sampled_from(STEPS), st.integers(0, WRAP - 1) | st.integers(WRAP - 200, WRAP - 1))


def check_a_request(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], before: Stream, now: tuple[int, int]
) -> None:
    """Check a request that follows another one, whose records are left over wherever the plan has them."""
    step, pause = now
    stream = Stream(step, (before.start + 60 * before.step + pause) % WRAP)
    order, model = RecordOrder(), Model(next_place=4)
    order.take(records_of([Came(place) for place in range(1, 51)], before, before))
    order.begin()
    assert order.step is None
    order.take(records_of([Came(place) for place in (1, 2, 3)], stream, before))
    came = with_flips(arrivals_of(plan, 4, range(40, 60)), flips)
    check_against_the_model(order, model, batches_of(came, sizes), stream, before)
    taken = model.next_place - 4 - order.arrivals.lost
    assert len(came) == taken + order.arrivals.late + order.arrivals.duplicates + order.arrivals.rejected


requests = st.tuples(st.sampled_from(STEPS), st.integers(1, 5000))


@FEW
@given(plan=plans, flips=flips_of, sizes=batch_sizes, before=streams, now=requests)
def test_each_record_of_a_request_is_taken_once_in_order_or_counted(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], before: Stream, now: tuple[int, int]
) -> None:
    check_a_request(plan, flips, sizes, before, now)


@pytest.mark.slow
@MANY
@given(plan=plans, flips=flips_of, sizes=batch_sizes, before=streams, now=requests)
def test_each_record_of_very_many_requests_is_taken_once_in_order_or_counted(
    plan: bytes, flips: list[tuple[int, int]], sizes: list[int], before: Stream, now: tuple[int, int]
) -> None:
    check_a_request(plan, flips, sizes, before, now)


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
    came = with_flips(arrivals_of(plan, near_the_wrap + 1, range(0)), flips)
    check_against_the_model(order, model, batches_of(came, sizes), stream, stream)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("start", [0, WRAP - 100, 2**31 - 100])
def test_any_flipped_bit_of_either_number_costs_that_record_and_no_other(step: int, start: int) -> None:
    for flip in range(64):
        order, stream = RecordOrder(), Stream(step, start)
        came = [Came(place, Kind.GARBLED if place == 20 else Kind.INTACT, flip) for place in range(1, 41)]
        taken = [order.take(records_of(batch, stream, stream)) for batch in batches_of(came, [10, 7, 1, 2])]
        assert sum(len(part["rdt_sequence"]) for part in taken) == 39
        assert order.arrivals == Arrivals(lost=1, rejected=1)


def test_a_garbled_record_that_comes_right_after_all_is_late() -> None:
    order, stream = RecordOrder(), Stream(7, 1000)
    order.take(
        records_of([Came(place, Kind.GARBLED if place == 5 else Kind.INTACT) for place in range(1, 9)], stream, stream)
    )
    assert order.take(records_of([Came(5)], stream, stream))["rdt_sequence"].tolist() == []
    assert order.arrivals == Arrivals(lost=1, late=1, rejected=1)


def test_a_late_record_that_came_behind_a_newer_one_is_late_and_not_reordered() -> None:
    order, stream = RecordOrder(), Stream(7, 1000)
    order.take(records_of([Came(place) for place in (1, 2, 3, 5)], stream, stream))
    assert order.take(records_of([Came(7), Came(4), Came(6)], stream, stream))["rdt_sequence"].tolist() == [6, 7]
    assert order.arrivals == Arrivals(lost=1, late=1, reordered=1)


# Where a stream begins


Numbers = tuple[int, int]


def stream(first: int, last: int, *, start: int = 1000, step: int = 7) -> list[Numbers]:
    """Return both numbers of records `first` to `last` of a request that began at ft_sequence `start`."""
    return [(place, start + step * place) for place in range(first, last + 1)]


def took(order: RecordOrder, numbers: Sequence[Numbers], *, block: int = 40) -> list[int]:
    """Return the rdt_sequence of the records that an order takes when they come in blocks."""
    taken: list[int] = []
    for i in range(0, len(numbers), block):
        rdt, ft = np.array(numbers[i : i + block], np.int64).T.astype(np.uint32)
        records = np.empty(len(rdt), RECORD)
        records["rdt_sequence"], records["ft_sequence"] = rdt, ft
        taken += order.take(records)["rdt_sequence"].tolist()
    return taken


def places(first: int, last: int) -> list[int]:
    return list(range(first, last + 1))


@pytest.mark.parametrize("block", [1, 2, 7, 39, 40])
def test_blocks_of_any_size_are_taken_from_the_first_record_on(block: int) -> None:
    order = RecordOrder()
    assert took(order, stream(1, 200), block=block) == places(1, 200)
    assert order.arrivals == Arrivals()
    assert order.step == 7


@pytest.mark.parametrize("block", [1, 2, 40])
def test_records_lost_before_the_first_are_counted(block: int) -> None:
    order = RecordOrder()
    assert took(order, stream(81, 200), block=block) == places(81, 200)
    assert order.arrivals == Arrivals(lost=80)


def test_a_stream_of_which_no_two_records_in_a_row_arrive_is_taken() -> None:
    order = RecordOrder()
    assert took(order, stream(1, 201)[::4], block=1) == places(1, 201)[::4]
    assert order.arrivals == Arrivals(lost=150)


@pytest.mark.parametrize("block", [1, 2, 3, 40])
@pytest.mark.parametrize("step", [1, 2, 4, 7, 7000])
@pytest.mark.parametrize("place", [1, 2, 3])
@pytest.mark.parametrize("number", [0, 1])
def test_a_flipped_bit_in_one_of_the_first_records_costs_that_record_and_no_other(
    number: int, place: int, step: int, block: int
) -> None:
    for bit in range(32):
        sent = stream(1, 24, step=step)
        rdt, ft = sent[place - 1]
        sent[place - 1] = (rdt ^ 1 << bit, ft) if number == 0 else (rdt, ft ^ 1 << bit)
        order = RecordOrder()
        assert took(order, sent, block=block) == [p for p in places(1, 24) if p != place]
        assert order.arrivals == Arrivals(lost=1, rejected=1)
        assert order.step == step


@pytest.mark.parametrize("block", [1, 2, 40])
def test_two_garbled_records_that_agree_make_no_stream(block: int) -> None:
    order = RecordOrder()
    sent = [(place, ft ^ 1 << 20) for place, ft in stream(1, 2)] + stream(3, 60)
    assert took(order, sent, block=block) == places(3, 60)
    assert order.arrivals == Arrivals(lost=2, rejected=2)


@pytest.mark.parametrize("times", [2, 5, 100])
def test_a_garbled_record_that_comes_several_times_makes_no_stream(times: int) -> None:
    order = RecordOrder()
    assert took(order, stream(1, 60)) == places(1, 60)
    order.begin()
    assert took(order, [(1, 99999)] * times, block=1) == []
    assert took(order, stream(2, 60, start=5000), block=1) == places(2, 60)
    assert order.arrivals == Arrivals(lost=1, rejected=times)


def test_a_first_datagram_that_comes_twice_is_counted_as_duplicates() -> None:
    order = RecordOrder()
    assert took(order, stream(1, 1) * 2 + stream(2, 60), block=1) == places(1, 60)
    assert order.arrivals == Arrivals(duplicates=1)


def test_records_held_back_are_counted_until_they_are_taken() -> None:
    order = RecordOrder()
    assert took(order, stream(1, 2)) == []
    assert order.arrivals == Arrivals(rejected=2)
    assert took(order, stream(3, 3)) == [1, 2, 3]
    assert order.arrivals == Arrivals()


def test_records_held_back_when_a_new_request_begins_stay_counted() -> None:
    order = RecordOrder()
    took(order, stream(1, 2))
    order.begin()
    assert took(order, stream(1, 60, start=5000)) == places(1, 60)
    assert order.arrivals == Arrivals(rejected=2)


@pytest.mark.parametrize("block", [1, 7, 40])
def test_leftovers_are_known_though_the_request_was_repeated_before_any_answer(block: int) -> None:
    order = RecordOrder()
    took(order, stream(1, 60))
    order.begin()
    order.begin()
    assert took(order, stream(61, 80) + stream(1, 60, start=5000), block=block) == places(1, 60)
    assert order.arrivals == Arrivals(rejected=20)


@pytest.mark.parametrize("block", [1, 7, 40])
def test_the_answer_to_a_repeated_request_follows_that_to_the_first(block: int) -> None:
    order = RecordOrder()
    sent = stream(1, 30) + stream(1, 60, start=5000)
    assert took(order, sent, block=block) == places(1, 30) + places(1, 60)
    assert order.arrivals == Arrivals()


@pytest.mark.parametrize("block", [1, 7, 40])
def test_a_box_that_was_already_sending_does_not_hide_the_answer(block: int) -> None:
    order = RecordOrder()
    sent = stream(5001, 5030) + stream(1, 60, start=90000)
    assert took(order, sent, block=block)[-60:] == places(1, 60)
    assert order.arrivals.lost in (0, 5000)
    assert order.arrivals.late == order.arrivals.duplicates == 0


def test_a_box_that_was_sending_for_days_does_not_hide_the_answer() -> None:
    order = RecordOrder()
    days_ago = [(3 * 2**30 + place, 1000 + 7 * place) for place in range(60)]
    assert took(order, days_ago + stream(1, 60, start=90000), block=1) == places(1, 60)
    assert order.arrivals == Arrivals(rejected=60)


@pytest.mark.parametrize("block", [1, 7, 40])
@pytest.mark.parametrize("slip", [-1, 1, 7, 100])
def test_a_box_that_miscounts_its_own_samples_once_loses_no_record(slip: int, block: int) -> None:
    order = RecordOrder()
    assert took(order, stream(1, 50) + stream(51, 120, start=1000 + slip), block=block) == places(1, 120)
    assert order.arrivals == Arrivals()


@pytest.mark.parametrize("step", [1, 14])
def test_a_stream_whose_rate_changes_under_way_goes_on_without_a_loss(step: int) -> None:
    order = RecordOrder()
    assert took(order, stream(1, 50) + stream(51, 120, start=1000 + 50 * (7 - step), step=step)) == places(1, 120)
    assert order.arrivals == Arrivals()
    assert order.step == step


def test_garbage_without_end_is_counted_and_not_remembered() -> None:
    order, rng = RecordOrder(), random.Random(1)
    for _ in range(50):
        assert took(order, [(rng.getrandbits(32), rng.getrandbits(32)) for _ in range(200)]) == []
        assert len(pickle.dumps(order)) < 5000
    assert order.arrivals == Arrivals(rejected=10_000)
    assert took(order, stream(1, 60)) == places(1, 60)


def test_gaps_without_end_are_counted_and_not_all_remembered() -> None:
    order = RecordOrder()
    took(order, stream(1, 100_000)[::2])
    assert order.arrivals == Arrivals(lost=49_999)
    assert len(pickle.dumps(order)) < 200_000
    assert took(order, [stream(1, 100_000)[99_997]]) == []
    assert took(order, [stream(1, 100_000)[1]]) == []
    assert order.arrivals == Arrivals(lost=49_999, late=1, duplicates=1)
