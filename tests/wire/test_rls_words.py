"""The encoder's 22-bit words: their meaning, and exactly which wrong bits they reveal."""

import numpy as np
import pytest

from cfid.wire.rls import (
    RLS_13BIT_IN_22,
    STEPS_PER_TURN,
    WORD_COUNTS_PER_TURN,
    decode_words,
    encode_positions,
    turns_of,
)

POSITIONS = np.arange(STEPS_PER_TURN)
UNPROTECTED = range(9, 14)  # bits 0 to 7 repeat bits 14 to 21, bit 8 is zero


@pytest.mark.parametrize(
    ("word", "position"),
    [(0, 0), (512, 1), (15872, 31), (16385, 32), (2097280, 4096), (4178175, 8160), (4194047, 8191)],
)
def test_a_word_read_off_by_hand_is_its_position(word: int, position: int) -> None:
    decoded = decode_words(np.array([word]))
    assert (decoded.position.tolist(), decoded.valid.tolist()) == ([position], [True])
    assert encode_positions(np.array([position])).tolist() == [word]


def test_every_position_is_its_13_bits_a_zero_and_the_first_eight_again() -> None:
    """Compare with the form of the thesis' largest reading."""
    bits = [f"{position:013b}" for position in range(8192)]
    assert encode_positions(POSITIONS).tolist() == [int(text + "0" + text[:8], base=2) for text in bits]


def test_of_all_22_bit_words_the_8192_that_were_sent_are_valid_and_no_other() -> None:
    decoded = decode_words(np.arange(WORD_COUNTS_PER_TURN))
    assert np.flatnonzero(decoded.valid).tolist() == encode_positions(POSITIONS).tolist()
    assert decoded.position[decoded.valid].tolist() == POSITIONS.tolist()


@pytest.mark.parametrize("bit", range(22))
def test_a_flipped_bit_is_caught_at_every_position_unless_it_is_one_of_the_low_five(bit: int) -> None:
    decoded = decode_words(encode_positions(POSITIONS) ^ (1 << bit))
    assert set(decoded.valid.tolist()) == {bit in UNPROTECTED}
    if bit in UNPROTECTED:
        assert (np.abs(decoded.position - POSITIONS) == 1 << (bit - 9)).all()


def test_counts_of_any_scale_become_turns() -> None:
    words = np.append(encode_positions(np.array([0, 2048, 6144])).astype(float), [1.0, np.nan])

    assert turns_of(np.array([0, 90, 540]), 360).turns.tolist() == [0.0, 0.25, 1.5]
    assert turns_of(np.array([1.0, np.nan]), 2.0).valid.tolist() == [True, False]
    assert turns_of(words, RLS_13BIT_IN_22).turns[:3].tolist() == [0.0, 0.25, 0.75]
    assert turns_of(words, RLS_13BIT_IN_22).valid.tolist() == [True, True, True, False, False]
