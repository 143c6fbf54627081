"""Simulates a whole Crazyflie without a transport: packets in, and packets out with the times at which they leave."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from cfid.sim.crazyflie_commander import GENERIC_SETPOINT_PORT, SETPOINT_PORT, Commander
from cfid.sim.crazyflie_glue import IDLE, Glue
from cfid.sim.crazyflie_log import Log
from cfid.sim.crazyflie_memories import AbsentMemoryError, answer_memory
from cfid.sim.crazyflie_modules import PING, SINE, THRUST, App, Orders
from cfid.sim.crazyflie_packets import MEMORY_PORT, SUPERVISOR_PORT, answer_link, framed, new_packet
from cfid.sim.crazyflie_params import Parameters
from cfid.sim.crazyflie_platform import COMMAND_CHANNEL, VERSION_CHANNEL, answer_command, answer_version
from cfid.sim.crazyflie_supervisor import INFO_CHANNEL, UPDATE_STEPS, SimulatedSupervisor
from cfid.sim.crazyflie_tables import parameters, variables
from cfid.sim.crazyflie_truth import CrazyflieTruth
from cfid.sim.imu import Imu, ImuSample
from cfid.sim.motor_power_set import compensated, overriding
from cfid.sim.propulsion import STILL, Four, OnMotors, Propulsion
from cfid.sim.stepping import Array
from cfid.wire.app import AppPorts, PingChannel, encode_ping_answer
from cfid.wire.crtp import (
    BY_NAME_CHANNEL,
    ECHO_PORT,
    LOG_DATA_CHANNEL,
    LOG_PORT,
    LONGEST_PAYLOAD,
    PARAMETER_PORT,
    WRITE_CHANNEL,
    Packet,
    decode_packet,
)

USUAL_PORTS = AppPorts()
PROTOCOL = 12  # of CRTP, release 2026.08
BOOT_S = 1.0

_PLATFORM_PORT = 13
_LONGEST_ECHO = LONGEST_PAYLOAD - 8  # the microseconds follow it
_TICKS_PER_S = 1000
_IDLE_OF_BRUSHLESS = 7000
_RPM_PER_RAD_PER_S = 60 / math.tau
_ATTENTIVE_TICKS = 2000  # without a running motor or a request, after which it sleeps: longer than any pending event
_CLIENT_GONE_S = 3.0  # without a packet; the vehicle then considers its client gone and stops logging
_SLACK = 1e-6  # of a tick, for rounding between times and ticks


class LeavingPacket(NamedTuple):
    """A packet, and when it leaves the vehicle."""

    time_s: float
    packet: bytes


class Crazyflie:
    """The vehicle; `load_app` creates the core of its app at each start, `on_motors` is called at each change.

    The stabilizer's loop takes a step a millisecond, by its sensors' clock. `rtos_ms` returns how many milliseconds the
    operating system has counted at a step: the firmware's time limits use that count.
    """

    def __init__(
        self,
        truth: CrazyflieTruth,
        propulsion: Propulsion,
        *,
        load_app: Callable[[], App],
        opened_s: float,
        ports: AppPorts = USUAL_PORTS,
        on_motors: OnMotors = lambda time_s, motors: None,
        rtos_ms: Callable[[int], int] = lambda step: step,
        imu: Imu | None = None,
    ) -> None:
        """Start the vehicle before `opened_s`, by `powered_for_s` of its truth; without `imu` it is fastened."""
        self.protocol = PROTOCOL
        self._truth, self._propulsion, self._on_motors = truth, propulsion, on_motors
        self._load_app = {"app": load_app, "stock": App}[truth.firmware]
        self._services = {ports.thrust: THRUST, ports.sine: SINE, ports.ping: PING}
        self._ports, self._rtos_ms, self._imu = ports, rtos_ms, imu
        self._motors, self._ticks = STILL, 0
        self.acc_z_g = 1.0
        self._begin(opened_s - truth.powered_for_s)

    @property
    def motors(self) -> Four:
        """The commands that motors 1 to 4 obey."""
        return self._motors

    @property
    def volts(self) -> float:
        """The motors' supply voltage."""
        return self._propulsion.battery.volts

    @property
    def inertial(self) -> ImuSample:
        """What gyro and accelerometer show; to the supervisor, a vehicle that hangs in a swing stands upright."""
        if self._imu is not None:
            return self._imu.at(self._time_s(self._ticks))
        return ImuSample((0.0, 0.0, 0.0), (math.sqrt(max(0.0, 1 - self.acc_z_g**2)), 0.0, self.acc_z_g))

    @property
    def speed_rad_per_s(self) -> Array:
        """How fast the rotors turn (4,)."""
        return self._propulsion.speed_rad_per_s(self._time_s(self._ticks))

    @property
    def rotors_rpm(self) -> list[float]:
        """The speeds that the drivers of brushless motors report, empty without them."""
        if not self._truth.brushless:
            return []
        speeds = (self.speed_rad_per_s * _RPM_PER_RAD_PER_S).tolist()
        return [0.0 if speed < self._truth.stall_rpm else speed for speed in speeds]

    @property
    def next_s(self) -> float | None:
        """When the vehicle next does something unprompted, None while it sleeps."""
        return self._time_s(self._ticks + 1) if self._awake else None

    def parameter_number(self, name: str) -> int:
        """Return a parameter's number on the link."""
        return list(self._parameters).index(name)

    def receive(self, datagram: bytes, now_s: float) -> list[LeavingPacket]:
        """Take a packet of any bytes, and return the packets that leave up to now, its answers last."""
        sent = self.advance(now_s)
        packet = decode_packet(datagram)
        if packet is None or not self._on or now_s < self._ready_s:
            return sent
        self._received_s = now_s
        return sent + [LeavingPacket(now_s, answer) for answer in self._answers(packet, datagram[0], now_s)]

    def advance(self, now_s: float) -> list[LeavingPacket]:
        """Advance millisecond by millisecond up to now; return the packets that leave. Times must not decrease."""
        sent: list[LeavingPacket] = []
        last = int((now_s - self._powered_s) * _TICKS_PER_S + _SLACK)
        while self._on and self._ticks < last:
            if self._awake:
                self._ticks += 1
                sent += self._tick(self._time_s(self._ticks))
            else:
                self._sleep(last)
        self._propulsion.advance(now_s)
        return sent

    def turn(self, acc_z_g: float) -> None:
        """Turn the vehicle until its z accelerometer shows `acc_z_g`: 1 upright, 0 on its side, -1 upside down."""
        self.acc_z_g = acc_z_g
        self._stay_awake()

    def power_off(self, at_s: float) -> None:
        """Lose power: motors stop, and packets are ignored until a restart."""
        self._set(STILL, at_s)
        self._on = False

    def restart(self, at_s: float, *, boot_s: float = BOOT_S) -> None:
        """Restart after a moment without power: all settings are lost, and packets are ignored for `boot_s`."""
        self._set(STILL, at_s)
        self._begin(at_s)
        self._ready_s = at_s + boot_s

    def _begin(self, powered_s: float) -> None:
        truth = self._truth
        idle = _IDLE_OF_BRUSHLESS if truth.brushless else 0
        self._parameters = Parameters(parameters(rpm_deck=truth.rpm_deck, idle=idle))
        self.supervisor = SimulatedSupervisor(self._parameters, arms_itself=not truth.brushless)
        self._log = Log(variables(self, rpm_deck=truth.rpm_deck, brushless=truth.brushless))
        self.commander = Commander(self._now_ms)
        self._glue = Glue(
            self._load_app(),
            supervisor=self.supervisor,
            commander=self.commander,
            parameters=self._parameters,
            needs_arming=truth.brushless,
        )
        self._answering: dict[int, Callable[[int, bytes], bytes | None]] = {
            PARAMETER_PORT: self._answer_parameter,
            LOG_PORT: self._answer_log,
            SUPERVISOR_PORT: self._answer_supervisor,
            _PLATFORM_PORT: self._answer_platform,
            MEMORY_PORT: answer_memory,
            ECHO_PORT: answer_link,
        }
        self._on = True
        self._powered_s = self._ready_s = self._received_s = powered_s
        self._ticks = self._sleeps_from = 0

    @property
    def _awake(self) -> bool:
        return self._on and (self._ticks < self._sleeps_from or self._log.streaming)

    @property
    def _idle(self) -> int:
        """Idle thrust in force; brushed motors have none, whatever the parameter is."""
        return int(self._parameters[IDLE]) if self._truth.brushless else 0

    def _now_ms(self) -> int:
        return self._rtos_ms(self._ticks)

    def _time_s(self, tick: int) -> float:
        return self._powered_s + tick / _TICKS_PER_S

    def _microseconds(self, now_s: float) -> int:
        return int((now_s - self._powered_s) * (1 + self._truth.clock_skew) * 1e6)

    def _tick(self, now_s: float) -> Iterator[LeavingPacket]:
        now_us = self._microseconds(now_s)
        self._propulsion.advance(now_s)
        self._supervise()
        orders = self._glue.tick(now_us=now_us)
        self._set(overriding(self._parameters, volts=self.volts) or self._driven(orders), now_s)
        if any(self._motors) or orders.feeds or self._glue.app.alive(now_us=now_us):
            self._stay_awake()
        for packet in self._app_packets():
            yield LeavingPacket(now_s, packet)
        if self._log.streaming and now_s - self._received_s > _CLIENT_GONE_S:
            self._log.reset()
        for row in self._log.due(self._ticks):
            yield LeavingPacket(now_s, new_packet(LOG_PORT, LOG_DATA_CHANNEL, row))

    def _supervise(self) -> None:
        """Advance the commander and the supervisor by this millisecond."""
        self.commander.advance(self._ticks, can_fly=self.supervisor.can_fly)
        if self._ticks % UPDATE_STEPS == 0:
            self.supervisor.update(
                self._now_ms(),
                acc_z_g=self.acc_z_g,
                setpoint_ms=self.commander.setpoint_ms,
                motors=self._motors,
                idle=self._idle,
                rotors_rpm=self.rotors_rpm,
            )

    def _sleep(self, last: int) -> None:
        """Skip to the supervisor's next update that can change something, or to `last`: nothing else happens."""
        settled = self.supervisor.settled_until(self._now_ms(), acc_z_g=self.acc_z_g)
        calm = last if settled is None else min(max(settled, self._ticks), last)
        self._ticks = min((calm // UPDATE_STEPS + 1) * UPDATE_STEPS, last)
        self._supervise()

    def _driven(self, orders: Orders) -> Four:
        """Return the commands that the stabilizer drives."""
        if not self.supervisor.motors_may_run:
            return STILL
        one, two, three, four = orders.commands or self._flown()
        idle = self._idle
        return max(one, idle), max(two, idle), max(three, idle), max(four, idle)

    def _flown(self) -> Four:
        """Return what the stock controller makes of the setpoint in force; the app is built without compensation."""
        thrust = self.commander.thrust if self.supervisor.can_fly else 0
        if self._truth.firmware == "stock" and not self._truth.brushless:
            thrust = compensated(thrust, volts=self.volts)
        return thrust, thrust, thrust, thrust

    def _set(self, motors: Four, now_s: float) -> None:
        if motors != self._motors:
            self._motors = motors
            self._propulsion.command(motors, now_s)
            self._on_motors(now_s, motors)

    def _stay_awake(self) -> None:
        self._sleeps_from = self._ticks + _ATTENTIVE_TICKS

    def _answers(self, packet: Packet, header: int, now_s: float) -> Iterator[bytes]:
        port, channel, payload = packet
        if port in self._services:
            yield from self._ask_app(packet, now_s)
        elif port in (SETPOINT_PORT, GENERIC_SETPOINT_PORT):
            self.commander.receive(port, channel, payload)
            self._stay_awake()
        elif port in self._answering:
            try:
                answer = self._answering[port](channel, payload)
            except AbsentMemoryError:
                self.power_off(now_s)  # the firmware stops on a failed assertion
                return
            if answer is not None:
                yield framed(answer, port=port, channel=channel, header=header)

    def _answer_parameter(self, channel: int, payload: bytes) -> bytes | None:
        if channel in (WRITE_CHANNEL, BY_NAME_CHANNEL):
            self._stay_awake()  # it may concern the motors
        return self._parameters.answer(channel, payload)

    def _answer_log(self, channel: int, payload: bytes) -> bytes | None:
        return self._log.answer(channel, payload, self._ticks)

    def _answer_supervisor(self, channel: int, payload: bytes) -> bytes | None:
        if channel != INFO_CHANNEL:
            self._stay_awake()  # motors may spin up, or stop
        return self.supervisor.answer(channel, payload, self._now_ms())

    def _answer_platform(self, channel: int, payload: bytes) -> bytes | None:
        if channel == VERSION_CHANNEL:
            return answer_version(payload, protocol=self.protocol, brushless=self._truth.brushless)
        self._stay_awake()
        return answer_command(payload, self.supervisor) if channel == COMMAND_CHANNEL else None

    def _ask_app(self, packet: Packet, now_s: float) -> Iterator[bytes]:
        port, channel, payload = packet
        now_us = self._microseconds(max(now_s, self._time_s(self._ticks)))  # never before its last tick
        service = self._services[port]
        if self._truth.firmware == "app" and (service, channel) == (PING, PingChannel.PING):
            yield new_packet(port, channel, encode_ping_answer(payload[:_LONGEST_ECHO], now_us))
            return
        self._stay_awake()
        self._glue.receive(service, channel, payload, now_us=now_us)
        yield from self._app_packets()

    def _app_packets(self) -> Iterator[bytes]:
        for service, channel, payload in self._glue.app.sent():
            yield new_packet(self._ports[service], channel, payload)
