"""Procedures with a simulated vehicle inside one process, on a clock that the test advances."""

import math
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from twisted.internet.defer import Deferred
from twisted.internet.task import Clock
from twisted.python.failure import Failure

from cfid.errors import DeviceError
from cfid.records.run import DeviceRecord, Label, Run, read_run
from cfid.records.run_writer import create_run
from cfid.rig.app_motors import AppMotors
from cfid.rig.clock import HostClock
from cfid.rig.crazyflie_log import CrazyflieLog
from cfid.rig.crossings import Crossings
from cfid.rig.log_block import BATTERY
from cfid.rig.loop import Ending, until_over
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.motors import Firmware, Limits
from cfid.rig.pings import Pings
from cfid.rig.recorder import Instrument, Recorder
from cfid.rig.stock_motors import StockMotors
from cfid.rig.supervisor import Supervisor, SupervisorLog
from cfid.rig.vehicle import Vehicle
from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import PROTOCOL, Crazyflie, CrazyflieTruth, variables
from cfid.sim.crazyflie_services import parameters
from cfid.sim.faults import CrazyflieFaults, FaultyCrazyflie
from cfid.sim.link import Radio, RadioTruth
from cfid.sim.propulsion import BRUSHLESS, BatteryTruth, Four, Propulsion, RotorTruth
from cfid.wire.app import AppPorts, Hello
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, Packet, Variable, decode_packet, encode_packet

UNIX_S = 1_763_712_345.0
STEP_S = 0.002
LONGEST_S = 600.0
CLIENT = ("192.0.2.10", 50000)

Doing = Callable[["Flight"], Coroutine[Any, Any, None]]


class Turned(Clock):
    """Twisted's clock for tests, in which calls from other threads run in the same thread."""

    def pause(self, seconds: float) -> None:
        """Let time pass without running the loop, as if the process were suspended."""
        self.rightNow += seconds

    def callFromThread(self, function: Callable[..., Any], *args: Any) -> None:  # noqa: N802 - Twisted's name
        self.callLater(0, function, *args)


@dataclass
class Left:
    """A packet that left at once."""

    at_s: float | None


class SimulatedLink:
    """The link to a simulated vehicle, without cflib; it pings ten times a second, as cflib does."""

    uri = "sim://vehicle"

    def __init__(self, radio: FaultyCrazyflie, truth: CrazyflieTruth, clock: Clock, *, protocol: int) -> None:
        self.fault, self.firmware_protocol = "", protocol
        self.received_s = clock.seconds()
        self.sent: list[Packet] = []
        self.loses: set[tuple[int, int]] = set()  # ports and channels whose packets from the vehicle never arrive
        self._radio, self._clock, self._truth = radio, clock, truth
        self._came: list[tuple[Packet, float]] = []
        self._wake: Callable[[], None] = lambda: None
        self._ping()

    def send(self, packet: Packet) -> Left:
        if self.fault:
            raise DeviceError(self.fault)
        self.sent.append(packet)
        self._radio.received(encode_packet(packet), CLIENT, self._clock.seconds())
        return Left(self._clock.seconds())

    def attach(self, wake: Callable[[], None]) -> None:
        self._wake = wake

    def arrived(self) -> list[tuple[Packet, float]]:
        came, self._came = self._came, []
        return came

    def variable(self, name: str) -> Variable | None:
        table = variables(self._radio.vehicle, rpm_deck=self._truth.rpm_deck, brushless=self._truth.brushless)
        return _entry(table, name)

    def parameter(self, name: str) -> Variable | None:
        return _entry(parameters(rpm_deck=self._truth.rpm_deck), name)

    def step(self) -> None:
        """Advance the vehicle to the present time, and collect the packets that it sent."""
        now_s = self._clock.seconds()
        if self._radio.closed(now_s):
            self.fault = f"{self.uri}: the link was closed."
        for datagram, _ in self._radio.due(now_s):
            packet = decode_packet(datagram)
            assert packet is not None
            self.received_s = now_s
            if packet[:2] not in self.loses:
                self._came.append((packet, now_s))
        if self._came:
            self._wake()

    def _ping(self) -> None:
        self._clock.callLater(0.1, self._ping)
        if not self.fault:
            self._radio.received(encode_packet(Packet(ECHO_PORT, ECHO_CHANNEL, b"\x00")), CLIENT, self._clock.seconds())


