"""Serves a simulated rig on this machine: an encoder on a serial port, a load cell on UDP and TCP, a vehicle on UDP."""

import contextlib
import math
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred, gatherResults, succeed
from twisted.internet.posixbase import PosixReactorBase
from twisted.internet.protocol import DatagramProtocol, Factory, Protocol
from twisted.internet.tcp import Connection
from twisted.internet.tcp import Port as TcpPort
from twisted.internet.udp import Port as UdpPort

from cfid.records.rig_file import Devices, EncoderLines, LoadCellLines
from cfid.sim.devices import SimulatedRig
from cfid.sim.faults import FaultyNetFT
from cfid.sim.link import VehicleLink
from cfid.sim.netft import COMMAND_BYTES, Address
from cfid.sim.pty import PtyPort

LOOPBACK = "127.0.0.1"
SENDING_EVERY_S = 2e-3

_LONGEST_HTTP_REQUEST = 8192


class _Datagrams(DatagramProtocol):
    def __init__(self, take: Callable[[bytes, Address], None]) -> None:
        self._take = take

    def datagramReceived(self, datagram: bytes, addr: Address) -> None:  # noqa: N802 (twisted's name)
        self._take(datagram, addr)


class BoxPorts(NamedTuple):
    """The box' ports: UDP for RDT, TCP for HTTP, TCP for single readings."""

    rdt: int
    http: int
    tcp: int


ANY_FREE = BoxPorts(0, 0, 0)


