"""Receives a load cell's stream over UDP, with a large buffer, the kernel's stamps, and few wake-ups."""

import contextlib
import socket
import struct
import sys
import time
from typing import Any

from twisted.internet.protocol import DatagramProtocol
from twisted.internet.udp import Port

from cfid.wire import rdt

RECEIVE_BUFFER_BYTES = 4 << 20  # 1.4 s of single records at 7 kHz; the usual buffer holds 37 ms
# Wake-ups cost the most: the system collects datagrams, and every block of a recording takes those that wait.
_PAUSE_S, _SHORT_PAUSE_S = 0.25, 0.025  # with the buffer that was requested, and with a smaller one
_LONGEST_DRAIN_S = 0.025

# Linux, asm-generic/socket.h; Python 3.11 has no names for them.
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_SO_RCVBUFFORCE = 33  # may exceed the system's limit, for those who may set that limit
_TIMESPEC = struct.Struct("@ll")
_OVERFLOW = struct.Struct("@I")
_LONGEST_DATAGRAM = 2048
_CLOCK_STEP_S = 1e-3  # more than the wall clock drifts between two reads: then it was set


class Inbox:
    """Datagrams from one address, end to end, with the arrival time of each; others are counted and dropped.

    `overflowed` counts datagrams that this computer dropped because its buffer was full, where the system reports it.
    """

    def __init__(self, source: tuple[str, int]) -> None:
        """Take the address of the box."""
        self.foreign = self.malformed = self.overflowed = 0
        self._source = source
        self.data = bytearray()
        self.ends: list[int] = []
        self.arrivals_s: list[float] = []

    def add(self, datagram: bytes, source: tuple[str, int], arrival_s: float) -> None:
        """Take a datagram."""
        if source != self._source:
            self.foreign += 1
        elif not rdt.is_block(len(datagram)):
            self.malformed += 1
        else:
            self.data += datagram
            self.ends.append(len(self.data) // rdt.RECORD_BYTES - 1)
            self.arrivals_s.append(arrival_s)

    def empty(self) -> None:
        """Drop what was read."""
        self.data = bytearray()
        self.ends, self.arrivals_s = [], []


class RdtPort(Port):
    """A UDP port that talks to a box and fills an Inbox; `buffer_bytes` is what the system granted."""

    def __init__(self, inbox: Inbox, *, box: tuple[str, int], reactor: Any) -> None:
        """Take the inbox to fill and the box' address; `startListening` opens the port."""
        super().__init__(0, DatagramProtocol(), reactor=reactor)
        self.buffer_bytes = 0
        self._box = box
        self._inbox = inbox
        self._stamped = False
        self._read_s = time.monotonic()
        self._unix_less_monotonic_s = time.time() - self._read_s

    def createInternetSocket(self) -> socket.socket:  # noqa: N802 - Twisted's name
        """Make the socket with its options."""
        made: socket.socket = super().createInternetSocket()
        self.buffer_bytes = enlarge(made)
        self._stamped = sys.platform == "linux" and _ask_for_stamps(made)
        return made

    def send(self, datagram: bytes) -> None:
        """Send to the box; if it cannot be reached, its silence shows that."""
        with contextlib.suppress(OSError):
            self.socket.sendto(datagram, self._box)

    def close(self) -> None:
        """Close the port."""
        if self.connected:
            self.stopListening()

    def doRead(self) -> None:  # noqa: N802 - Twisted's name
        """Take all waiting datagrams, and read again a little later."""
        self.drain()
        self.stopReading()
        pause_s = _PAUSE_S if self.buffer_bytes >= RECEIVE_BUFFER_BYTES else _SHORT_PAUSE_S
        self.reactor.callLater(pause_s, self._read_again)

    def drain(self) -> None:
        """Take all waiting datagrams."""
        if self.socket is None:
            return
        now_s = time.monotonic()
        read_s, self._read_s = self._read_s, now_s
        before_s, self._unix_less_monotonic_s = self._unix_less_monotonic_s, time.time() - now_s
        clock_was_set = abs(self._unix_less_monotonic_s - before_s) > _CLOCK_STEP_S
        try:
            while True:
                if self._stamped:
                    data, ancillary, _, source = self.socket.recvmsg(_LONGEST_DATAGRAM, 64)
                    arrival_s = now_s if clock_was_set else self._stamp(ancillary, read_s, now_s)
                else:
                    data, source = self.socket.recvfrom(_LONGEST_DATAGRAM)
                    arrival_s = now_s
                self._inbox.add(data, source, arrival_s)
        except BlockingIOError:
            return
        except OSError:  # the network reports that no program listens: the silence will be reported
            return

    def _read_again(self) -> None:
        if self.connected:
            self.startReading()

    def _stamp(self, ancillary: list[tuple[int, int, bytes]], read_s: float, now_s: float) -> float:
        """Return when the system received a datagram, on the monotonic clock; its stamp is of the wall clock.

        The datagram arrived after the last read, which would otherwise have taken it: an earlier stamp is rejected.
        """
        arrival_s = now_s
        for _, kind, value in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack(value)
                arrival_s = seconds + 1e-9 * nanoseconds - self._unix_less_monotonic_s
            elif kind == _SO_RXQ_OVFL:
                (self._inbox.overflowed,) = _OVERFLOW.unpack(value)
        return arrival_s if read_s - _CLOCK_STEP_S < arrival_s < now_s + _LONGEST_DRAIN_S else now_s


def enlarge(made: socket.socket) -> int:
    """Request a large receive buffer; return the size granted, which Linux reports doubled."""
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF) if sys.platform == "linux" else (socket.SO_RCVBUF,):
        try:
            made.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER_BYTES)
            break
        except OSError:
            continue
    granted = made.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    return granted // 2 if sys.platform == "linux" else granted


def _ask_for_stamps(made: socket.socket) -> bool:
    try:
        made.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        made.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    except OSError:
        return False
    return True
