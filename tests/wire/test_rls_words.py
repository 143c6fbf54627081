"""The encoder's 22-bit words: their meaning, and exactly which wrong bits they reveal."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire.rls import (
    RLS_13BIT_IN_22,
    STEPS_PER_TURN,
    WORD_COUNTS_PER_TURN,
    decode_words,
    encode_positions,
    turns_of,
)

Words = npt.NDArray[np.int64]

POSITIONS = np.arange(STEPS_PER_TURN)
GAP_AND_COPY = range(9)  # bits 0 to 7 repeat bits 14 to 21, bit 8 is zero
UNPROTECTED = range(9, 14)
COPIED = range(14, 22)


def as_printed(position: int) -> int:
    """Return the word in the form of the thesis' largest reading: 13 bits, a zero, and the first eight bits again."""
    bits = f"{position:013b}"
    return int(bits + "0" + bits[:8], base=2)


@pytest.mark.parametrize(
    ("word", "position"),
    [(0, 0), (512, 1), (15872, 31), (16385, 32), (2097280, 4096), (4178175, 8160), (4194047, 8191)],
)
def test_a_word_read_off_by_hand_is_its_position(word: int, position: int) -> None:
    decoded = decode_words(np.array([word]))
    assert decoded.position.tolist() == [position]
    assert decoded.valid.tolist() == [True]
    assert encode_positions(np.array([position])).tolist() == [word]


def test_every_position_is_the_word_that_its_bits_spell() -> None:
    assert encode_positions(POSITIONS).tolist() == [as_printed(position) for position in range(8192)]


def test_of_all_22_bit_words_the_8192_that_were_sent_are_valid_and_no_other() -> None:
    decoded = decode_words(np.arange(WORD_COUNTS_PER_TURN))
    assert np.flatnonzero(decoded.valid).tolist() == encode_positions(POSITIONS).tolist()
    assert decoded.position[decoded.valid].tolist() == POSITIONS.tolist()


@pytest.mark.parametrize("bit", [*GAP_AND_COPY, *COPIED])
def test_a_flipped_bit_that_has_a_copy_or_is_one_is_caught_at_every_position(bit: int) -> None:
    assert not decode_words(encode_positions(POSITIONS) ^ (1 << bit)).valid.any()


@pytest.mark.parametrize("bit", UNPROTECTED)
def test_a_flipped_bit_of_the_low_five_passes_and_shifts_the_position_by_its_weight(bit: int) -> None:
    decoded = decode_words(encode_positions(POSITIONS) ^ (1 << bit))
    assert decoded.valid.all()
    assert (np.abs(decoded.position - POSITIONS) == 1 << (bit - 9)).all()


@given(position=st.integers(0, STEPS_PER_TURN - 1), flipped=st.integers(1, WORD_COUNTS_PER_TURN - 1))
def test_what_passes_with_any_bits_flipped_is_the_word_of_another_position(position: int, flipped: int) -> None:
    word = encode_positions(np.array([position])) ^ flipped
    decoded = decode_words(word)
    assert not decoded.valid[0] or as_printed(int(decoded.position[0])) == word[0]


@given(position=st.integers(-(2**40), 2**40))
def test_a_number_that_is_no_position_becomes_no_valid_word(position: int) -> None:
    assert decode_words(encode_positions(np.array([position]))).valid[0] == (0 <= position < STEPS_PER_TURN)


@given(word=st.integers(-(2**62), -1) | st.integers(WORD_COUNTS_PER_TURN, 2**62))
def test_a_number_outside_of_22_bits_is_no_valid_word(word: int) -> None:
    assert not decode_words(np.array([word])).valid[0]


def test_words_keep_their_shape() -> None:
    decoded = decode_words(np.full((2, 3), 4194047))
    assert decoded.position.shape == decoded.valid.shape == (2, 3)
    assert decode_words(np.empty(0, dtype=np.int64)).position.shape == (0,)


def test_counts_of_any_scale_become_turns() -> None:
    words = np.append(encode_positions(np.array([0, 2048, 6144])).astype(float), [1.0, np.nan])

    assert turns_of(np.array([0, 90, 540]), 360).turns.tolist() == [0.0, 0.25, 1.5]
    assert turns_of(np.array([1.0, np.nan]), 2.0).valid.tolist() == [True, False]
    assert turns_of(words, RLS_13BIT_IN_22).turns[:3].tolist() == [0.0, 0.25, 0.75]
    assert turns_of(words, RLS_13BIT_IN_22).valid.tolist() == [True, True, True, False, False]