class NetFTServer:
    """A box on three ports of one address; port 0 takes a free one.

    It sends due records every `sending_every_s`: a real box sends each record at its own time, which costs much more
    on both sides and makes no difference in the records.
    """

    def __init__(
        self,
        box: FaultyNetFT,
        *,
        reactor: PosixReactorBase,
        address: str = LOOPBACK,
        ports: BoxPorts = ANY_FREE,
        sending_every_s: float = SENDING_EVERY_S,
    ) -> None:
        """Open nothing yet."""
        self._box = box
        self._reactor = reactor
        self._address = address
        self._requested = ports
        self._every_s = sending_every_s
        self._open: list[UdpPort | TcpPort] = []
        self._socket: socket.socket | None = None
        self._timer: DelayedCall | None = None

    def open(self) -> BoxPorts:
        """Bind the ports. Raises twisted's CannotListenError when one is taken."""
        udp: UdpPort = self._reactor.listenUDP(self._requested.rdt, _Datagrams(self._received), self._address)
        self._open = [udp]
        self._socket = udp.socket
        for port, reply in ((self._requested.http, _page), (self._requested.tcp, _readings)):
            factory = Factory.forProtocol(partial(_Conversation, self._box, self._reactor, reply))
            self._open.append(self._reactor.listenTCP(port, factory, interface=self._address))
        return BoxPorts(*(port.getHost().port for port in self._open))

    def close(self) -> Deferred[list[None]]:
        """Close the ports; fires when all are closed."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        stopping = [port.stopListening() for port in self._open]
        self._open, self._socket = [], None
        return gatherResults([done for done in stopping if done is not None])

    def _received(self, datagram: bytes, client: Address) -> None:
        self._box.request(datagram, client, self._reactor.seconds())
        if self._box.streaming and self._timer is None:
            self._wait()

    def _wait(self) -> None:
        """Wake up at the next grid point, so that one delay does not shift later ones."""
        now_s = self._reactor.seconds()
        next_s = (math.floor(now_s / self._every_s) + 1) * self._every_s
        self._timer = self._reactor.callLater(next_s - now_s, self._send)

    def _send(self) -> None:
        self._timer = None
        assert self._socket is not None
        send = self._socket.sendto  # the transport's own write checks each address and is half as fast
        for data, client in self._box.due(self._reactor.seconds()):
            with contextlib.suppress(OSError):  # a full buffer or no route: a network loses datagrams too
                send(data, client)
        if self._box.streaming:
            self._wait()


Reply = tuple[bytes, bytes, bool]  # what is answered, what is left to be read, and whether that is all


class _Conversation(Protocol):
    """Questions and their answers, delayed when the box is slow; none from a box without power."""

    transport: Connection  # type: ignore[assignment]  # twisted declares only what every transport has

    def __init__(
        self, box: FaultyNetFT, reactor: PosixReactorBase, reply: Callable[[FaultyNetFT, bytes, float], Reply]
    ) -> None:
        self._box, self._reactor, self._reply = box, reactor, reply
        self._received = b""

    def connectionMade(self) -> None:  # noqa: N802 (twisted's name)
        if not self._box.alive(self._reactor.seconds()):
            self.transport.abortConnection()

    def dataReceived(self, data: bytes) -> None:  # noqa: N802 (twisted's name)
        self._received += data
        self._reactor.callLater(self._box.faults.slow_s, self._answer)

    def _answer(self) -> None:
        if not self.connected:
            return
        now_s = self._reactor.seconds()
        if not self._box.alive(now_s):
            self.transport.abortConnection()
            return
        answer, self._received, ends = self._reply(self._box, self._received, now_s)
        self.transport.write(answer)
        if ends:
            self.transport.loseConnection()


def _page(box: FaultyNetFT, received: bytes, now_s: float) -> Reply:
    """Answer one GET a connection, as in HTTP 1.0."""
    if b"\r\n\r\n" not in received:
        return b"", received, len(received) > _LONGEST_HTTP_REQUEST
    fields = received.split(b"\r\n", 1)[0].decode("latin-1").split()
    body = box.get(fields[1]) if len(fields) == 3 and fields[0] == "GET" else None
    status = "404 Not Found" if body is None else "200 OK"
    content = (body or "").encode()
    kind = "text/xml" if body and body.startswith("<?xml") else "text/html"
    head = f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(content)}\r\n\r\n"
    return head.encode() + content, received, True


def _readings(box: FaultyNetFT, received: bytes, now_s: float) -> Reply:
    """Answer commands of COMMAND_BYTES."""
    answers = b""
    while len(received) >= COMMAND_BYTES:
        answers += box.box.answer(received[:COMMAND_BYTES], now_s)
        received = received[COMMAND_BYTES:]
    return answers, received, False


class CrazyflieServer:
    """A vehicle on a UDP port, as cflib's `udp://` expects; port 0 takes a free one.

    It sleeps until something is due.
    """

    def __init__(
        self, vehicle: VehicleLink, *, reactor: PosixReactorBase, address: str = LOOPBACK, port: int = 0
    ) -> None:
        """Open nothing yet."""
        self._vehicle = vehicle
        self._reactor = reactor
        self._address, self._requested_port = address, port
        self._port: UdpPort | None = None
        self._socket: socket.socket | None = None
        self._timer: DelayedCall | None = None

    def open(self) -> str:
        """Bind the port and return its address in cflib's form. Raises twisted's CannotListenError."""
        self._port = self._reactor.listenUDP(self._requested_port, _Datagrams(self._received), self._address)
        self._socket = self._port.socket
        self._attend()
        return f"udp://{self._address}:{self._port.getHost().port}"

    def close(self) -> Deferred[None]:
        """Close the port and stop serving the vehicle; fires when it is done."""
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
        return self._shut()

    def _received(self, datagram: bytes, client: Address) -> None:
        self._vehicle.received(datagram, client, self._reactor.seconds())
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
        self._attend()

    def _attend(self) -> None:
        """Send due packets, and schedule the next event; the vehicle goes on even without a port."""
        now_s = self._reactor.seconds()
        if self._vehicle.closed(now_s):
            self._shut()
        for packet, client in self._vehicle.due(now_s):
            if self._socket is not None:
                with contextlib.suppress(OSError):  # a full buffer or no route: a radio loses packets too
                    self._socket.sendto(packet, client)
        next_s = self._vehicle.next_s(now_s)
        if next_s is not None:
            self._timer = self._reactor.callLater(max(0.0, next_s - self._reactor.seconds()), self._attend)

    def _shut(self) -> Deferred[None]:
        port, self._port, self._socket = self._port, None, None
        return (port.stopListening() if port is not None else None) or succeed(None)


class Addresses(NamedTuple):
    """The addresses of the two instruments and the vehicle; a load cell that sends lines has a port."""

    encoder_port: Path
    loadcell_port: Path | None
    address: str
    rdt_port: int
    http_port: int
    tcp_port: int
    crazyflie_uri: str


class ServedRig:
    """A simulated rig on pseudo-terminals in a folder, and on ports of one address."""

    def __init__(
        self,
        rig: SimulatedRig,
        *,
        reactor: PosixReactorBase,
        folder: Path,
        address: str = LOOPBACK,
        ports: BoxPorts = ANY_FREE,
    ) -> None:
        """Open nothing yet."""
        self._address = address
        self._pty = PtyPort(rig.encoder, reactor=reactor, folder=folder)
        lines = rig.loadcell_lines
        self._cell_pty = None if lines is None else PtyPort(lines, reactor=reactor, folder=folder, name="loadcell")
        self._server = NetFTServer(rig.loadcell, reactor=reactor, address=address, ports=ports)
        self._link = CrazyflieServer(rig.crazyflie, reactor=reactor, address=address)

    def open(self) -> Addresses:
        """Open all ports. Raises twisted's CannotListenError when a port is taken."""
        ports = self._server.open()
        cell_port = None if self._cell_pty is None else self._cell_pty.open()
        return Addresses(self._pty.open(), cell_port, self._address, *ports, self._link.open())

    def close(self) -> Deferred[list[Any]]:
        """Close all ports; fires when all are closed."""
        self._pty.close()
        if self._cell_pty is not None:
            self._cell_pty.close()
        closing: list[Deferred[Any]] = [self._server.close(), self._link.close()]
        return gatherResults(closing)


def devices_at(where: Addresses, devices: Devices, *, supply: bool) -> Devices:
    """Return a rig's devices at the addresses of the simulated ones, whose lines all have one form.

    A `supply` feeds the simulated vehicle, or a battery.
    """
    encoder, loadcell = devices.encoder, devices.loadcell
    own_form = {"pattern": ""}
    box = {
        "address": where.address,
        "rdt_port": where.rdt_port,
        "http_port": where.http_port,
        "tcp_port": where.tcp_port,
    }
    return Devices(
        encoder=encoder.model_copy(
            update={"port": str(where.encoder_port), **(own_form if isinstance(encoder, EncoderLines) else {})}
        ),
        loadcell=loadcell.model_copy(
            update={"port": str(where.loadcell_port), **own_form} if isinstance(loadcell, LoadCellLines) else box
        ),
        crazyflie=devices.crazyflie.model_copy(update={"uri": where.crazyflie_uri, "supply": supply}),
        tachometer=devices.tachometer,
        scales=devices.scales,
    )
