"""Simulates a whole Crazyflie without a transport: packets in, and packets out with the times at which they leave."""

import math
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from cfid.records.rig_file import Number, RigTable, Spread
from cfid.sim.app_core import PING, SINE, THRUST, App, Orders, Seen
from cfid.sim.crazyflie_services import (
    IDLE,
    MEMORY_PORT,
    PLATFORM_PORT,
    SUPERVISOR_PORT,
    AbsentMemoryError,
    Log,
    LoggedVariable,
    Parameters,
    answer_link,
    answer_memory,
    answer_platform,
    framed,
    new_packet,
    parameters,
)
from cfid.sim.imu import Imu, ImuSample
from cfid.sim.propulsion import STILL, Four, OnMotors, Propulsion
from cfid.sim.supervisor import (
    GENERIC_SETPOINT_PORT,
    SETPOINT_PORT,
    UPDATE_STEPS,
    Commander,
    Priority,
    SimulatedSupervisor,
)
from cfid.wire.app import LARGEST_COMMAND, AppPorts, PingChannel, encode_ping_answer
from cfid.wire.crtp import ECHO_PORT, LOG_DATA_CHANNEL, LOG_PORT, LONGEST_PAYLOAD, PARAMETER_PORT, Packet, decode_packet

Platform = Literal["cf2", "cf21bl"]

USUAL_PORTS = AppPorts()
Leaving = tuple[float, bytes]  # when a packet leaves the vehicle, and its bytes

PROTOCOL = 12  # of CRTP, release 2026.08
BOOT_S = 1.0

_LONGEST_ECHO = LONGEST_PAYLOAD - 8  # the microseconds follow it
_TICKS_PER_S = 1000
_FEED_TICKS = 20
_IDLE_OF_BRUSHLESS = 7000
_RPM_PER_RAD_PER_S = 60 / math.tau
_LARGEST_U16 = 65535
_EMPTY_V, _FULL_V = 3.0, 4.2
_ROOM_C = 24.0
_ATTENTIVE_TICKS = 2000  # without a running motor or a request, after which it sleeps: longer than any pending event
_CLIENT_GONE_S = 3.0  # without a packet; the vehicle then considers its client gone and stops logging
_SLACK = 1e-6  # of a tick, for rounding between times and ticks

_EACH, _FIRST_FOR_ALL, _FIRST_COMPENSATED = 1, 2, 3  # of motorPowerSet.enable
# The firmware's model of a Crazyflie 2.1's motors: thrust in N as a cubic in the motor's voltage.
_CUBIC_N = (0.005960923942142, -0.01847364358025878, 0.04724465241828281, -0.014830744918356092)
_LEAST_N, _MOST_N = 0.012817578393224994, 0.12
_LEAST_V = 2.0


def _current(firmware: object) -> object:
    if firmware in ("old", "thesis"):
        raise ValueError(
            "no firmware that cfid can reach has the modules of 2015: write app, whose ports and payloads are theirs, "
            "or stock"
        )
    return firmware


