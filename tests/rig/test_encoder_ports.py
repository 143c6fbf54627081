"""What is known of an encoder before it is recorded: the width of its word, from its counts per turn."""

import pytest

from cfid.rig.e201_port import word_bits
from cfid.wire.e201 import set_word_width


@pytest.mark.parametrize(
    ("counts", "bits"), [("rls-13bit-in-22", 22), (8192.0, 13), (2, 1), (2.0**32, 32), (4194047, None), (8192.5, None)]
)
def test_counts_that_are_a_power_of_two_ask_for_a_width(counts: float | str, bits: int | None) -> None:
    assert word_bits(counts) == bits


@pytest.mark.parametrize("counts", [1.0, 2.0**33, 2.0**80, 0.5])
def test_no_width_is_asked_for_that_no_word_has(counts: float) -> None:
    assert word_bits(counts) is None


@pytest.mark.parametrize("bits", [0, 33])
def test_no_such_width_can_be_set(bits: int) -> None:
    with pytest.raises(ValueError, match="1 to 32 bits"):
        set_word_width(bits)
