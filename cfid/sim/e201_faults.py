"""Adds faults to a simulated E201, between the device's core and its port; no port and no clock."""

from dataclasses import dataclass
from typing import Protocol

from cfid.sim.e201 import E201Device, Reply
from cfid.sim.faults import EncoderFaults, within
from cfid.wire import e201

_PIECES_APART_S = 3e-3
_JUNK = b"\x00\xfe#"
_STRANGER = b"Virtual ComPort V2.0\r"


@dataclass
class ReplyMishaps:
    """Counts of replies by fault."""

    dropped: int = 0
    silenced: int = 0
    garbled: int = 0
    split: int = 0


class SerialDevice(Protocol):
    """A device at a serial port."""

    @property
    def continuous(self) -> bool:
        """Whether `due` returns replies, now or later."""

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to bytes."""

    def due(self, now_s: float) -> list[Reply]:
        """Return what the device sends unprompted up to now."""


class FaultyE201:
    """The interface, or another device at a serial port, with its faults."""

    def __init__(self, device: SerialDevice, faults: EncoderFaults, *, opened_s: float) -> None:
        """Count the faults' times from `opened_s`."""
        self.faults = faults
        self.mishaps = ReplyMishaps()
        self._device = device
        if isinstance(device, E201Device):
            device.stuck_at_bits = faults.wrong_width
        self._opened_s = opened_s
        self._replies = 0

    @property
    def continuous(self) -> bool:
        """Whether `due` returns replies, now or later."""
        return self._device.continuous

    def received(self, data: bytes, now_s: float) -> list[Reply]:
        """Return the replies to `data`, each with its delay."""
        if self.faults.not_an_e201:
            return [(0.0, _STRANGER)] if e201.VERSION in data else []
        return self._pass(self._device.received(data, now_s), now_s)

    def due(self, now_s: float) -> list[Reply]:
        """Return the replies of the continuous output up to now."""
        return self._pass(self._device.due(now_s), now_s)

    def _pass(self, replies: list[Reply], now_s: float) -> list[Reply]:
        if within(now_s - self._opened_s, self.faults.silent_after_s, self.faults.silent_for_s):
            self.mishaps.silenced += len(replies)
            return []
        return [piece for reply in replies for piece in self._pieces(*reply)]

    def _pieces(self, delay_s: float, reply: bytes) -> list[Reply]:
        faults = self.faults
        self._replies += 1
        if faults.drop_every and self._replies % faults.drop_every == 0:
            self.mishaps.dropped += 1
            return []
        if faults.corrupt_every and self._replies % faults.corrupt_every == 0:
            reply = self._garbled(reply)
        delay_s += faults.slow_s
        if not faults.split or len(reply) < 2:
            return [(delay_s, reply)]
        self.mishaps.split += 1
        middle = len(reply) // 2
        return [(delay_s, reply[:middle]), (delay_s + _PIECES_APART_S, reply[middle:])]

    def _garbled(self, reply: bytes) -> bytes:
        """Remove bytes, remove the end so that the reply joins the next, or put junk before it, in turn."""
        kinds = (reply[:1] + reply[3:], reply[:-1], _JUNK + reply)
        garbled = kinds[self.mishaps.garbled % len(kinds)]
        self.mishaps.garbled += 1
        return garbled
