"""How the order of RDT records is found at the start of a stream, and found again: nothing blocks it for good."""

import pickle
import random
from collections.abc import Sequence

import numpy as np
import pytest

from cfid.wire.rdt import Records
from cfid.wire.rdt_order import Arrivals, RecordOrder

Numbers = tuple[int, int]


def stream(first: int, last: int, *, start: int = 1000, step: int = 7) -> list[Numbers]:
    """Return both numbers of records `first` to `last` of a request that began at ft_sequence `start`."""
    return [(place, start + step * place) for place in range(first, last + 1)]


def took(order: RecordOrder, numbers: Sequence[Numbers], *, block: int = 40) -> list[int]:
    """Return the rdt_sequence of the records that an order takes when they come in blocks."""
    taken: list[int] = []
    for i in range(0, len(numbers), block):
        rdt, ft = np.array(numbers[i : i + block], np.int64).T.astype(np.uint32)
        records = Records(rdt, ft, np.zeros(len(rdt), np.uint32), np.zeros((len(rdt), 6), np.int32))
        taken += order.take(records).rdt_sequence.tolist()
    return taken


def places(first: int, last: int) -> list[int]:
    return list(range(first, last + 1))


@pytest.mark.parametrize("block", range(1, 41))
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


@pytest.mark.parametrize("step", [1, 2, 14, 7000])
def test_a_request_at_another_rate_is_taken(step: int) -> None:
    order = RecordOrder()
    took(order, stream(1, 60))
    order.begin()
    assert order.step is None
    assert took(order, stream(1, 60, start=5000, step=step)) == places(1, 60)
    assert order.arrivals == Arrivals()
    assert order.step == step


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
def test_a_box_that_was_restarted_is_taken_after_a_new_request(block: int) -> None:
    order = RecordOrder()
    took(order, stream(1, 60, start=4_000_000_000))
    order.begin()
    assert took(order, stream(1, 60, start=12), block=block) == places(1, 60)
    assert order.arrivals == Arrivals()


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
    assert len(pickle.dumps(order)) < 100_000
    assert took(order, [stream(1, 100_000)[99_997]]) == []
    assert took(order, [stream(1, 100_000)[1]]) == []
    assert order.arrivals == Arrivals(lost=49_999, late=1, duplicates=1)
