"""Simulates a Net F/T box: RDT over UDP, pages over HTTP, single readings over TCP, and the settings behind them."""

import contextlib
import math
import socket
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol
from urllib.parse import parse_qs, urlsplit
from xml.sax.saxutils import escape

import numpy as np
import numpy.typing as npt
from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred, gatherResults
from twisted.internet.posixbase import PosixReactorBase
from twisted.internet.protocol import DatagramProtocol, Factory
from twisted.internet.protocol import Protocol as Stream
from twisted.internet.tcp import Connection
from twisted.internet.tcp import Port as TcpPort
from twisted.internet.udp import Port as UdpPort

from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.stepping import Array
from cfid.wire.netft import CONFIGURATION_PATH, LoadReading, encode_reading
from cfid.wire.rdt import (
    INTERNAL_HZ,
    LONGEST_BUFFER,
    RECORD,
    RECORD_BYTES,
    Command,
    decode_request,
    encode_records,
)

Address = tuple[str, int]
Datagram = tuple[bytes, Address]
Plant = Callable[[Array], Array]

LONGEST_STALL_S = 2.0
SENDING_EVERY_S = 2e-3
COMMAND_BYTES = 20  # of a command over TCP
LOOPBACK = "127.0.0.1"

_UNBIASED = (0,) * 6
_ANY_ERROR = 1 << 31
_LATCHED_THRESHOLD = 1 << 16
_INT16_MAX = 32767
_READ_CALIBRATION = 1
_SCALES = struct.Struct(">HBBII6H")
_HEADER = 0x1234
# Manual of the Net F/T, READCALINFO: the codes of units.
_FORCE_CODES = {"lbf": 1, "N": 2, "klbf": 3, "kN": 4, "kgf": 5}
_TORQUE_CODES = {"lbf-in": 1, "lbf-ft": 2, "Nm": 3, "Nmm": 4, "kgf-cm": 5, "kNm": 6}
_LONGEST_HTTP_REQUEST = 8192
_PRODUCT, _FIRMWARE = "Net F/T", "2.2.62"
_BLANK_LINE = b"\r\n\r\n"


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """One of the box' 16 configurations: counts per unit, units, ranges Fx to Tz in these units."""

    name: str
    calibration_serial: str = "FT12345"
    counts_per_force: int
    counts_per_torque: int
    force_unit: str
    torque_unit: str
    ranges: tuple[float, ...]


def configurations_of(truth: LoadCellTruth) -> tuple[Configuration, Configuration]:
    """Return a configuration in pounds, as delivered, and one in N and Nm with the cell's true scales.

    Applying the first while the second is active gives readings 4.4 times too large.
    """
    delivered = Configuration(
        name="Default",
        counts_per_force=1_000_000,
        counts_per_torque=1_000_000,
        force_unit="lbf",
        torque_unit="lbf-in",
        ranges=(5.0, 5.0, 15.0, 10.0, 10.0, 10.0),
    )
    metric = Configuration(
        name="Thrust stand",
        counts_per_force=round(truth.counts_per_n),
        counts_per_torque=round(truth.counts_per_nm),
        force_unit="N",
        torque_unit="Nm",
        ranges=truth.ranges,
    )
    return delivered, metric


@dataclass(kw_only=True)
class _Stream:
    """An answered request: its client, records a datagram, records left (None: endless), next tick and number."""

    client: Address
    block: int
    step: int
    remaining: int | None
    next_tick: int
    sequence: int = 1


