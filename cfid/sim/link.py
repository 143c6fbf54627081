"""Simulates the link to the vehicle: a radio's losses and delays, and the UDP port that cflib's `udp://` expects."""

import contextlib
import math
import socket
from bisect import insort
from collections import deque
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from twisted.internet.base import DelayedCall
from twisted.internet.defer import Deferred, succeed
from twisted.internet.posixbase import PosixReactorBase
from twisted.internet.protocol import DatagramProtocol
from twisted.internet.udp import Port

from cfid.records.rig_file import Number, Positive, Spread
from cfid.sim.crazyflie import Crazyflie, LeavingPacket
from cfid.sim.netft import LOOPBACK, Address, Datagram
from cfid.sim.propulsion import Four
from cfid.sim.supervisor import GENERIC_SETPOINT_PORT, SETPOINT_PORT
from cfid.sim.wander import Wander
from cfid.wire.app import PingChannel
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, Packet, decode_packet

FLOOR_WANDER_S = 60.0
CONGESTED_S, CLEAR_S = 2.0, 8.0

MOST_WAITING = 16

_CYCLES = 20  # before the first packet, so that it may meet a congestion
_REMEMBERED = 100_000  # pings

SentPing = tuple[Packet, float]  # and when the client sent it


class RadioTruth(BaseModel):
    """One packet in one direction takes `latency_s` on average.

    The shortest time is `jitter_s` less; the rest is exponential, with `jitter_s` as mean and standard deviation. The
    fraction `loss` of all packets is lost.

    With `jitter_shape` the rest is a gamma distribution of that shape: at 1 the exponential; above 1 a delay has no
    sharp lower edge. The shortest time wanders with the standard deviation `floor_wander_s`, correlated over
    FLOOR_WANDER_S. In times of congestion, CONGESTED_S long and CLEAR_S apart on average, a packet takes longer by an
    exponential time of mean `congestion_s`. Each direction passes `packets_per_s` at most, where that is not zero:
    a packet waits behind MOST_WAITING others, or is lost.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    latency_s: Spread = 4e-4
    jitter_s: Spread = 1e-4
    loss: Annotated[Number, Field(ge=0, le=1)] = 0.0
    jitter_shape: Positive = 1.0
    floor_wander_s: Spread = 0.0
    congestion_s: Spread = 0.0
    packets_per_s: Spread = 0.0

    @model_validator(mode="after")
    def _comes_after_it_was_sent(self) -> Self:
        if self.jitter_s > self.latency_s:
            raise ValueError("jitter_s cannot exceed latency_s: a packet would come before it was sent")
        return self

    @property
    def mean_s(self) -> float:
        """The long-term mean time of a packet."""
        return self.latency_s + self.congestion_s * CONGESTED_S / (CONGESTED_S + CLEAR_S)


class Ping(NamedTuple):
    """A ping that was answered: its port, its payload and its round-trip time."""

    port: int
    payload: bytes
    round_trip_s: float


class Direction:
    """Packets one way, which never overtake each other."""

    def __init__(self, truth: RadioTruth, rng: np.random.Generator) -> None:
        """Draw from `rng`."""
        self._truth = truth
        self._rng = rng
        self._last_s = 0.0
        self._free_s = -math.inf
        self.lost = 0
        self._disturbing = rng.spawn(1)[0] if truth.floor_wander_s or truth.congestion_s else rng
        self._wander: Wander | None = None
        if truth.floor_wander_s:
            self._wander = Wander(truth.floor_wander_s, correlation_s=FLOOR_WANDER_S, rng=self._disturbing)
        self._congested: tuple[float, float] | None = None

    def arrival_s(self, sent_s: float) -> float | None:
        """Return when a packet arrives, None if it is lost."""
        truth = self._truth
        fate = self._rng.random()
        late_s = self._rng.gamma(truth.jitter_shape, truth.jitter_s / truth.jitter_shape)  # of a lost packet, too
        if truth.packets_per_s:
            waited_s = max(self._free_s - sent_s, 0.0)
            if waited_s * truth.packets_per_s > MOST_WAITING:
                self.lost += 1
                return None
            sent_s += waited_s
            self._free_s = sent_s + 1 / truth.packets_per_s
        if fate < truth.loss:
            self.lost += 1
            return None
        floor_s = truth.latency_s - truth.jitter_s
        if self._wander is not None:
            floor_s = max(floor_s + float(self._wander.at(sent_s)[0, 0]), 0.0)
        self._last_s = max(self._last_s, sent_s + floor_s + late_s + self._congestion_s(sent_s))
        return self._last_s

    def _congestion_s(self, sent_s: float) -> float:
        if not self._truth.congestion_s:
            return 0.0
        begin_s, end_s = self._congested or (-math.inf, sent_s - _CYCLES * (CONGESTED_S + CLEAR_S))
        while end_s <= sent_s:
            begin_s = end_s + self._disturbing.exponential(CLEAR_S)
            end_s = begin_s + self._disturbing.exponential(CONGESTED_S)
        self._congested = begin_s, end_s
        return self._disturbing.exponential(self._truth.congestion_s) if begin_s <= sent_s else 0.0


class Radio:
    """Both directions, and the pings that were answered."""

    def __init__(self, truth: RadioTruth, rng: np.random.Generator) -> None:
        """Draw each direction from its own generator."""
        up, down = rng.spawn(2)
        self.to_vehicle = Direction(truth, up)
        self.from_vehicle = Direction(truth, down)
        self.pings: deque[Ping] = deque(maxlen=_REMEMBERED)


class _InFlight(NamedTuple):
    """A packet on its way, and the ping that it carries or answers."""

    arrives_s: float
    packet: bytes
    ping: SentPing | None


class VehicleLink:
    """The vehicle behind its radio. Answers go to the client that last sent anything but a setpoint."""

    def __init__(self, vehicle: Crazyflie, radio: Radio, *, ping_port: int) -> None:
        """Start with nothing in the air."""
        self.vehicle = vehicle
        self.radio = radio
        self._pings = ((ping_port, PingChannel.PING), (ECHO_PORT, ECHO_CHANNEL))
        self._client: Address | None = None
        self._up: deque[_InFlight] = deque()
        self._down: deque[_InFlight] = deque()

    @property
    def motors(self) -> Four:
        """The commands that motors 1 to 4 obey."""
        return self.vehicle.motors

    def next_s(self, now_s: float) -> float | None:
        """Return when the next event is due, None while there is none."""
        times = [self.vehicle.next_s, *(queue[0].arrives_s for queue in (self._up, self._down) if queue)]
        return min((time_s for time_s in times if time_s is not None), default=None)

    def closed(self, now_s: float) -> bool:
        """Return whether the port is closed."""
        return False

    def received(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take a client's datagram."""
        packet = decode_packet(datagram)
        if packet is None or packet.port not in (SETPOINT_PORT, GENERIC_SETPOINT_PORT):
            self._take_answers(client, now_s)
        arrives_s = self.radio.to_vehicle.arrival_s(now_s) if self._passes_to_vehicle(now_s) else None
        if arrives_s is not None:
            ping = (packet, now_s) if packet is not None and packet[:2] in self._pings else None
            self._up.append(_InFlight(arrives_s, datagram, ping))

    def due(self, now_s: float) -> list[Datagram]:
        """Advance up to now and return the datagrams that leave the radio by then."""
        return [(datagram, client) for datagram, client, _ in self.arrivals(now_s)]

    def arrivals(self, now_s: float) -> list[tuple[bytes, Address, float]]:
        """Return the same datagrams, each with its client and the time at which it leaves the radio."""
        self.advance(now_s)
        leaving: list[tuple[bytes, Address, float]] = []
        while self._down and self._down[0].arrives_s <= now_s:
            arrives_s, packet, ping = self._down.popleft()
            if ping is not None:
                request, received_s = ping
                self.radio.pings.append(Ping(request.port, request.payload, arrives_s - received_s))
            if self._client is not None:
                leaving.append((packet, self._client, arrives_s))
        return leaving

    def advance(self, now_s: float) -> None:
        """Process every event up to now at its own time; times must not decrease."""
        while self._up and self._up[0].arrives_s <= now_s:
            arrives_s, packet, ping = self._up.popleft()
            self._advance_vehicle(arrives_s)
            self._deliver(packet, ping, arrives_s)
        self._advance_vehicle(now_s)

    # What a fault of the link or the vehicle changes.

    def _take_answers(self, client: Address, now_s: float) -> None:
        self._client = client

    def _passes_to_vehicle(self, now_s: float) -> bool:
        return True

    def _deliver(self, datagram: bytes, ping: SentPing | None, at_s: float) -> None:
        """Pass a packet to the vehicle and its answers to the radio."""
        self._send(self.vehicle.receive(datagram, at_s), ping)

    def _advance_vehicle(self, now_s: float) -> None:
        self._send(self.vehicle.advance(now_s))

    def _send(self, leaving: list[LeavingPacket], ping: SentPing | None = None, *, late_s: float = 0.0) -> None:
        """Pass the vehicle's packets to the radio, which they reach `late_s` too late."""
        for time_s, packet in leaving:
            arrives_s = self.radio.from_vehicle.arrival_s(time_s)
            if arrives_s is not None:
                insort(self._down, _InFlight(arrives_s + late_s, packet, ping), key=lambda packet: packet.arrives_s)


