"""What is known about an encoder before a recording: its port, and the width of its word."""

import os
import pty

import pytest

from cfid.errors import DeviceError
from cfid.rig.e201_port import encoder_among, word_bits
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


def test_many_ports_that_say_nothing_are_not_all_waited_for() -> None:
    ends = [pty.openpty() for _ in range(12)]

    with pytest.raises(DeviceError) as caught:
        encoder_among([os.ttyname(end) for _, end in ends], counts_per_turn=8192.0)
    for end in ends:
        os.close(end[0])
        os.close(end[1])

    silent, left = (str(caught.value).count(words) for words in ("gives no answer", "not checked, the other ports"))
    assert silent > 5
    assert left > 1
    assert silent + left == 12
