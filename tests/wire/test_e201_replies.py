"""The E201's replies in any slicing and with any damage: only whole replies are read, and all others are counted."""

import pickle
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfid.wire.e201 import EncoderReading, PositionReader

FEW = settings(max_examples=200, deadline=None, derandomize=True)
MANY = settings(FEW, max_examples=100_000, suppress_health_check=list(HealthCheck))

WORD_LIMIT = 1 << 22
STAMPED = (b"4194047:123456789\r", b"0 0\r", b"\n512:4294967295\r", b"2097280 77\r")
PLAIN = (b"4194047\r", b"0\r", b"\n15872\r", b"0000000512\r")
DAMAGE = (b"Error\r", b"\r", b"\n", b"\r\n", b":", b" ", b"4", b"19", b"4194304:5\r", b"1:4294967296\r", b"9" * 70)

streams = st.lists(st.sampled_from(STAMPED + PLAIN + DAMAGE) | st.binary(max_size=3), max_size=12).map(b"".join)
lost_runs = st.lists(st.tuples(st.integers(0, 80), st.integers(1, 20)), max_size=2)
slicings = st.lists(st.integers(1, 25), min_size=1, max_size=4)


def without(stream: bytes, runs: list[tuple[int, int]]) -> bytes:
    for begin, length in runs:
        stream = stream[:begin] + stream[begin + length :]
    return stream


def sliced(stream: bytes, sizes: list[int]) -> list[bytes]:
    ends = [0]
    while ends[-1] < len(stream):
        ends.append(ends[-1] + sizes[len(ends) % len(sizes)])
    return [stream[begin:end] for begin, end in pairwise(ends)]


def number(text: bytes, limit: int) -> int | None:
    if not 1 <= len(text) <= 10 or set(text) - set(b"0123456789"):
        return None
    return int(text) if int(text) < limit else None


def what_it_says(reply: bytes) -> EncoderReading | None:
    """Return the reading of a whole reply, parsed without the pattern of the tested reader."""
    fields = reply.removeprefix(b"\n").replace(b":", b" ").split(b" ")
    numbers = [number(text, limit) for text, limit in zip(fields, (WORD_LIMIT, 1 << 32), strict=False)]
    if len(reply) > 64 or len(fields) > 2 or None in numbers or numbers[0] is None:
        return None
    return EncoderReading(numbers[0], numbers[1] if len(fields) == 2 else None)


def expected(replies: list[bytes]) -> list[EncoderReading]:
    """Return the readings of replies: of either form until two in a row have the same form, then only of that form."""
    readings: list[EncoderReading] = []
    form: bool | None = None
    for reading in filter(None, map(what_it_says, replies)):
        stamped = reading.stamp_us is not None
        if form is None or stamped == form:
            if readings and stamped == (readings[-1].stamp_us is not None):
                form = stamped
            readings.append(reading)
    return readings


def check_a_damaged_stream(stream: bytes, runs: list[tuple[int, int]], sizes: list[int]) -> None:
    damaged = without(stream, runs)
    *replies, rest = damaged.split(b"\r")
    reader = PositionReader(word_bits=22)
    readings = [reading for part in sliced(damaged, sizes) for reading in reader.feed(part)]
    assert readings == expected(replies)
    assert len(readings) + reader.rejected == len(replies)
    reader.forget()
    assert len(readings) + reader.rejected == len(replies) + (rest not in (b"", b"\n"))


@FEW
@given(stream=streams, runs=lost_runs, sizes=slicings)
def test_of_a_damaged_stream_whole_replies_are_read_and_all_others_counted(
    stream: bytes, runs: list[tuple[int, int]], sizes: list[int]
) -> None:
    check_a_damaged_stream(stream, runs, sizes)


@pytest.mark.slow
@MANY
@given(stream=streams, runs=lost_runs, sizes=slicings)
def test_of_very_many_damaged_streams_whole_replies_are_read_and_all_others_counted(
    stream: bytes, runs: list[tuple[int, int]], sizes: list[int]
) -> None:
    check_a_damaged_stream(stream, runs, sizes)


@FEW
@given(readings=st.lists(st.tuples(st.integers(0, WORD_LIMIT - 1), st.integers(0, 2**32 - 1))), sizes=slicings)
def test_an_undamaged_stream_is_read_whole_in_any_slicing(readings: list[tuple[int, int]], sizes: list[int]) -> None:
    reader = PositionReader(word_bits=22)
    stream = b"".join(b"%d:%d\r" % reading for reading in readings)
    assert [reading for part in sliced(stream, sizes) for reading in reader.feed(part)] == readings
    assert reader.rejected == reader.errors == 0


