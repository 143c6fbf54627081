"""Simulated devices at a serial port: their replies and lines, in virtual time and on a pseudo terminal."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st
from twisted.internet.posixbase import PosixReactorBase

from cfid.records.rig_file import LineDevice, LineValue, LoadCellLines
from cfid.sim.e201 import E201Device, ssi_word
from cfid.sim.faults import SOUND_ENCODER, EncoderFaults, FaultySerial
from cfid.sim.lines import LineSender
from cfid.sim.pty import PtyPort
from cfid.sim.virtual import VirtualClock, _VirtualPort
from cfid.wire.e201 import names_e201, set_word_width, word_width
from cfid.wire.rls import encode_positions

STEP_RAD = math.tau / 8192


def _reply(device: E201Device, command: bytes) -> bytes:
    (_, reply) = device.received(command, 0.0)[0]
    assert reply.endswith(b"\r")
    return reply[:-1]


@given(position=st.integers(0, 8191))
def test_22_bits_are_the_word_that_the_thesis_read_and_13_the_plain_position(position: int) -> None:
    assert ssi_word(position, bits=22) == encode_positions(np.array([position]))[0]
    assert ssi_word(position, bits=13) == position


def test_a_width_is_set_by_two_digits_in_any_slicing() -> None:
    device = E201Device(lambda _: 5000.5 * STEP_RAD)
    command = set_word_width(13)
    assert all(not device.received(command[i : i + 1], 0.0) for i in range(3))
    assert word_width(_reply(device, command[3:])) == 13
    assert word_width(_reply(device, b"b")) == 13
    assert int(_reply(device, b"?")) == 5000


CELL = LoadCellLines(
    kind="lines",
    port="port",
    rate_hz=80,
    pattern=r"weight (\d+) (-?\d+) (\w+)",
    values=(
        LineValue(name="device_ms"),
        LineValue(name="Tz", unit="g", scale=0.001, arm_mm=50),
        LineValue(name="unused"),
    ),
)


def read(device: LineDevice, lines: bytes) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the values that a reader of the sender's own format finds in lines, in the columns' units."""
    numbers = device.model_copy(update={"pattern": ""}).reader().feed(b"\n" + lines)
    return np.array(numbers) * [device.factor(value) for value in device.in_order()]


def sent(device: LineDevice, name: str, *, until_s: float, faults: EncoderFaults | None = None) -> bytes:
    sender = LineSender(device, lambda time_s: {name: 0.001 * math.sin(time_s)}, powered_s=10.0)
    port = FaultySerial(sender, faults or EncoderFaults(), opened_s=10.0)
    times = np.arange(10.0, 10.0 + until_s, 0.1)
    return b"".join(line for time_s in times for _, line in port.due(float(time_s)))


def test_a_torque_by_an_arm_comes_back_with_the_devices_clock() -> None:
    stamp_us, torque_nm = read(CELL, sent(CELL, "Tz", until_s=5)).T

    assert len(torque_nm) == pytest.approx(400, abs=10)
    assert np.diff(stamp_us) == pytest.approx(12500, abs=1000)
    expected = 0.001 * np.sin(10 + 1e-6 * stamp_us)
    assert torque_nm == pytest.approx(expected, abs=2e-6)  # for whole milligrams at 50 mm, and whole milliseconds


InReactor = Callable[[Callable[[], Any]], Any]


class _Plugged:
    """An encoder at rest on the port of one test."""

    def __init__(self, reactor: PosixReactorBase, in_reactor: InReactor, folder: Path) -> None:
        self._reactor = reactor
        self._in_reactor = in_reactor
        self._folder = folder
        self._port: PtyPort | None = None

    def open(self, faults: EncoderFaults = SOUND_ENCODER) -> str:
        device = FaultySerial(E201Device(lambda _: 1.0), faults, opened_s=self._reactor.seconds())
        self._port = PtyPort(device, reactor=self._reactor, folder=self._folder)
        return str(self._in_reactor(self._port.open))

    def close(self) -> None:
        if self._port is not None:
            self._in_reactor(self._port.close)


@pytest.fixture
def plugged(reactor: PosixReactorBase, in_reactor: InReactor, tmp_path: Path) -> Iterator[_Plugged]:
    plugged = _Plugged(reactor, in_reactor, tmp_path)
    yield plugged
    plugged.close()


def _ask(port: serial.Serial, command: bytes) -> bytes:
    port.write(command)
    return bytes(port.read_until(b"\r"))


def test_a_host_asks_and_is_answered(plugged: _Plugged) -> None:
    with serial.Serial(plugged.open(), timeout=2) as port:
        assert names_e201(_ask(port, b"v"))
        assert _ask(port, set_word_width(13)) == b"13\r"
        assert _ask(port, b"?") == b"1303\r"


def test_an_unplugged_encoder_is_gone_and_comes_back_under_its_name(plugged: _Plugged) -> None:
    path = plugged.open(EncoderFaults(unplug_after_s=0.2, unplug_for_s=0.3))
    with serial.Serial(path, timeout=2) as port:
        assert names_e201(_ask(port, b"v"))
        time.sleep(0.3)
        assert not Path(path).exists()
        with pytest.raises(serial.SerialException):
            _ask(port, b"v")
    time.sleep(0.4)
    with serial.Serial(path, timeout=2) as port:
        assert names_e201(_ask(port, b"v"))


class Heard(list[bytes]):
    """A receiver of what a port sends."""

    def received(self, data: bytes) -> None:
        self.append(data)

    def disconnected(self) -> None:
        raise AssertionError("it was unplugged")


def test_a_reply_does_not_overtake_the_one_before_it() -> None:
    clock, heard = VirtualClock(), Heard()
    device = FaultySerial(E201Device(lambda _: 1.0), EncoderFaults(slow_s=0.2), opened_s=0.0)
    port = _VirtualPort(device, clock)
    port.receiver = heard

    port.received(b"b")
    clock.advance(0.05)
    device.faults = SOUND_ENCODER
    port.received(b"s")
    early = list(heard)
    clock.advance(0.16)

    assert early == []
    assert heard == [b"22\r", b"S00042\r"]
