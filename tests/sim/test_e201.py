"""The simulated encoder interface without a port: replies, widths and stamps."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.sim.e201 import E201Device, ssi_word
from cfid.wire.e201 import PositionReader, names_e201, set_word_width, word_width
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


@pytest.mark.parametrize(("bits", "word"), [(1, 1), (12, 4095), (14, 16382), (27, 0x7FFDFFF), (32, 0xFFFBFFEF)])
def test_any_width_shows_the_position_again_after_a_zero(bits: int, word: int) -> None:
    assert ssi_word(8191, bits=bits) == word


def test_a_device_says_who_it_is() -> None:
    assert names_e201(_reply(_device(), b"v"))
    assert not names_e201(_reply(_device(), b"s"))


def test_positions_come_in_decimal_and_in_hex() -> None:
    device = _device()
    word = int(encode_positions(np.array([5000]))[0])
    assert int(_reply(device, b"?")) == int(_reply(device, b">"), 16) == word
    assert [int(field, 16) for field in _reply(device, b"<", now_s=2.0).split(b":")] == [word, 2_000_000]


@pytest.mark.parametrize(("steps", "position"), [(-0.5, 8191), (0.0, 0), (8191.9, 8191), (8192.5, 0), (-8192.5, 8191)])
def test_a_turn_has_8192_steps(steps: float, position: int) -> None:
    device = _device(steps)
    device.word_bits = 13
    assert int(_reply(device, b"?")) == position


def test_a_width_is_set_by_two_digits_in_any_slicing() -> None:
    device = _device()
    command = set_word_width(13)
    assert all(not device.received(command[i : i + 1], 0.0) for i in range(3))
    assert word_width(_reply(device, command[3:])) == 13
    assert word_width(_reply(device, b"b")) == 13
    assert int(_reply(device, b"?")) == 5000


@pytest.mark.parametrize("command", [b"B99\r", b"B\r", b"Bxx\r", b"B00\r", b"X"])
def test_what_makes_no_sense_is_an_error_and_changes_nothing(command: bytes) -> None:
    device = _device()
    assert b"Error" in _reply(device, command)
    assert word_width(_reply(device, b"b")) == 22


def test_the_stamp_wraps_at_32_bits() -> None:
    device = _device(first_stamp_us=2**32 - 1_000_000)
    reader = PositionReader(word_bits=22)
    stamps = [reader.feed(_reply(device, b"!", now_s=now_s) + b"\r")[0].stamp_us for now_s in (0.5, 1.5)]
    assert stamps == [2**32 - 500_000, 500_000]


def test_an_encoder_without_supply_is_an_error_until_it_is_back() -> None:
    device = _device()
    assert b"OFF" in _reply(device, b"f")
    assert b"Error" in _reply(device, b"!")
    assert b"ON" in _reply(device, b"n")
    assert b"Error" not in _reply(device, b"!")


def test_continuous_output_comes_a_thousand_times_a_second_until_stopped() -> None:
    device = _device()
    assert device.received(b"1", 0.0) == []
    assert sum(len(device.due(i / 300)) for i in range(1, 301)) == pytest.approx(1000, abs=2)
    assert device.received(b"0", 1.0) == []
    assert device.due(2.0) == []