class NetFTBox:
    """The box from power-up on, which silently ignores invalid settings, as the real one does.

    `plant` returns the wrench (n, 6) in N and Nm at times (n,) of the clock of `now_s`, which never decrease.
    Like the real box it has one client: a request takes the stream from any other client. Samples lie on a grid
    of `internal_hz` since power-up, which ft_sequence counts from `first_ft_sequence`; a new rate or buffer
    applies from the next request on. `skipped_records` counts records omitted because `due` was not called.
    """

    def __init__(
        self,
        *,
        load_cell: SimulatedLoadCell,
        plant: Plant,
        internal_hz: int = INTERNAL_HZ,
        rate_hz: float = INTERNAL_HZ,
        buffer_size: int = 1,
        first_ft_sequence: int = 0,
        powered_s: float = 0.0,
        status: int = 0,
        configurations: Sequence[Configuration] | None = None,
        active: int = 1,
    ) -> None:
        """Power up at `powered_s`; `active` is the index of the configuration in use."""
        self.load_cell = load_cell
        self.status = status
        self.skipped_records = 0
        self._configurations = tuple(configurations or configurations_of(load_cell.truth))
        self._active = active
        self.enabled = True
        self.bias_counts: tuple[int, ...] = _UNBIASED
        self._internal_hz, self.buffer_size = internal_hz, buffer_size
        self._step = self._step_of(rate_hz)
        self._plant = plant
        self._first_ft_sequence = first_ft_sequence
        self._powered_s = powered_s
        self._stream: _Stream | None = None

    @property
    def streaming(self) -> bool:
        """Whether `due` returns datagrams, now or later."""
        return self._stream is not None

    def request(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Execute an RDT request; other datagrams, and requests for several units, are ignored."""
        request = decode_request(datagram)
        if request is None or request.command not in set(Command) - {Command.MULTI_UNIT}:
            return
        if request.command == Command.BIAS:
            self._bias(now_s)
        elif request.command == Command.RESET_THRESHOLD:
            self._reset_latch()
        self._stream = None
        if request.command in (Command.REAL_TIME, Command.BUFFERED) and self.enabled:
            self._stream = _Stream(
                client=client,
                block=self.buffer_size if request.command == Command.BUFFERED else 1,
                step=self._step,
                remaining=request.records or None,
                next_tick=(self._tick(now_s) // self._step + 1) * self._step,
            )

    def next_s(self) -> float:
        """Return when the next datagram is complete, infinity without a stream."""
        if self._stream is None:
            return math.inf
        last_tick = self._stream.next_tick + (self._stream.block - 1) * self._stream.step
        return self._powered_s + last_tick / self._internal_hz

    def due(self, now_s: float) -> list[Datagram]:
        """Return the datagrams whose samples have all been taken by now.

        After a stall, records less than LONGEST_STALL_S old are caught up. The real box never stalls, so older records
        count as sent: a client sees them as lost.
        """
        stream = self._stream
        if stream is None:
            return []
        self._skip_stale(stream, now_s)
        count = (self._tick(now_s) - stream.next_tick) // stream.step + 1
        last = stream.remaining is not None and count >= stream.remaining
        if last:
            count = stream.remaining or 0
        else:
            count -= count % stream.block
        if count <= 0:
            return []
        data = self._records(stream, count)
        if last:
            self._stream = None
        size = stream.block * RECORD_BYTES
        return [(data[at : at + size], stream.client) for at in range(0, len(data), size)]

    def page(self, index: int | None = None) -> str:
        """Return netftapi2.xml for a configuration; without an index, or with one too large, for the active one."""
        known = index is not None and 0 <= index < len(self._configurations)
        shown = self._configurations[self._active if index is None or not known else index]
        tags: dict[str, object] = {
            "runstat": f"{self.status:08X}",
            "prodname": _PRODUCT,
            "mfgdigver": _FIRMWARE,
            "setcfgsel": self._active,
            "setbias": _joined(self.bias_counts),
            "cfgnam": shown.name,
            "cfgcalsn": shown.calibration_serial,
            "cfgcpf": shown.counts_per_force,
            "cfgcpt": shown.counts_per_torque,
            "scfgfu": shown.force_unit,
            "scfgtu": shown.torque_unit,
            "cfgmr": _joined(shown.ranges),
            "cfgtfx": _joined(_UNBIASED),
            "comrdte": "Enabled" if self.enabled else "Disabled",
            # Rounded down: setting the rate that is shown then changes nothing.
            "comrdtrate": self._internal_hz // self._step,
            "comrdtbsiz": self.buffer_size,
        }
        lines = (f"<{name}>{escape(str(text))}</{name}>" for name, text in tags.items())
        return "\n".join(('<?xml version="1.0" encoding="UTF-8"?>', "<netft>", *lines, "</netft>", ""))

    def apply(self, path_and_query: str) -> bool:
        """Apply the setting in a request; return whether its page exists."""
        target = urlsplit(path_and_query)
        query = {name: values[-1] for name, values in parse_qs(target.query).items()}
        if target.path == "/comm.cgi":
            self._set_communication(query)
        elif target.path == "/setting.cgi":
            stated = [_whole(query.get(f"setbias{axis}")) for axis in range(6)]
            counts = [count for count in stated if count is not None]
            if len(counts) == len(stated):
                self._set_bias(counts)
        return target.path in ("/comm.cgi", "/setting.cgi")

    def answer(self, command: bytes, now_s: float) -> bytes:
        """Return the answer to a command of 20 bytes over TCP: READFT, READCALINFO, else nothing."""
        if len(command) != COMMAND_BYTES or command[0] > _READ_CALIBRATION:
            return b""
        shown = self._configurations[self._active]
        counts_per_unit = np.repeat([shown.counts_per_force, shown.counts_per_torque], 3)
        divisors = np.ceil(counts_per_unit * shown.ranges / _INT16_MAX).astype(np.int64)
        if command[0] == _READ_CALIBRATION:
            units = _FORCE_CODES[shown.force_unit], _TORQUE_CODES[shown.torque_unit]
            per_unit = shown.counts_per_force, shown.counts_per_torque
            return _SCALES.pack(_HEADER, *units, *per_unit, *divisors.tolist())
        counts, status = self._current(now_s)
        values = np.clip(counts // divisors, -_INT16_MAX, _INT16_MAX)
        return encode_reading(LoadReading(status >> 16, tuple(values.tolist())))

    def restart(self, powered_s: float) -> None:
        """Lose power and start again at `powered_s`: no stream, ft_sequence from zero; settings are kept."""
        self._stream = None
        self._first_ft_sequence = 0
        self._powered_s = powered_s

    def _set_communication(self, query: Mapping[str, str]) -> None:
        rate_hz = _whole(query.get("comrdtrate"))
        if rate_hz is not None and 1 <= rate_hz <= self._internal_hz:
            self._step = self._step_of(rate_hz)
        buffer_size = _whole(query.get("comrdtbsiz"))
        if buffer_size is not None and 1 <= buffer_size <= LONGEST_BUFFER:
            self.buffer_size = buffer_size
        if query.get("comrdte") in ("0", "1"):
            self.enabled = query["comrdte"] == "1"
        if not self.enabled:
            self._stream = None

    def _step_of(self, rate_hz: float) -> int:
        """Return the internal samples a record: other rates become the next faster one that exists."""
        return int(self._internal_hz // rate_hz)

    def _records(self, stream: _Stream, count: int) -> bytes:
        """Take the stream's next samples and return their bytes."""
        steps = np.arange(count, dtype=np.int64)
        ticks = stream.next_tick + stream.step * steps
        records = np.empty(count, RECORD)
        records["rdt_sequence"] = stream.sequence + steps
        records["ft_sequence"] = self._first_ft_sequence + ticks
        records["counts"], records["status"] = self._sample(ticks)
        self._advance(stream, count)
        return encode_records(records)

    def _sample(self, ticks: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.uint32]]:
        time_s = self._powered_s + ticks / self._internal_hz
        counts, status = self.load_cell.read(time_s, self._plant(time_s))
        return counts, status | np.uint32(self.status)

    def _current(self, now_s: float) -> tuple[npt.NDArray[np.int32], int]:
        """Return counts (6,) and status from before the stream's next sample, since the plant cannot go back."""
        tick = self._tick(now_s)
        if self._stream is not None:
            tick = min(tick, self._stream.next_tick - 1)
        counts, status = self._sample(np.array([tick]))
        return counts[0], int(status[0])

    def _advance(self, stream: _Stream, count: int) -> None:
        stream.next_tick += stream.step * count
        stream.sequence += count
        if stream.remaining is not None:
            stream.remaining -= count

    def _skip_stale(self, stream: _Stream, now_s: float) -> None:
        stale = (self._tick(now_s - LONGEST_STALL_S) - stream.next_tick) // stream.step
        stale -= stale % stream.block
        if stream.remaining is not None:
            stale = min(stale, stream.remaining - 1)
        if stale > 0:
            self._advance(stream, stale)
            self.skipped_records += stale

    def _tick(self, now_s: float) -> int:
        return int((now_s - self._powered_s) * self._internal_hz)

    def _bias(self, now_s: float) -> None:
        """Make the present reading zero, whatever the bias was before."""
        counts, _ = self._current(now_s)
        self._set_bias((self.load_cell.software_bias + counts).tolist())

    def _set_bias(self, counts: Sequence[int]) -> None:
        self.bias_counts = tuple(counts)
        self.load_cell.set_bias(counts)

    def _reset_latch(self) -> None:
        self.status &= ~_LATCHED_THRESHOLD
        if self.status == _ANY_ERROR:
            self.status = 0


