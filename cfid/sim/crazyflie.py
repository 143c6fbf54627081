"""A whole Crazyflie without a transport: packets in, and packets out with the times at which they leave."""

from collections.abc import Callable, Iterator
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from cfid.campaign import Number, Spread
from cfid.sim.crazyflie_log import Log
from cfid.sim.crazyflie_modules import PING, SINE, THRUST, App, ModulesOf2015, NoModules
from cfid.sim.crazyflie_params import Parameters
from cfid.sim.crazyflie_supervisor import Supervisor
from cfid.sim.crazyflie_tables import parameters, variables
from cfid.sim.motor_power_set import overriding
from cfid.sim.propulsion import STILL, Four, OnMotors, Propulsion
from cfid.sim.stepping import Array
from cfid.wire.app import PingChannel, Ports, encode_ping_answer
from cfid.wire.crtp import (
    BY_NAME_CHANNEL,
    ECHO_CHANNEL,
    ECHO_PORT,
    LOG_DATA_CHANNEL,
    LOG_PORT,
    LONGEST_PAYLOAD,
    PARAMETER_PORT,
    WRITE_CHANNEL,
    Packet,
    decode_packet,
)

USUAL_PORTS = Ports()
PROTOCOL = 12  # of CRTP, release 2026.08
BOOT_S = 1.0

_MEMORY_PORT, _SUPERVISOR_PORT, _PLATFORM_PORT = 4, 9, 13
_INFO_CHANNEL, _VERSION_CHANNEL, _SOURCE_CHANNEL, _NULL_CHANNEL = 0, 1, 1, 3
# Answers that the firmware makes anew lack the link's bits in the header; others are the request itself, filled in.
_MADE_ANEW = {(PARAMETER_PORT, 0), (LOG_PORT, 0), (_MEMORY_PORT, _INFO_CHANNEL)} | {
    (_SUPERVISOR_PORT, channel) for channel in range(4)
}
_LONGEST_ECHO = LONGEST_PAYLOAD - 8  # the microseconds come behind it
_TICKS_PER_S = 1000
_ATTENTIVE_TICKS = 2000  # without a motor or a request, before it goes to rest: longer than anything still to come
_DEAF_S = 3.0  # without a packet; the vehicle then takes its client for gone and logs no more
_SLACK = 1e-6  # of a tick, for times that were counted from ticks and back