@pytest.mark.parametrize(
    ("wire", "readings"),
    [
        (b"4194047\r", [EncoderReading(4194047, None)]),
        (b"4194047:1234567\r", [EncoderReading(4194047, 1234567)]),
        (b"4194047 1234567\r", [EncoderReading(4194047, 1234567)]),
        (b"512:1\r\n513:2\r\n", [EncoderReading(512, 1), EncoderReading(513, 2)]),
        (b"0:4294967295\r", [EncoderReading(0, 4294967295)]),
    ],
)
def test_a_reply_is_a_position_and_a_stamp_behind_a_colon_or_a_space(
    wire: bytes, readings: list[EncoderReading]
) -> None:
    reader = PositionReader(word_bits=22)
    assert reader.feed(wire) == readings
    assert reader.rejected == 0


@pytest.mark.parametrize(
    "wire",
    [
        b"\r",
        b":\r",
        b"1:\r",
        b":1\r",
        b"1::2\r",
        b"1:2:3\r",
        b"-1:2\r",
        b"+1:2\r",
        b"1.0:2\r",
        b"1_0:2\r",
        b"0x10:2\r",
        b" 1:2\r",
        b"1:2 \r",
        b"1\t2\r",
        b"1\n2\r",
        b"\n\n1:2\r",
        "١:2\r".encode(),
        b"4194304:2\r",
        b"1:4294967296\r",
        b"1:00000000002\r",
    ],
)
def test_a_reply_that_is_no_position_is_rejected(wire: bytes) -> None:
    reader = PositionReader(word_bits=22)
    assert reader.feed(wire) == []
    assert (reader.rejected, reader.errors) == (1, 0)


def test_replies_that_say_error_are_counted_beside() -> None:
    reader = PositionReader(word_bits=22)
    assert reader.feed(b"Error\r5:1\rSSI ERROR: no power\r6:2\r") == [EncoderReading(5, 1), EncoderReading(6, 2)]
    assert (reader.rejected, reader.errors) == (2, 2)


@pytest.mark.parametrize("missed", range(1, len(b"4194047:123456")))
def test_a_first_reply_whose_beginning_was_missed_costs_none_of_those_after_it(missed: int) -> None:
    reader = PositionReader(word_bits=22)
    reader.feed(b"4194047:123456\r"[missed:])
    assert reader.feed(b"512:1\r513:2\r") == [EncoderReading(512, 1), EncoderReading(513, 2)]


@pytest.mark.parametrize(
    ("usual", "strange"), [(b"512:1\r513:2\r", b"514\r515\r516\r"), (b"512\r513\r", b"514:1\r515:2\r516:3\r")]
)
def test_once_two_replies_were_alike_those_of_the_other_form_are_rejected(usual: bytes, strange: bytes) -> None:
    reader = PositionReader(word_bits=22)
    assert len(reader.feed(usual)) == 2
    assert reader.feed(strange) == []
    assert reader.rejected == 3
    assert len(reader.feed(usual)) == 2


@pytest.mark.parametrize(("stamped", "strange"), [(True, b"514\r"), (False, b"514:1\r")])
def test_a_reader_that_is_told_the_form_takes_no_other_even_at_first(stamped: bool, strange: bytes) -> None:
    reader = PositionReader(word_bits=22, stamped=stamped)
    assert reader.feed(strange + b"1:2\r3\r" + strange) == [
        EncoderReading(1, 2) if stamped else EncoderReading(3, None)
    ]
    assert reader.rejected == 3


@pytest.mark.parametrize("feed", [lambda r: r.feed(b"\n"), lambda r: None, lambda r: r.feed(b"1:1\r\n")])
def test_nothing_is_counted_when_no_reply_had_begun(feed: Callable[[PositionReader], object]) -> None:
    reader = PositionReader(word_bits=22)
    feed(reader)
    reader.forget()
    assert reader.rejected == 0


def test_a_reply_without_an_end_is_counted_once_and_the_next_is_read() -> None:
    reader = PositionReader(word_bits=22)
    assert [reader.feed(b"1:2") for _ in range(100)] == [[]] * 100
    assert reader.feed(b"\r3:4\r") == [EncoderReading(3, 4)]
    assert reader.rejected == 1


def test_endless_input_without_an_end_is_not_remembered() -> None:
    reader = PositionReader(word_bits=22)
    for _ in range(200):
        reader.feed(b"7" * 10_000)
        assert len(pickle.dumps(reader)) < 1000
    assert reader.rejected == 0
    reader.forget()
    assert reader.rejected == 1