class CrazyflieTruth(RigTable):
    """Firmware `app` includes cfid's app, `stock` no addition.

    Platform `cf2` is a Crazyflie 2.x, `cf21bl` a Crazyflie 2.1 Brushless: its motors report their speeds, 0 below
    `stall_rpm`, have idle thrust, and run only while armed. An `rpm_deck` measures speeds too. The vehicle was switched
    on `powered_for_s` before the rig opened; its clock counts 1 + `clock_skew` microseconds in a true one.
    """

    firmware: Annotated[Literal["app", "stock"], BeforeValidator(_current)] = "app"
    platform: Platform = "cf2"
    rpm_deck: bool = False
    stall_rpm: Spread = 60.0
    clock_skew: Annotated[Number, Field(gt=-1)] = 0.0
    powered_for_s: Spread = 100.0

    @property
    def brushless(self) -> bool:
        """Whether the motors are brushless."""
        return self.platform == "cf21bl"


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
    def turning_rpm(self) -> list[float]:
        """How fast the rotors turn, which an RPM deck measures."""
        speeds = self._propulsion.speed_rad_per_s(self._time_s(self._ticks))
        return [float(speed) for speed in speeds * _RPM_PER_RAD_PER_S]

    @property
    def rotors_rpm(self) -> list[float]:
        """The speeds that the drivers of brushless motors report, empty without them."""
        if not self._truth.brushless:
            return []
        return [0.0 if speed < self._truth.stall_rpm else speed for speed in self.turning_rpm]

    @property
    def next_s(self) -> float | None:
        """When the vehicle next does something unprompted, None while it sleeps."""
        return self._time_s(self._ticks + 1) if self._awake else None

    def parameter_number(self, name: str) -> int:
        """Return a parameter's number on the link."""
        return list(self._parameters).index(name)

    def receive(self, datagram: bytes, now_s: float) -> list[Leaving]:
        """Take a packet of any bytes, and return the packets that leave up to now, its answers last."""
        sent = self.advance(now_s)
        packet = decode_packet(datagram)
        if packet is None or not self._on or now_s < self._ready_s:
            return sent
        self._received_s = now_s
        return sent + [(now_s, answer) for answer in self._answers(packet, datagram[0], now_s)]

    def advance(self, now_s: float) -> list[Leaving]:
        """Advance millisecond by millisecond up to now; return the packets that leave. Times must not decrease."""
        sent: list[Leaving] = []
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
        self._app = self._load_app()
        self._seen = Seen(needs_arming=truth.brushless)
        self._fed_ticks = 0
        self._idles_off = False
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

    def _tick(self, now_s: float) -> Iterator[Leaving]:
        now_us = self._microseconds(now_s)
        self._propulsion.advance(now_s)
        self._supervise()
        orders = self._app.tick(now_us=now_us, vehicle=self._look())
        self._carry_out(orders)
        self._set(_overriding(self._parameters, volts=self.volts) or self._driven(orders), now_s)
        if any(self._motors) or orders.feeds or self._app.alive(now_us=now_us):
            self._stay_awake()
        for packet in self._app_packets():
            yield now_s, packet
        if self._log.streaming and now_s - self._received_s > _CLIENT_GONE_S:
            self._log.reset()
        for row in self._log.due(self._ticks):
            yield now_s, new_packet(LOG_PORT, LOG_DATA_CHANNEL, row)

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

    def _look(self) -> Seen:
        """Return the vehicle's state as `firmware_patches/cfid_app/src/cfid_app.c` passes it to the app."""
        seen = self._seen
        seen.can_fly, seen.flying = self.supervisor.can_fly, self.supervisor.flying
        if self._truth.brushless and not self._idles_off:
            seen.idle = int(self._parameters[IDLE])
        return seen

    def _carry_out(self, orders: Orders) -> None:
        """Carry out the app's orders other than commands, as its connection to the firmware does."""
        if orders.feeds:
            if self._fed_ticks % _FEED_TICKS == 0:
                self.commander.set(Priority.CLIENT)
            self._fed_ticks += 1
        elif self._fed_ticks:
            self.commander.relax()
            self._fed_ticks = 0
        if not self._truth.brushless:
            return
        if orders.idles_off != self._idles_off:
            self._parameters[IDLE] = 0 if orders.idles_off else self._seen.idle
        self._idles_off = orders.idles_off
        if orders.disarms:
            self.supervisor.request_arming(False)

    def _driven(self, orders: Orders) -> Four:
        """Return the commands that the stabilizer drives."""
        if not self.supervisor.motors_may_run:
            return STILL
        one, two, three, four = orders.held or self._flown()
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
            return
        try:
            answer = self._answer(port, channel, payload)
        except AbsentMemoryError:
            self.power_off(now_s)  # the firmware stops on a failed assertion
            return
        if answer is not None:
            yield framed(answer, port=port, channel=channel, header=header)

    def _answer(self, port: int, channel: int, payload: bytes) -> bytes | None:
        """Return what the firmware itself answers, None for nothing."""
        if port == ECHO_PORT:
            return answer_link(channel, payload)
        if port == MEMORY_PORT:
            return answer_memory(channel, payload)
        self._stay_awake()  # any other request may concern the motors
        answer = None
        if port == PARAMETER_PORT:
            answer = self._parameters.answer(channel, payload)
        elif port == LOG_PORT:
            answer = self._log.answer(channel, payload, self._ticks)
        elif port == SUPERVISOR_PORT:
            answer = self.supervisor.answer(channel, payload, self._now_ms())
        elif port == PLATFORM_PORT:
            brushless = self._truth.brushless
            answer = answer_platform(channel, payload, self.supervisor, protocol=self.protocol, brushless=brushless)
        elif port in (SETPOINT_PORT, GENERIC_SETPOINT_PORT):
            self.commander.receive(port, channel, payload)
        return answer

    def _ask_app(self, packet: Packet, now_s: float) -> Iterator[bytes]:
        port, channel, payload = packet
        now_us = self._microseconds(max(now_s, self._time_s(self._ticks)))  # never before its last tick
        service = self._services[port]
        if self._truth.firmware == "app" and (service, channel) == (PING, PingChannel.PING):
            yield new_packet(port, channel, encode_ping_answer(payload[:_LONGEST_ECHO], now_us))
            return
        self._stay_awake()
        self._app.receive(service, channel, payload, now_us=now_us, vehicle=self._look())
        yield from self._app_packets()

    def _app_packets(self) -> Iterator[bytes]:
        for service, channel, payload in self._app.sent():
            yield new_packet(self._ports[service], channel, payload)


