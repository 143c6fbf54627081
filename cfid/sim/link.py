"""Simulates the link to the vehicle: a radio's losses and delays, and the faults of the link and of the vehicle."""

import math
from bisect import insort
from collections import deque
from operator import itemgetter
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from cfid.records.rig_file import Number, Positive, RigTable, Spread
from cfid.sim.crazyflie import PROTOCOL, Crazyflie, Leaving
from cfid.sim.faults import SOUND_CRAZYFLIE, CrazyflieFaults, Faulty
from cfid.sim.netft import Address, Datagram
from cfid.sim.propulsion import Four, Propulsion
from cfid.sim.supervisor import GENERIC_SETPOINT_PORT, SETPOINT_PORT
from cfid.sim.wander import Wander
from cfid.wire.app import AppState, Flags, PingChannel, encode_state
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, PARAMETER_PORT, WRITE_CHANNEL, Packet, decode_packet

FLOOR_WANDER_S = 60.0
CONGESTED_S, CLEAR_S = 2.0, 8.0

MOST_WAITING = 16

_CYCLES = 20  # before the first packet, so that it may meet a congestion
_REMEMBERED = 100_000  # pings

_NUMBER_BYTES = 4
_HELLO = b"cfid"  # in the app's answer to a hello, before its version
_LOW_V = 2.9
_ACTIVE_S = 1.0  # since its last packet, a client counts as active
_ROUNDING_S = 1e-9

SentPing = tuple[Packet, float]  # and when the client sent it
InFlight = tuple[float, bytes, SentPing | None]  # when a packet arrives, its bytes, the ping that it carries or answers


class RadioTruth(RigTable):
    """One packet in one direction takes `latency_s` on average.

    The shortest time is `jitter_s` less; the rest is exponential, with `jitter_s` as mean and standard deviation. The
    fraction `loss` of all packets is lost.

    With `jitter_shape` the rest is a gamma distribution of that shape: at 1 the exponential; above 1 a delay has no
    sharp lower edge. The shortest time wanders with the standard deviation `floor_wander_s`, correlated over
    FLOOR_WANDER_S. In times of congestion, CONGESTED_S long and CLEAR_S apart on average, a packet takes longer by an
    exponential time of mean `congestion_s`. Each direction passes `packets_per_s` at most, where that is not zero:
    a packet waits behind MOST_WAITING others, or is lost.
    """

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


