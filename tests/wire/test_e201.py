"""The E201's commands, and its replies in any slicing and with any damage: only whole replies are positions."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire import e201
from cfid.wire.e201 import EncoderReading, PositionReader
from cfid.wire.rls import STEPS_PER_TURN, decode_words, encode_positions
from tests.wire.pieces import FEW, flipped, sliced, slicings

WORDS: list[int] = encode_positions(np.arange(STEPS_PER_TURN)).tolist()
FORMS = {"stamped": b"%d:1000000\r", "stamped with a space": b"%d 1000000\r", "plain": b"%d\r"}

WHOLE = (b"4194047:123456789\r", b"0 0\r", b"\n512:4294967295\r", b"4194047\r", b"\n15872\r", b"0000000512\r")
DAMAGE = (b"Error\r", b"\r", b"\n", b"\r\n", b":", b" ", b"4", b"19", b"4194304:5\r", b"1:4294967296\r", b"9" * 70)

streams = st.lists(st.sampled_from(WHOLE + DAMAGE) | st.binary(max_size=3), max_size=12).map(b"".join)


# Commands, and replies about the device itself


def test_a_word_width_is_set_with_two_digits_and_an_end_and_only_to_what_a_word_has() -> None:
    assert [e201.set_word_width(bits) for bits in (1, 22, 32)] == [b"B01\r", b"B22\r", b"B32\r"]
    for bits in (0, 33):
        with pytest.raises(ValueError):
            e201.set_word_width(bits)


@pytest.mark.parametrize(
    ("reply", "bits"),
    [
        (b"22", 22),
        (b"B13", 13),
        (b"SSI bits: 9", 9),
        (b"0", 0),
        (b"", None),
        (b"Error", None),
        (b"222", None),
        (b"13 of 22", None),
        (b"4194047:1", None),
    ],
)
def test_a_word_width_is_read_from_a_reply_with_one_number(reply: bytes, bits: int | None) -> None:
    assert e201.word_width(reply) == bits


# Positions


@FEW
@given(stream=streams, sizes=slicings)
def test_a_damaged_stream_is_read_the_same_in_any_slicing_and_each_reply_counts(
    stream: bytes, sizes: list[int]
) -> None:
    *replies, rest = stream.split(b"\r")
    reader, in_parts = PositionReader(word_bits=22), PositionReader(word_bits=22)
    readings = reader.feed(stream)
    assert [reading for part in sliced(stream, sizes) for reading in in_parts.feed(part)] == readings
    assert reader.rejected == in_parts.rejected == len(replies) - len(readings)
    reader.forget()
    assert len(readings) + reader.rejected == len(replies) + (rest not in (b"", b"\n"))


@pytest.mark.parametrize(
    ("wire", "reading"),
    [
        (b"4194047\r", EncoderReading(4194047, None)),
        (b"4194047:1234567\r", EncoderReading(4194047, 1234567)),
        (b"4194047 1234567\r", EncoderReading(4194047, 1234567)),
        (b"\n513:2\r\n", EncoderReading(513, 2)),
        (b"0:4294967295\r", EncoderReading(0, 4294967295)),
    ],
)
def test_a_reply_is_a_position_and_a_stamp_behind_a_colon_or_a_space(wire: bytes, reading: EncoderReading) -> None:
    reader = PositionReader(word_bits=22)
    assert reader.feed(wire) == [reading]
    reader.forget()
    assert reader.rejected == 0


@pytest.mark.parametrize(
    "wire",
    [
        *(b"\r", b":\r", b"1:\r", b":1\r", b"1::2\r", b"1:2:3\r", b"-1:2\r", b"+1:2\r", b"1.0:2\r", b"1_0:2\r"),
        *(b"0x10:2\r", b" 1:2\r", b"1:2 \r", b"1\t2\r", b"1\n2\r", b"\n\n1:2\r", "١:2\r".encode()),
        *(b"4194304:2\r", b"1:4294967296\r", b"1:00000000002\r"),
    ],
)
def test_a_reply_that_is_no_position_is_rejected(wire: bytes) -> None:
    reader = PositionReader(word_bits=22)
    assert reader.feed(wire) == []
    assert (reader.rejected, reader.errors) == (1, 0)


@pytest.mark.parametrize("missed", range(1, len(b"4194047:123456")))
def test_a_first_reply_whose_beginning_was_missed_costs_none_of_those_after_it(missed: int) -> None:
    reader = PositionReader(word_bits=22)
    reader.feed(b"4194047:123456\r"[missed:])
    assert reader.feed(b"512:1\r513:2\r") == [(512, 1), (513, 2)]


def test_endless_input_without_an_end_is_one_rejected_reply_and_not_remembered() -> None:
    reader = PositionReader(word_bits=22)
    for _ in range(200):
        reader.feed(b"7" * 10_000)
        assert len(pickle.dumps(reader)) < 1000
    assert reader.feed(b"\r3:4\r") == [(3, 4)]
    assert reader.rejected == 1


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
@pytest.mark.parametrize("every", [97, pytest.param(1, marks=pytest.mark.slow)])
def test_no_flipped_bit_of_a_reply_is_taken_for_another_position_thanks_to_the_words_check(
    form: bytes, every: int
) -> None:
    for position in range(0, STEPS_PER_TURN, every):
        for damaged in flipped(form % WORDS[position]):
            reader = PositionReader(word_bits=22)
            assert len(reader.feed(form % 512 + form % 1024)) == 2
            decoded = decode_words(np.array([reading.position for reading in reader.feed(damaged)], np.int64))
            assert set(decoded.position[decoded.valid].tolist()) <= {position}