def variables(vehicle: Crazyflie, *, rpm_deck: bool, brushless: bool) -> list[LoggedVariable]:
    """Return a selection of the firmware's log variables, of a vehicle that is fastened or hangs in a swing."""
    supervisor = vehicle.supervisor
    table = [
        LoggedVariable("pm.vbat", "f", lambda: vehicle.volts),
        LoggedVariable("pm.vbatMV", "H", lambda: 1000 * vehicle.volts),
        LoggedVariable("pm.batteryLevel", "B", lambda: _level_percent(vehicle.volts)),
        LoggedVariable("pm.state", "b", lambda: 0),
        LoggedVariable("supervisor.info", "H", lambda: supervisor.bits),
        LoggedVariable("sys.canfly", "B", lambda: supervisor.can_fly),
        LoggedVariable("sys.isFlying", "B", lambda: supervisor.flying),
        LoggedVariable("sys.isTumbled", "B", lambda: supervisor.tumbled),
        *(LoggedVariable(f"stabilizer.{angle}", "f", lambda: 0.0) for angle in ("roll", "pitch", "yaw")),
        LoggedVariable("stabilizer.thrust", "f", lambda: max(vehicle.motors)),
        *_places("gyro.{}", "xyz", "f", lambda axis: vehicle.inertial.gyro_dps[axis]),
        *_places("acc.{}", "xyz", "f", lambda axis: vehicle.inertial.acc_g[axis]),
        LoggedVariable("baro.temp", "f", lambda: _ROOM_C),
        *_places("motor.m{}", "1234", "H", lambda motor: vehicle.motors[motor]),
        *_places("motor.m{}req", "1234", "i", lambda motor: vehicle.motors[motor]),
    ]
    if brushless:
        table += _places("motor.m{}_rpm", "1234", "H", lambda motor: min(vehicle.rotors_rpm[motor], _LARGEST_U16))
    if rpm_deck:
        table += _places("rpm.m{}", "1234", "H", lambda motor: min(vehicle.turning_rpm[motor], _LARGEST_U16))
    return table


def _places(name: str, places: str, kind: str, read: Callable[[int], float]) -> list[LoggedVariable]:
    return [LoggedVariable(name.format(place), kind, partial(read, i)) for i, place in enumerate(places)]


def _level_percent(volts: float) -> float:
    """Return the charge, estimated from the voltage in steps of ten."""
    return 10 * round(10 * min(max((volts - _EMPTY_V) / (_FULL_V - _EMPTY_V), 0.0), 1.0))


def _overriding(values: Parameters, *, volts: float) -> Four | None:
    """Return the commands of motorPowerSet, which override everything and do not expire, None while not enabled."""
    enabled = values["motorPowerSet.enable"]
    if not enabled:
        return None
    one, two, three, four = (int(values[f"motorPowerSet.m{motor}"]) for motor in (1, 2, 3, 4))
    if enabled == _EACH:
        return one, two, three, four
    if enabled == _FIRST_FOR_ALL:
        return one, one, one, one
    if enabled == _FIRST_COMPENSATED:
        command = compensated(one, volts=volts)
        return command, command, command, command
    return None


@lru_cache(maxsize=256)
def compensated(command: int, *, volts: float) -> int:
    """Return the command that gives, at this supply voltage, the fraction command/65535 of the largest thrust."""
    thrust_n = command / LARGEST_COMMAND * _MOST_N
    if volts < _LEAST_V or thrust_n < _LEAST_N:
        return 0
    roots = np.roots([*_CUBIC_N[:3], _CUBIC_N[3] - thrust_n])
    motor_v = float(roots[np.argmin(np.abs(roots.imag))].real)  # the cubic is increasing: exactly one root is real
    return min(int(LARGEST_COMMAND * motor_v / volts), LARGEST_COMMAND)