class CrazyflieTruth(BaseModel):
    """`app` has cfid's app, `stock` nothing besides the firmware, `old` the thesis' modules of 2015.

    A `brushless` vehicle tells the speed of its motors and has to be armed; an `rpm_deck` tells it too. It was
    switched on `powered_for_s` before the rig opened; of its microseconds there are 1 + `clock_skew` in one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    firmware: Literal["app", "stock", "old"] = "app"
    rpm_deck: bool = False
    brushless: bool = False
    clock_skew: Annotated[Number, Field(gt=-1)] = 0.0
    powered_for_s: Spread = 100.0


class Leaving(NamedTuple):
    """A packet, and when it leaves the vehicle."""

    time_s: float
    packet: bytes


class Crazyflie:
    """The vehicle; `load_app` makes the core of its app anew at each start, `on_motors` hears of each change."""

    def __init__(
        self,
        truth: CrazyflieTruth,
        propulsion: Propulsion,
        *,
        load_app: Callable[[], App],
        opened_s: float,
        ports: Ports = USUAL_PORTS,
        on_motors: OnMotors = lambda time_s, motors: None,
    ) -> None:
        """Start it as long before `opened_s` as its truth says."""
        self.protocol = PROTOCOL
        self._truth, self._propulsion, self._on_motors = truth, propulsion, on_motors
        self._load_app = {"app": load_app, "stock": NoModules, "old": ModulesOf2015}[truth.firmware]
        self._services = {ports.thrust: THRUST, ports.sine: SINE, ports.ping: PING}
        self._ports = ports
        self._motors, self._ticks = STILL, 0
        self._begin(opened_s - truth.powered_for_s)

    @property
    def motors(self) -> Four:
        """The commands that motors 1 to 4 obey."""
        return self._motors

    @property
    def volts(self) -> float:
        """What feeds them."""
        return self._propulsion.battery.volts

    @property
    def speed_rad_per_s(self) -> Array:
        """How fast the rotors turn (4,)."""
        return self._propulsion.speed_rad_per_s(self._time_s(self._ticks))

    @property
    def next_s(self) -> float | None:
        """When it does something by itself, None while it rests."""
        return self._time_s(self._ticks + 1) if self._awake else None

    def receive(self, datagram: bytes, now_s: float) -> list[Leaving]:
        """Hear a packet, whatever bytes it has, and return what leaves up to now, its answers last."""
        sent = self.advance(now_s)
        packet = decode_packet(datagram)
        if packet is None or now_s < self._ready_s:
            return sent
        self._heard_s = now_s
        return sent + [Leaving(now_s, answer) for answer in self._answers(packet, datagram[0], now_s)]

    def advance(self, now_s: float) -> list[Leaving]:
        """Go through all milliseconds up to now and return what leaves; times must not fall."""
        sent: list[Leaving] = []
        last = int((now_s - self._powered_s) * _TICKS_PER_S + _SLACK)
        while self._ticks < last:
            if not self._awake:
                self._ticks = last
                break
            self._ticks += 1
            sent += self._tick(self._time_s(self._ticks))
        self._propulsion.advance(now_s)
        return sent

    def restart(self, at_s: float) -> None:
        """Lose power for a moment: all that was set is forgotten, and for BOOT_S nothing is heard."""
        self._set(STILL, at_s)
        self._begin(at_s)
        self._ready_s = at_s + BOOT_S

    def _begin(self, powered_s: float) -> None:
        truth = self._truth
        self.supervisor = Supervisor(arms_itself=not truth.brushless)
        self._parameters = Parameters(parameters(rpm_deck=truth.rpm_deck))
        self._log = Log(variables(self, rpm_deck=truth.rpm_deck, brushless=truth.brushless))
        self._app = self._load_app()
        self._answering: dict[int, Callable[[int, bytes], bytes | None]] = {
            PARAMETER_PORT: self._answer_parameter,
            LOG_PORT: self._answer_log,
            _SUPERVISOR_PORT: self.supervisor.answer,
            _PLATFORM_PORT: self._answer_platform,
            _MEMORY_PORT: _answer_memory,
            ECHO_PORT: _answer_link,
        }
        self._powered_s = self._ready_s = self._heard_s = powered_s
        self._ticks = self._rests_from = 0

    @property
    def _awake(self) -> bool:
        return self._ticks < self._rests_from or self._log.streaming

    def _time_s(self, tick: int) -> float:
        return self._powered_s + tick / _TICKS_PER_S

    def _microseconds(self, now_s: float) -> int:
        return int((now_s - self._powered_s) * (1 + self._truth.clock_skew) * 1e6)

    def _tick(self, now_s: float) -> Iterator[Leaving]:
        now_us = self._microseconds(now_s)
        self._propulsion.advance(now_s)
        if self._parameters["stabilizer.stop"]:
            self.supervisor.stop_for_good()
        commands = self._app.tick(now_us=now_us, allowed=self.supervisor.allowed)
        self._set(overriding(self._parameters, volts=self.volts) or commands or STILL, now_s)
        if any(self._motors) or self._app.alive(now_us=now_us):
            self._stay_awake()
        for packet in self._app_packets():
            yield Leaving(now_s, packet)
        if self._log.streaming and now_s - self._heard_s > _DEAF_S:
            self._log.reset()
        for row in self._log.due(self._ticks):
            yield Leaving(now_s, _made_anew(LOG_PORT, LOG_DATA_CHANNEL, row))

    def _set(self, motors: Four, now_s: float) -> None:
        if motors != self._motors:
            self._motors = motors
            self.supervisor.flying = any(motors)
            self._propulsion.command(motors, now_s)
            self._on_motors(now_s, motors)

    def _stay_awake(self) -> None:
        self._rests_from = self._ticks + _ATTENTIVE_TICKS

    def _answers(self, packet: Packet, header: int, now_s: float) -> Iterator[bytes]:
        port, channel, payload = packet
        if port in self._services:
            yield from self._ask_app(packet, now_s)
        elif port in self._answering:
            answer = self._answering[port](channel, payload)
            if answer is not None:
                yield _made_anew(port, channel, answer) if packet[:2] in _MADE_ANEW else bytes([header]) + answer

    def _answer_parameter(self, channel: int, payload: bytes) -> bytes | None:
        if channel in (WRITE_CHANNEL, BY_NAME_CHANNEL):
            self._stay_awake()  # it may have to do with the motors
        return self._parameters.answer(channel, payload)

    def _answer_log(self, channel: int, payload: bytes) -> bytes | None:
        return self._log.answer(channel, payload, self._ticks)

    def _answer_platform(self, channel: int, payload: bytes) -> bytes | None:
        asked = payload[:1]
        device = b"Crazyflie 2.1 Brushless" if self._truth.brushless else b"Crazyflie 2.1"
        told = {b"\0": self.protocol.to_bytes(4, "little"), b"\1": b"2026.08", b"\2": device}
        return asked + told[asked] if channel == _VERSION_CHANNEL and asked in told else None

    def _ask_app(self, packet: Packet, now_s: float) -> Iterator[bytes]:
        port, channel, payload = packet
        now_us = self._microseconds(max(now_s, self._time_s(self._ticks)))  # never before its last tick
        service = self._services[port]
        if self._truth.firmware == "app" and (service, channel) == (PING, PingChannel.PING):
            yield _made_anew(port, channel, encode_ping_answer(payload[:_LONGEST_ECHO], now_us))
            return
        self._stay_awake()
        self._app.receive(service, channel, payload, now_us=now_us, allowed=self.supervisor.allowed)
        yield from self._app_packets()

    def _app_packets(self) -> Iterator[bytes]:
        for service, channel, payload in self._app.sent():
            yield _made_anew(self._ports[service], channel, payload)


def _answer_memory(channel: int, payload: bytes) -> bytes | None:
    """Return that there are no memories."""
    return b"\1\0" if (channel, payload[:1]) == (_INFO_CHANNEL, b"\1") else None


def _answer_link(channel: int, payload: bytes) -> bytes | None:
    """Return an echo, and so to the empty packet that looks for vehicles; or who this is."""
    if channel == _SOURCE_CHANNEL:
        return b"Bitcraze Crazyflie".ljust(LONGEST_PAYLOAD, b"\0")
    return payload if channel in (ECHO_CHANNEL, _NULL_CHANNEL) else None


def _made_anew(port: int, channel: int, payload: bytes) -> bytes:
    return bytes([port << 4 | channel]) + payload
