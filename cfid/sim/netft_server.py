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


class Ports(NamedTuple):
    """Where the box is reached: UDP for RDT, TCP for HTTP, TCP for single readings."""

    rdt: int
    http: int
    tcp: int


ANY_FREE = Ports(0, 0, 0)


class NetFTServer:
    """A box on three ports of one address; port 0 takes a free one.

    It looks every `sending_every_s` what is due: a real box sends each record on its own, which costs much more
    on both sides and looks the same in the records.
    """

    def __init__(
        self,
        box: FaultyNetFT,
        *,
        reactor: PosixReactorBase,
        address: str = LOOPBACK,
        ports: Ports = ANY_FREE,
        sending_every_s: float = SENDING_EVERY_S,
    ) -> None:
        """Open nothing yet."""
        self._box = box
        self._reactor = reactor
        self._address = address
        self._wanted = ports
        self._every_s = sending_every_s
        self._open: list[UdpPort | TcpPort] = []
        self._socket: socket.socket | None = None
        self._timer: DelayedCall | None = None

    def open(self) -> Ports:
        """Bind the ports. Raises twisted's CannotListenError when one is taken."""
        udp: UdpPort = self._reactor.listenUDP(self._wanted.rdt, _Requests(self), self._address)
        self._open = [udp]
        self._socket = udp.socket
        for port, answer in ((self._wanted.http, _page), (self._wanted.tcp, _readings)):
            factory = Factory.forProtocol(partial(_Conversation, self._box, self._reactor, answer))
            self._open.append(self._reactor.listenTCP(port, factory, interface=self._address))
        return Ports(*(port.getHost().port for port in self._open))

    def close(self) -> "Deferred[list[None]]":
        """Give the ports back; fires when all are."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        stopping = [port.stopListening() for port in self._open]
        self._open, self._socket = [], None
        return gatherResults([done for done in stopping if done is not None])

    def heard(self, datagram: bytes, client: Address) -> None:
        """Take a datagram that came in by UDP."""
        self._box.request(datagram, client, self._reactor.seconds())
        if self._box.streaming and self._timer is None:
            self._wait()

    def _wait(self) -> None:
        """Wake up at the next place of the grid, so that being late once delays nothing after."""
        now_s = self._reactor.seconds()
        next_s = (math.floor(now_s / self._every_s) + 1) * self._every_s
        self._timer = self._reactor.callLater(next_s - now_s, self._send)

    def _send(self) -> None:
        self._timer = None
        assert self._socket is not None
        send = self._socket.sendto  # the transport's own write checks each address: half as quick
        for data, client in self._box.due(self._reactor.seconds()):
            with contextlib.suppress(OSError):  # a full buffer or no way there: a network loses datagrams too
                send(data, client)
        if self._box.streaming:
            self._wait()


class _Requests(DatagramProtocol):
    def __init__(self, server: NetFTServer) -> None:
        self._server = server

    def datagramReceived(self, datagram: bytes, addr: Address) -> None:  # noqa: N802 (twisted's name)
        self._server.heard(datagram, addr)


class _Reply(NamedTuple):
    """What is sent, what was heard beyond the questions answered, and whether nothing more is said."""

    sent: bytes
    left: bytes
    over: bool


_Answer = Callable[[FaultyNetFT, bytes, float], _Reply]  # the box, what was heard, and the time


class _Conversation(Protocol):
    """Questions that each get an answer, later when the box is slow; none from a box without power."""

    transport: Connection  # type: ignore[assignment]  # twisted tells types only what every transport has

    def __init__(self, box: FaultyNetFT, reactor: PosixReactorBase, answer: _Answer) -> None:
        self._box = box
        self._reactor = reactor
        self._answer_to = answer
        self._heard = b""

    def connectionMade(self) -> None:  # noqa: N802 (twisted's name)
        if not self._box.alive(self._reactor.seconds()):
            self.transport.abortConnection()

    def dataReceived(self, data: bytes) -> None:  # noqa: N802 (twisted's name)
        self._heard += data
        self._reactor.callLater(self._box.faults.slow_s, self._answer)

    def _answer(self) -> None:
        if not self.connected:
            return
        if not self._box.alive(self._reactor.seconds()):
            self.transport.abortConnection()
            return
        sent, self._heard, over = self._answer_to(self._box, self._heard, self._reactor.seconds())
        self.transport.write(sent)
        if over:
            self.transport.loseConnection()


def _page(box: FaultyNetFT, heard: bytes, now_s: float) -> _Reply:
    """Answer one GET a connection, as HTTP 1.0 has it."""
    if _BLANK_LINE not in heard:
        return _Reply(b"", heard, over=len(heard) > _LONGEST_HTTP_REQUEST)
    words = heard.split(b"\r\n", 1)[0].decode("latin-1").split()
    body = _body(box, words[1]) if len(words) == 3 and words[0] == "GET" else None
    status = "404 Not Found" if body is None else "200 OK"
    content = (body or "").encode()
    kind = "text/xml" if body and body.startswith("<?xml") else "text/html"
    head = f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(content)}\r\n\r\n"
    return _Reply(head.encode() + content, heard, over=True)


def _body(box: FaultyNetFT, path_and_query: str) -> str | None:
    target = urlsplit(path_and_query)
    if target.path == CONFIGURATION_PATH:
        index = parse_qs(target.query).get("index", [""])[-1]
        return box.page(int(index) if index.isdecimal() else None)
    return "<html>done</html>" if box.apply(path_and_query) else None


def _readings(box: FaultyNetFT, heard: bytes, now_s: float) -> _Reply:
    """Answer each whole command over TCP."""
    sent = b""
    while len(heard) >= COMMAND_BYTES:
        command, heard = heard[:COMMAND_BYTES], heard[COMMAND_BYTES:]
        sent += box.answer(command, now_s)
    return _Reply(sent, heard, over=False)
