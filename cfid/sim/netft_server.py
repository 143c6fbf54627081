"""Serves a simulated Net F/T box: RDT over UDP, pages over HTTP, single readings over TCP."""

import contextlib
import math
import socket
from collections.abc import Callable
from functools import partial
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred, gatherResults
from twisted.internet.posixbase import PosixReactorBase
from twisted.internet.protocol import DatagramProtocol, Factory, Protocol
from twisted.internet.tcp import Connection
from twisted.internet.tcp import Port as TcpPort
from twisted.internet.udp import Port as UdpPort

from cfid.sim.netft import COMMAND_BYTES, Address
from cfid.sim.netft_faults import FaultyNetFT
from cfid.wire.netft import CONFIGURATION_PATH

SENDING_EVERY_S = 2e-3
LOOPBACK = "127.0.0.1"

_LONGEST_HTTP_REQUEST = 8192
_BLANK_LINE = b"\r\n\r\n"


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
        udp: UdpPort = self._reactor.listenUDP(self._requested.rdt, _Requests(self), self._address)
        self._open = [udp]
        self._socket = udp.socket
        for port, answer in ((self._requested.http, _page), (self._requested.tcp, _readings)):
            factory = Factory.forProtocol(partial(_Conversation, self._box, self._reactor, answer))
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

    def received(self, datagram: bytes, client: Address) -> None:
        """Take a UDP datagram."""
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


class _Requests(DatagramProtocol):
    def __init__(self, server: NetFTServer) -> None:
        self._server = server

    def datagramReceived(self, datagram: bytes, addr: Address) -> None:  # noqa: N802 (twisted's name)
        self._server.received(datagram, addr)


class _Reply(NamedTuple):
    """The bytes to send, the received bytes not yet answered, and whether the connection is over."""

    sent: bytes
    left: bytes
    over: bool


_Answer = Callable[[FaultyNetFT, bytes, float], _Reply]  # the box, the received bytes, and the time


class _Conversation(Protocol):
    """Questions and their answers, delayed when the box is slow; none from a box without power."""

    transport: Connection  # type: ignore[assignment]  # twisted declares only what every transport has

    def __init__(self, box: FaultyNetFT, reactor: PosixReactorBase, answer: _Answer) -> None:
        self._box = box
        self._reactor = reactor
        self._answer_to = answer
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
        if not self._box.alive(self._reactor.seconds()):
            self.transport.abortConnection()
            return
        sent, self._received, over = self._answer_to(self._box, self._received, self._reactor.seconds())
        self.transport.write(sent)
        if over:
            self.transport.loseConnection()


def _page(box: FaultyNetFT, received: bytes, now_s: float) -> _Reply:
    """Answer one GET per connection, as in HTTP 1.0."""
    if _BLANK_LINE not in received:
        return _Reply(b"", received, over=len(received) > _LONGEST_HTTP_REQUEST)
    fields = received.split(b"\r\n", 1)[0].decode("latin-1").split()
    body = page_of(box, fields[1]) if len(fields) == 3 and fields[0] == "GET" else None
    status = "404 Not Found" if body is None else "200 OK"
    content = (body or "").encode()
    kind = "text/xml" if body and body.startswith("<?xml") else "text/html"
    head = f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(content)}\r\n\r\n"
    return _Reply(head.encode() + content, received, over=True)


def page_of(box: FaultyNetFT, path_and_query: str) -> str | None:
    """Return the page at a path, None where the box has none; a setting in its query is applied."""
    target = urlsplit(path_and_query)
    if target.path == CONFIGURATION_PATH:
        index = parse_qs(target.query).get("index", [""])[-1]
        return box.page(int(index) if index.isdecimal() else None)
    return "<html>done</html>" if box.apply(path_and_query) else None


def _readings(box: FaultyNetFT, received: bytes, now_s: float) -> _Reply:
    """Answer each whole command over TCP."""
    sent = b""
    while len(received) >= COMMAND_BYTES:
        command, received = received[:COMMAND_BYTES], received[COMMAND_BYTES:]
        sent += box.answer(command, now_s)
    return _Reply(sent, received, over=False)
