"""The simulated encoder interface without a port: replies, widths and stamps."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cfid.sim.e201 import E201Device, ssi_word
from cfid.wire.e201 import set_word_width, word_width
from cfid.wire.rls import encode_positions

STEP_RAD = math.tau / 8192


def _device(steps: float = 5000.5, *, first_stamp_us: int = 0) -> E201Device:
    return E201Device(lambda _: steps * STEP_RAD, first_stamp_us=first_stamp_us)


def _reply(device: E201Device, command: bytes, *, now_s: float = 0.0) -> bytes:
    (_, reply) = device.received(command, now_s)[0]
    assert reply.endswith(b"\r")
    return reply[:-1]


@given(position=st.integers(0, 8191))
def test_22_bits_are_the_word_that_the_thesis_read_and_13_the_plain_position(position: int) -> None:
    assert ssi_word(position, bits=22) == encode_positions(np.array([position]))[0]
    assert ssi_word(position, bits=13) == position


def test_a_width_is_set_by_two_digits_in_any_slicing() -> None:
    device = _device()
    command = set_word_width(13)
    assert all(not device.received(command[i : i + 1], 0.0) for i in range(3))
    assert word_width(_reply(device, command[3:])) == 13
    assert word_width(_reply(device, b"b")) == 13
    assert int(_reply(device, b"?")) == 5000
