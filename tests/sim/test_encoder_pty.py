"""The simulated encoder on a pseudo terminal, read with pyserial as a real one is."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from twisted.internet.posixbase import PosixReactorBase

from cfid.sim.e201 import E201Device
from cfid.sim.faults import SOUND_ENCODER, EncoderFaults, FaultySerial
from cfid.sim.pty import PtyPort
from cfid.sim.virtual import VirtualClock, _VirtualPort
from cfid.wire.e201 import names_e201, set_word_width

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