class CrazyflieServer:
    """A vehicle on a port of one address; port 0 takes a free one. It sleeps until something is due."""

    def __init__(
        self, vehicle: VehicleLink, *, reactor: PosixReactorBase, address: str = LOOPBACK, port: int = 0
    ) -> None:
        """Open nothing yet."""
        self._vehicle = vehicle
        self._reactor = reactor
        self._address, self._requested_port = address, port
        self._port: Port | None = None
        self._socket: socket.socket | None = None
        self._timer: DelayedCall | None = None

    def open(self) -> str:
        """Bind the port and return its address in cflib's form. Raises twisted's CannotListenError."""
        self._port = self._reactor.listenUDP(self._requested_port, _Packets(self), self._address)
        self._socket = self._port.socket
        self._attend()
        return f"udp://{self._address}:{self._port.getHost().port}"

    def close(self) -> Deferred[None]:
        """Close the port and stop serving the vehicle; fires when it is done."""
        if self._timer is not None and self._timer.active():
            self._timer.cancel()
        return self._shut()

    def received(self, datagram: bytes, client: Address) -> None:
        """Take a datagram."""
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


class _Packets(DatagramProtocol):
    def __init__(self, server: CrazyflieServer) -> None:
        self._server = server

    def datagramReceived(self, datagram: bytes, addr: Address) -> None:  # noqa: N802 (twisted's name)
        self._server.received(datagram, addr)
