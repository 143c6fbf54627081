"""Serves a simulated Net F/T box: RDT over UDP, pages over HTTP, single readings over TCP."""

import contextlib
import math
import socket
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
        for port, protocol in ((self._wanted.http, _Page), (self._wanted.tcp, _SingleReading)):
            factory = Factory.forProtocol(partial(protocol, self._box, self._reactor))
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


class _Conversation(Protocol):
    """Questions that each get an answer, later when the box is slow; none from a box without power."""

    transport: Connection  # type: ignore[assignment]  # twisted tells types only what every transport has

    def __init__(self, box: FaultyNetFT, reactor: PosixReactorBase) -> None:
        self._box = box
        self._reactor = reactor
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
        if self._box.alive(self._reactor.seconds()):
            self._answer_heard()
        else:
            self.transport.abortConnection()

    def _answer_heard(self) -> None:
        raise NotImplementedError


class _Page(_Conversation):
    """One GET a connection, as HTTP 1.0 has it."""

    def _answer_heard(self) -> None:
        if _BLANK_LINE not in self._heard:
            if len(self._heard) > _LONGEST_HTTP_REQUEST:
                self.transport.abortConnection()
            return
        words = self._heard.split(b"\r\n", 1)[0].decode("latin-1").split()
        body = self._body(words[1]) if len(words) == 3 and words[0] == "GET" else None
        status = "404 Not Found" if body is None else "200 OK"
        content = (body or "").encode()
        kind = "text/xml" if body and body.startswith("<?xml") else "text/html"
        head = f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(content)}\r\n\r\n"
        self.transport.write(head.encode() + content)
        self.transport.loseConnection()

    def _body(self, path_and_query: str) -> str | None:
        target = urlsplit(path_and_query)
        if target.path == CONFIGURATION_PATH:
            index = parse_qs(target.query).get("index", [""])[-1]
            return self._box.page(int(index) if index.isdecimal() else None)
        return "<html>done</html>" if self._box.apply(path_and_query) else None


class _SingleReading(_Conversation):
    def _answer_heard(self) -> None:
        while len(self._heard) >= COMMAND_BYTES:
            command, self._heard = self._heard[:COMMAND_BYTES], self._heard[COMMAND_BYTES:]
            self.transport.write(self._box.answer(command, self._reactor.seconds()))