class Flight:
    """A vehicle fastened to a bench, with the history of its motors, its devices and its messages."""

    def __init__(
        self,
        runs_folder: Path,
        *,
        firmware: str = "app",
        faults: CrazyflieFaults | None = None,
        radio: RadioTruth | None = None,
        battery: BatteryTruth | None = None,
        limits: Limits | None = None,
        time_constant_s: float | None = None,
        protocol: int = PROTOCOL,
        stop_below_v: float | None = None,
        **truth: Any,
    ) -> None:
        self.clock = clock = Turned()
        clock.advance(1.0)
        self.motors: list[tuple[float, Four]] = [(-math.inf, (0, 0, 0, 0))]
        self.truth = CrazyflieTruth.model_validate({"firmware": firmware, **truth})
        usual = BRUSHLESS if self.truth.brushless else {}
        lag = {} if time_constant_s is None else {"time_constant_s": time_constant_s}
        propulsion = Propulsion(
            RotorTruth.model_validate(usual | lag),
            battery or BatteryTruth(),
            rng=np.random.default_rng(3),
            begin_s=clock.seconds(),
        )
        vehicle = Crazyflie(
            self.truth,
            propulsion,
            load_app=load_core,
            opened_s=clock.seconds(),
            on_motors=lambda time_s, motors: self.motors.append((time_s, motors)),
        )
        self.sim = FaultyCrazyflie(
            vehicle,
            propulsion,
            Radio(radio or RadioTruth(latency_s=0.004, jitter_s=0.001), np.random.default_rng(4)),
            faults or CrazyflieFaults(),
            ping_port=AppPorts().ping,
            opened_s=clock.seconds(),
        )
        self.link = SimulatedLink(self.sim, self.truth, clock, protocol=protocol)
        self.vehicle = Vehicle(self.link, loop=clock)
        hello = Hello(2, 500, 500, 0) if firmware == "app" else None
        self.firmware = Firmware(kind=firmware, ports=AppPorts(), hello=hello)  # type: ignore[arg-type]
        self.supervisor = Supervisor(self.vehicle)
        self.limits = limits or Limits(idle_thrust=7000 if self.truth.brushless and firmware == "app" else 0)
        self.host = HostClock(UNIX_S)
        self.ending = Ending(clock)
        self.said: list[str] = []
        self._stop_below_v = stop_below_v
        self._runs_folder = runs_folder

    def its_motors(self) -> Any:
        if self.firmware.kind == "stock":
            return StockMotors(self.vehicle, self.limits)
        return AppMotors(self.vehicle, self.firmware, self.limits, self.supervisor)

    def commands(self) -> MotorCommands:
        return MotorCommands(self.its_motors(), loop=self.clock, clock=self.host)

    def crossings(self) -> Crossings:
        return Crossings(self.its_motors(), self.vehicle, self.firmware, loop=self.clock, clock=self.host)

    def states(self) -> SupervisorLog:
        return SupervisorLog(self.supervisor, self.vehicle, loop=self.clock, clock=self.host)

    def pings(self) -> Pings:
        return Pings(self.vehicle, self.firmware, loop=self.clock, clock=self.host)

    def log(self, *names: str, period_ms: int = 10) -> CrazyflieLog:
        return CrazyflieLog(
            self.vehicle,
            names or (BATTERY, "motor.m1"),
            period_ms=period_ms,
            stop_below_v=self._stop_below_v,
            loop=self.clock,
            clock=self.host,
        )

    def record(
        self, instruments: Sequence[Instrument], doing: Callable[[Mapping[str, Any]], Coroutine[Any, Any, None]]
    ) -> tuple[Run, Exception | None]:
        """Record until a procedure is done; return the run and the exception that was raised, or None."""
        devices = {i.name: DeviceRecord(file=f"{i.name}.csv", columns=i.columns) for i in instruments}
        run = create_run(
            self._runs_folder,
            kind="test",
            label=Label(),
            devices=devices,
            started=datetime(2026, 11, 21, tzinfo=UTC),
            cfid_version="0",
        )
        recorder = Recorder(instruments, run, loop=self.clock, show=lambda: None)
        by_name = {instrument.name: instrument for instrument in instruments}
        done: list[object] = []
        recording = recorder.record(lambda: until_over(self.ending, Deferred.fromCoroutine(doing(by_name))))
        Deferred.fromCoroutine(recording).addBoth(done.append)
        self.turn(until=lambda: bool(done))
        failure = done[0].value if isinstance(done[0], Failure) else None
        assert failure is None or isinstance(failure, Exception)
        run.close("failed" if failure else "complete", reason=str(failure or ""))
        return read_run(run.folder), failure

    def turn(self, *, until: Callable[[], bool] = lambda: False, for_s: float = LONGEST_S) -> None:
        """Advance the clock until a condition holds, or for `for_s` seconds."""
        end_s = self.clock.seconds() + for_s
        while self.clock.seconds() < end_s:
            self.link.step()
            self.clock.advance(STEP_S)
            if until():
                return
        assert for_s < LONGEST_S, "it never ended"

    def stopped_after(self, fault_s: float) -> float:
        """Return how many seconds after `fault_s` the last motor stopped; all motors must be off by now."""
        assert not any(self.motors[-1][1]), "motors are still on"
        return self.motors[-1][0] - fault_s


def _entry(table: Any, name: str) -> Variable | None:
    for number, entry in enumerate(table):
        if entry.name == name:
            return Variable(number, entry.kind)
    return None