class VehicleLink(Faulty[CrazyflieFaults]):
    """The vehicle behind its radio, with the faults of both.

    Answers go to the client that last sent anything but a setpoint.
    """

    def __init__(
        self,
        vehicle: Crazyflie,
        propulsion: Propulsion,
        radio: Radio,
        faults: CrazyflieFaults,
        *,
        ping_port: int,
        opened_s: float,
    ) -> None:
        """Start with nothing in the air."""
        super().__init__(faults, opened_s=opened_s)
        self.vehicle = vehicle
        self.radio = radio
        self._propulsion = propulsion
        self._ping_port = ping_port
        self._client: Address | None = None
        self._up: deque[InFlight] = deque()
        self._down: deque[InFlight] = deque()
        self._looked_s = self._received_s = opened_s
        self._sent = 0
        self._tumbled = False

    @property
    def motors(self) -> Four:
        """The commands that motors 1 to 4 obey."""
        return self.vehicle.motors

    def next_s(self, now_s: float) -> float | None:
        """Return when the next event is due, None while there is none."""
        times = [self.vehicle.next_s, *(queue[0][0] for queue in (self._up, self._down) if queue)]
        if self.faults is not SOUND_CRAZYFLIE:
            times += self.turns(now_s, math.inf)
        return min((time_s for time_s in times if time_s is not None), default=None)

    def closed(self, now_s: float) -> bool:
        """Return whether the port is closed."""
        return self.present("closed", now_s)

    def received(self, datagram: bytes, client: Address, now_s: float) -> None:
        """Take a client's datagram, unless another client is active on a busy link."""
        other = self._client is not None and client != self._client
        if self.faults.busy and other and now_s - self._received_s < _ACTIVE_S:
            return
        packet = decode_packet(datagram)
        if packet is None or packet.port not in (SETPOINT_PORT, GENERIC_SETPOINT_PORT):
            self._client, self._received_s = client, now_s
        arrives_s = None if self.present("silent", now_s) else self.radio.to_vehicle.arrival_s(now_s)
        if arrives_s is not None:
            pings = ((self._ping_port, PingChannel.PING), (ECHO_PORT, ECHO_CHANNEL))
            ping = (packet, now_s) if packet is not None and packet[:2] in pings else None
            self._up.append((arrives_s, datagram, ping))

    def due(self, now_s: float) -> list[Datagram]:
        """Advance up to now and return the datagrams that leave the radio by then."""
        return [(datagram, client) for datagram, client, _ in self.arrivals(now_s)]

    def arrivals(self, now_s: float) -> list[tuple[bytes, Address, float]]:
        """Return the same datagrams, each with its client and the time at which it leaves the radio."""
        self.advance(now_s)
        leaving: list[tuple[bytes, Address, float]] = []
        while self._down and self._down[0][0] <= now_s:
            arrives_s, packet, ping = self._down.popleft()
            if ping is not None:
                request, received_s = ping
                self.radio.pings.append(Ping(request.port, request.payload, arrives_s - received_s))
            if self._client is not None:
                leaving.append((packet, self._client, arrives_s))
        return leaving

    def advance(self, now_s: float) -> None:
        """Process every event up to now at its own time; times must not decrease."""
        while self._up and self._up[0][0] <= now_s:
            arrives_s, packet, ping = self._up.popleft()
            self._advance_vehicle(arrives_s)
            self._deliver(packet, ping, arrives_s)
        self._advance_vehicle(now_s)

    def _deliver(self, datagram: bytes, ping: SentPing | None, at_s: float) -> None:
        """Pass a packet to the vehicle and its answers to the radio."""
        faults = self.faults
        if not self._is_stop(datagram):
            self._send(self.vehicle.receive(datagram, at_s), ping)
            return
        answers = self._ignored(datagram, at_s) if faults.stop_ignored else self.vehicle.receive(datagram, at_s)
        if faults.stop_misnumbered:
            answers = [(time_s, _misnumbered(answer)) for time_s, answer in answers]
        self._send(answers, late_s=faults.stop_late_s)

    def _advance_vehicle(self, now_s: float) -> None:
        if self.faults is SOUND_CRAZYFLIE and self._looked_s > self._opened_s:
            self._send(self.vehicle.advance(now_s))
            return
        for turn_s in (*self.turns(self._looked_s, now_s), now_s):
            self._send(self.vehicle.advance(turn_s))
            self._apply_faults(turn_s)
        self._looked_s = now_s

    def _send(self, leaving: list[Leaving], ping: SentPing | None = None, *, late_s: float = 0.0) -> None:
        """Pass the vehicle's packets to the radio, which they reach `late_s` too late."""
        version = self.faults.app_protocol
        for time_s, packet in leaving:
            self._sent += 1
            if self.present("silent", time_s) or self.strikes("drop_every", self._sent):
                continue
            arrives_s = self.radio.from_vehicle.arrival_s(time_s)
            if arrives_s is None:
                continue
            falsified = version and packet[1:5] == _HELLO
            sent = packet[:5] + bytes([version]) + packet[6:] if falsified else packet
            insort(self._down, (arrives_s + late_s, sent, ping), key=itemgetter(0))

    def _apply_faults(self, now_s: float) -> None:
        at_s = now_s + _ROUNDING_S  # so that rounding does not put a fault after its own time
        faults, vehicle = self.faults, self.vehicle
        if self.begins("reboot", at_s):
            vehicle.restart(now_s)
        vehicle.protocol = faults.protocol or PROTOCOL
        tumbled = self.present("tumble", at_s)
        if tumbled != self._tumbled:
            self._tumbled = tumbled
            vehicle.turn(math.cos(math.radians(faults.tumble_deg)) if tumbled else 1.0)
        if self.begins("emergency", at_s):
            vehicle.supervisor.stopped = True
        self._propulsion.battery.at_most_v = _LOW_V if self.present("low_battery", at_s) else math.inf

    def _is_stop(self, datagram: bytes) -> bool:
        """Return whether a datagram is the app's stop, or zero for motorPowerSet.enable."""
        packet = decode_packet(datagram)
        if packet is None:
            return False
        zero = self.vehicle.parameter_number("motorPowerSet.enable").to_bytes(2, "little") + b"\0"
        return packet[:2] == (self._ping_port, PingChannel.STOP) or packet == (PARAMETER_PORT, WRITE_CHANNEL, zero)

    def _ignored(self, datagram: bytes, at_s: float) -> list[Leaving]:
        """Return the answer of a vehicle that ignores a stop: the value as if set, or the commands still in force."""
        header, payload = datagram[0], datagram[1:]
        if header >> 4 == PARAMETER_PORT:
            return [(at_s, datagram)]
        number = int.from_bytes(payload[:_NUMBER_BYTES], "little")
        flags = Flags.MOTORS_ALLOWED | Flags.KEEP_ALIVE_FRESH
        state = AppState(number, flags, self.vehicle.motors, int(at_s * 1e6) % (1 << 32))
        return [(at_s, bytes([header]) + encode_state(state))]


def _misnumbered(answer: bytes) -> bytes:
    """Return an answer renumbered to the next request, or the next parameter."""
    header, number, rest = answer[:1], answer[1 : 1 + _NUMBER_BYTES], answer[1 + _NUMBER_BYTES :]
    following = (int.from_bytes(number, "little") + 1) % (1 << 8 * len(number))
    return header + following.to_bytes(len(number), "little") + rest