def _whole(text: str | None) -> int | None:
    try:
        return None if text is None else int(text)
    except ValueError:
        return None


def _joined(values: Sequence[float]) -> str:
    return ";".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


class ServedBox(Protocol):
    """A box on its ports, perhaps with faults; without power it answers nothing."""

    @property
    def slow_s(self) -> float:
        """How late it answers over HTTP and TCP."""

    @property
    def streaming(self) -> bool:
        """Whether `due` returns datagrams, now or later."""

    def alive(self, now_s: float) -> bool:
        """Return whether the box has power."""

    def request(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take an RDT request."""

    def due(self, now_s: float) -> list[Datagram]:
        """Return the datagrams that leave now."""

    def page(self, index: int | None = None) -> str:
        """Return netftapi2.xml."""

    def apply(self, path_and_query: str) -> bool:
        """Apply a setting; return whether its page exists."""

    def answer(self, command: bytes, now_s: float) -> bytes:
        """Return the answer to a command over TCP."""


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
        box: ServedBox,
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
        for port, kind in ((self._requested.http, _Pages), (self._requested.tcp, _Readings)):
            factory = Factory.forProtocol(partial(kind, self._box, self._reactor))
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


class _Conversation(Stream, ABC):
    """Questions and their answers, delayed when the box is slow; none from a box without power."""

    transport: Connection  # type: ignore[assignment]  # twisted declares only what every transport has

    def __init__(self, box: ServedBox, reactor: PosixReactorBase) -> None:
        self._box = box
        self._reactor = reactor
        self._received = b""

    def connectionMade(self) -> None:  # noqa: N802 (twisted's name)
        if not self._box.alive(self._reactor.seconds()):
            self.transport.abortConnection()

    def dataReceived(self, data: bytes) -> None:  # noqa: N802 (twisted's name)
        self._received += data
        self._reactor.callLater(self._box.slow_s, self._answer)

    def _answer(self) -> None:
        if not self.connected:
            return
        if self._box.alive(self._reactor.seconds()):
            self._converse()
        else:
            self.transport.abortConnection()

    @abstractmethod
    def _converse(self) -> None:
        """Answer what was received."""


class _Pages(_Conversation):
    """One GET a connection, as in HTTP 1.0."""

    def _converse(self) -> None:
        if _BLANK_LINE in self._received:
            fields = self._received.split(b"\r\n", 1)[0].decode("latin-1").split()
            body = page_of(self._box, fields[1]) if len(fields) == 3 and fields[0] == "GET" else None
            status = "404 Not Found" if body is None else "200 OK"
            content = (body or "").encode()
            kind = "text/xml" if body and body.startswith("<?xml") else "text/html"
            head = f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(content)}\r\n\r\n"
            self.transport.write(head.encode() + content)
        elif len(self._received) <= _LONGEST_HTTP_REQUEST:
            return
        self.transport.loseConnection()


class _Readings(_Conversation):
    """Commands of COMMAND_BYTES over TCP."""

    def _converse(self) -> None:
        while len(self._received) >= COMMAND_BYTES:
            command, self._received = self._received[:COMMAND_BYTES], self._received[COMMAND_BYTES:]
            self.transport.write(self._box.answer(command, self._reactor.seconds()))


def page_of(box: ServedBox, path_and_query: str) -> str | None:
    """Return the page at a path, None where the box has none; settings in its query are applied."""
    target = urlsplit(path_and_query)
    if target.path == CONFIGURATION_PATH:
        index = parse_qs(target.query).get("index", [""])[-1]
        return box.page(int(index) if index.isdecimal() else None)
    return "<html>done</html>" if box.apply(path_and_query) else None
