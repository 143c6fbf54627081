"""A flipped bit in a reply never yields another position, thanks to the check of the word itself."""

from collections.abc import Iterator

import numpy as np
import pytest

from cfid.wire.e201 import PositionReader
from cfid.wire.rls import STEPS_PER_TURN, decode_words, encode_positions

PARTS = 9  # of all positions; each part takes every ninth, and so has every pattern of the lowest bits
WORDS: list[int] = encode_positions(np.arange(STEPS_PER_TURN)).tolist()
FORMS = {"stamped": b"%d:1000000\r", "stamped with a space": b"%d 1000000\r", "plain": b"%d\r"}


def with_one_flipped_bit(text: bytes) -> Iterator[bytes]:
    for place in range(len(text)):
        for bit in range(8):
            yield text[:place] + bytes([text[place] ^ 1 << bit]) + text[place + 1 :]


def reader_that_knows(form: bytes) -> PositionReader:
    reader = PositionReader(word_bits=22)
    assert len(reader.feed(form % 512 + form % 1024)) == 2
    return reader


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.slow) for part in range(1, PARTS))])
def test_no_flipped_bit_of_a_position_is_taken_for_another_position(form: bytes, part: int) -> None:
    reader = reader_that_knows(form)
    flips = 0
    sent, read = [], []
    for position in range(part, STEPS_PER_TURN, PARTS):
        digits = b"%d" % WORDS[position]
        rest = (form % WORDS[position])[len(digits) :]
        for damaged in with_one_flipped_bit(digits):
            flips += 1
            found = reader.feed(damaged + rest)
            sent += [position] * len(found)
            read += [reading.position for reading in found]
    assert 0 < len(read) < flips == len(read) + reader.rejected
    decoded = decode_words(np.array(read))
    assert not (decoded.valid & (decoded.position != np.array(sent))).any()


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
def test_no_flipped_bit_anywhere_in_a_reply_is_taken_for_another_position(form: bytes) -> None:
    for position in range(0, STEPS_PER_TURN, 97):
        for damaged in with_one_flipped_bit(form % WORDS[position]):
            found = reader_that_knows(form).feed(damaged)
            decoded = decode_words(np.array([reading.position for reading in found], np.int64))
            assert set(decoded.position[decoded.valid].tolist()) <= {position}
