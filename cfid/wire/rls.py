"""Encodes and decodes the encoder's 22-bit words, each of which holds a 13-bit position, and converts counts to turns.

The thesis scaled by its largest reading, 4194047 = 0x3FFEFF (section 2.4.4). That number is not a resolution but a
pattern: a position p of 13 bits, read as a 22-bit word that repeats itself after a zero bit,
raw = (p << 9) | (p >> 5). So 8192 steps make a turn and every sample carries its own check.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

RLS_13BIT_IN_22 = "rls-13bit-in-22"
POSITION_BITS = 13
WORD_BITS = 22
REPEATED_BITS = 8
STEPS_PER_TURN = 1 << POSITION_BITS
WORD_COUNTS_PER_TURN = 1 << WORD_BITS

_SHIFT = WORD_BITS - POSITION_BITS


class Positions(NamedTuple):
    """Decoded words: positions 0..8191, and which samples passed their own check."""

    position: npt.NDArray[np.int64]
    valid: npt.NDArray[np.bool_]


def encode_positions(position: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return the 22-bit words of positions 0..8191, any shape; any other number yields an invalid word."""
    return (position << _SHIFT) | (position >> (POSITION_BITS - REPEATED_BITS))


def decode_words(word: npt.NDArray[np.int64]) -> Positions:
    """Decode 22-bit words of any shape.

    A word is valid when it fits 22 bits, its gap bit is zero and its low byte repeats the top of the
    position: nine redundant bits, so that a random word passes once in 512. Any single flipped bit among bits
    0 to 8 and 14 to 21 is caught. Bits 9 to 13, the low five of the position, have no copy: flips there pass as
    a position that is up to 31 steps (1.4 degrees) off.
    """
    gap_is_zero = word >> REPEATED_BITS & 1 == 0
    # A negative number, or one beyond 22 bits, has a top that no low byte repeats.
    repeats = word % (1 << REPEATED_BITS) == (word >> (WORD_BITS - REPEATED_BITS))
    return Positions(position=word >> _SHIFT, valid=gap_is_zero & repeats)


class Turns(NamedTuple):
    """Angles in turns, and which samples are valid: all where they are no words with a check of their own."""

    turns: npt.NDArray[np.float64]
    valid: npt.NDArray[np.bool_]


def turns_of(counts: npt.NDArray[Any], counts_per_turn: float | str) -> Turns:
    """Return recorded counts of any shape in turns; `counts_per_turn` is a number, or the name of the words."""
    if counts_per_turn != RLS_13BIT_IN_22:
        return Turns(counts / float(counts_per_turn), np.isfinite(counts))
    words = decode_words(np.nan_to_num(counts, nan=-1.0).astype(np.int64))
    return Turns(words.position / STEPS_PER_TURN, words.valid)
