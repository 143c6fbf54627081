"""Opens a link to a vehicle: packets in both directions with their times, over a datagram socket or a driver of cflib.

A link is ready in a moment, for a stop; `tables.connect` also reads the tables of a vehicle. Two threads of its own
receive and send, so that neither a radio that takes no packet nor a busy loop falsifies a packet's time.
"""

import contextlib
import queue
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from cfid.errors import DeviceError
from cfid.wire.crtp import (
    ECHO_CHANNEL,
    ECHO_PORT,
    LONGEST_PAYLOAD,
    Packet,
    Variable,
    decode_packet,
    encode_echo,
    encode_packet,
)

if TYPE_CHECKING:
    from cfid.rig.radio import Driver

Arrived = tuple[Packet, float]

_ECHO = Packet(ECHO_PORT, ECHO_CHANNEL, encode_echo(0))  # so that a silent vehicle shows that it is there


class QueuedPacket:
    """A packet on its way out; `at_s` is when the driver took it, on the monotonic clock."""

    def __init__(self, packet: Packet) -> None:
        """Start as not yet sent."""
        self.packet = packet
        self.at_s: float | None = None


class Link(ABC):
    """An open link to a vehicle; `received_s` is when the last packet arrived, 0 before the first.

    `fault` states why it no longer works. Version and tables are those that `tables.connect` has read.
    """

    def __init__(self, uri: str) -> None:
        """Take the address; nothing has arrived yet."""
        self.uri = uri
        self.fault = ""
        self.persists = False  # whether a link that failed still takes packets, as a stop has to be tried
        self.received_s = 0.0
        self.firmware_protocol = -1
        self.variables: Mapping[str, Variable] = {}
        self.parameters: Mapping[str, Variable] = {}

    def variable(self, name: str) -> Variable | None:
        """Return a log variable by its name, such as `pm.vbat`."""
        return self.variables.get(name)

    def parameter(self, name: str) -> Variable | None:
        """Return a parameter by its name, such as `motorPowerSet.enable`."""
        return self.parameters.get(name)

    @abstractmethod
    def send(self, packet: Packet) -> QueuedPacket:
        """Send a packet without waiting; the returned object gets the time at which it left.

        Raises DeviceError when the link is gone, or when the driver takes no more packets.
        """

    @abstractmethod
    def receive(self, within_s: float) -> Packet | None:
        """Return the next packet, None when none comes in time. Once a loop is attached, it takes the packets."""

    @abstractmethod
    def attach(self, wake: Callable[[], None]) -> None:
        """Call `wake`, from any thread, whenever a packet has arrived: it makes a loop call `arrived`."""

    @abstractmethod
    def arrived(self) -> list[Arrived]:
        """Return the packets that arrived since the last call, each with its time on the monotonic clock."""

    @abstractmethod
    def close(self) -> None:
        """Close the link; send nothing."""


def open_link(uri: str) -> Link:
    """Open a link over a datagram socket or a driver of cflib.

    Raises DeviceError, also for a radio that another process uses.
    """
    return _ThreadedLink(uri)


class _ThreadedLink(Link):
    """A link with a thread that sends and one that receives."""

    def __init__(self, uri: str) -> None:
        super().__init__(uri)
        self._closed = False
        self._arrived: queue.SimpleQueue[Arrived] = queue.SimpleQueue()
        self._leaving: queue.Queue[QueuedPacket | None] = queue.Queue(64)
        self._wake: Callable[[], None] = lambda: None
        try:
            self._carrier = self._opened(uri)
        except Exception as error:  # drivers, and those of USB, raise errors of any kind
            raise DeviceError(f"{uri}: {_meaning(uri, str(error))}") from None
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._receive_all, self._send_all)]
        for thread in self._threads:
            thread.start()

    def send(self, packet: Packet) -> QueuedPacket:
        if self._closed or (self.fault and not self.persists):
            raise DeviceError(self.fault or f"{self.uri}: the link is closed.")
        leaving = QueuedPacket(packet)
        try:
            self._leaving.put_nowait(leaving)
        except queue.Full:
            raise DeviceError(f"{self.uri}: the link takes no more packets.") from None
        return leaving

    def receive(self, within_s: float) -> Packet | None:
        with contextlib.suppress(queue.Empty):
            return self._arrived.get(timeout=max(within_s, 0.0))[0]
        return None

    def attach(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        wake()

    def arrived(self) -> list[Arrived]:
        packets: list[Arrived] = []
        with contextlib.suppress(queue.Empty):
            while True:
                packets.append(self._arrived.get_nowait())
        return packets

    def close(self) -> None:
        """Close the link, and wait for its threads and for the driver, which may take two seconds."""
        self._closed, self._wake = True, lambda: None
        with contextlib.suppress(queue.Full):
            self._leaving.put_nowait(None)
        closing = threading.Thread(target=self._carrier.close, daemon=True)
        closing.start()
        for thread in (closing, *self._threads):
            thread.join(2.5)

    def _opened(self, uri: str) -> "_Datagrams | Driver":
        if uri.startswith("udp://"):
            return _Datagrams(uri)
        from cfid.rig.radio import Driver  # cflib's import takes longer than a stop

        return Driver(uri, self._fail)

    def _send_all(self) -> None:
        """Hand packets to the driver, one after the other, until the link is closed; ask for an echo in pauses."""
        sent_s = time.monotonic()
        while not self._closed:
            try:
                leaving = self._leaving.get(timeout=max(sent_s + 0.1 - time.monotonic(), 0.0))
            except queue.Empty:
                leaving, sent_s = QueuedPacket(_ECHO), time.monotonic()
            if leaving is None or self._closed:
                return
            leaving.at_s = time.monotonic()
            try:
                self._carrier.send(leaving.packet)
            except OSError as error:
                self._fail(str(error))

    def _receive_all(self) -> None:
        while not self._closed:
            try:
                arrived = self._carrier.receive()
            except OSError as error:
                if not self._closed:
                    self._fail(str(error))
                time.sleep(0.2)
                continue
            if arrived is not None and not self._closed:
                self.received_s = arrived[1]
                self._arrived.put(arrived)
                self._wake()

    def _fail(self, reason: str) -> None:
        if not self.fault:
            self.fault = f"{self.uri}: {_meaning(self.uri, reason)}"
        self._wake()


class _Datagrams:
    """A UDP socket, one packet a datagram; like a driver of cflib, it raises OSError when the vehicle is gone."""

    def __init__(self, uri: str) -> None:
        where = urlsplit(uri)
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        try:
            self._socket.connect((where.hostname or "", where.port or 0))
        except (OSError, ValueError):
            self._socket.close()
            raise

    def send(self, packet: Packet) -> None:
        self._socket.send(encode_packet(packet))

    def receive(self) -> Arrived | None:
        datagram = self._socket.recv(2 * LONGEST_PAYLOAD)
        now_s = time.monotonic()
        packet = decode_packet(datagram)
        return None if packet is None else (packet, now_s)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def _meaning(uri: str, reason: str) -> str:
    if "unreachable" in reason:
        return "the network has no route to it."
    if "refused" in reason:
        return "no program listens there: the vehicle is off, or the address is wrong."
    if "no driver" in reason:
        return "this is not the address of a vehicle, such as radio://0/80/2M/E7E7E7E7E7."
    if "radio" in reason.lower() and uri.startswith("radio"):
        return f"no Crazyradio: {reason.strip()}. Plug it in; on Linux, install its udev rules."
    return f"the link failed: {reason.strip()}."
