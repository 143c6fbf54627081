"""Finds, locks and connects a vehicle, and offers its instruments as devices of a run."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

from cfid.errors import DeviceError
from cfid.records.rig_file import CrazyflieLink
from cfid.records.run import DeviceRecord
from cfid.rig.app_motors import AppMotors
from cfid.rig.clock import HostClock
from cfid.rig.crazyflie_log import CrazyflieLog
from cfid.rig.crossings import Crossings
from cfid.rig.device import Device
from cfid.rig.link import Link
from cfid.rig.lock import DeviceLock
from cfid.rig.log_block import BATTERY
from cfid.rig.loop import Loop
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.motor_log import APPLIED, foreign_motion
from cfid.rig.motors import Firmware, Limits, firmware_of
from cfid.rig.pings import Pings
from cfid.rig.radio import find_vehicle
from cfid.rig.recorder import Instrument
from cfid.rig.shown import turning, volts
from cfid.rig.stock_motors import StockMotors
from cfid.rig.supervisor import Supervisor, SupervisorLog, present_state
from cfid.rig.tables import connect
from cfid.rig.vehicle import Vehicle, asked
from cfid.units import MOTORS
from cfid.wire.app import AppPorts
from cfid.wire.supervisor import VehicleState

DECK_SPEEDS = tuple(f"rpm.m{motor}" for motor in MOTORS)
MOTOR_SPEEDS = tuple(f"motor.m{motor}_rpm" for motor in MOTORS)
INERTIAL = tuple(f"{sensor}.{axis}" for sensor in ("gyro", "acc") for axis in "xyz")
IDLE_THRUST = "powerDist.idleThrust"
OBEYS_SINCE = 10  # version of the protocol; of its two releases, the app compiles only with the one that obeys
USUAL_MS = 10
_TRIES = 5
NO_APP = "a sine is played on board: this needs cfid's app on the vehicle (firmware_patches/README.md explains how)."


@dataclass
class ReadyVehicle:
    """A connected vehicle. Its instruments share one link, one supervisor and one set of motors."""

    link: Link
    firmware: Firmware
    setting: CrazyflieLink
    state: VehicleState | None = None  # as it was found; None where the firmware reports none
    idle_thrust: int = 0
    _vehicle: Vehicle | None = field(default=None, init=False)
    _supervisor: Supervisor | None = field(default=None, init=False)
    _motors: AppMotors | StockMotors | None = field(default=None, init=False)

    @property
    def limits(self) -> Limits:
        """The motors' limits by rig.toml and the rotors; the parameters of stock firmware ignore idle thrust."""
        idle_thrust = self.idle_thrust if self.firmware.kind == "app" else 0
        return Limits(largest_command=self.setting.largest_command, idle_thrust=idle_thrust)

    def refuse_unfit(self) -> None:
        """Raise DeviceError for a vehicle whose motors cannot or must not be started in its present state."""
        if self.state is not None and self.state.remedy:
            raise DeviceError(f"{self.uri}: the vehicle is {self.state.name}: {self.state.remedy}.")
        if self.firmware.kind == "app" and self.link.firmware_protocol < OBEYS_SINCE:
            raise DeviceError(
                f"{self.uri}: firmware before 2025.12 acknowledges the app's commands and turns no motor: update it."
            )
        if self.firmware.kind != "app" or self.state is None or self.state.arms_itself:
            return
        if not self.firmware.knows_owners:
            raise DeviceError(
                f"{self.uri}: the app on this vehicle is older than this cfid and leaves a vehicle that has to be "
                "armed without idle thrust when the link dies: flash the app that came with cfid "
                "(firmware_patches/README.md)."
            )
        if not self.idle_thrust:
            raise DeviceError(
                f"{self.uri}: {IDLE_THRUST} is 0, and this vehicle arms only while its rotors idle: turn it off and "
                "on, or set the parameter to 7000."
            )

    def refuse_driven(self) -> None:
        """Raise DeviceError for a vehicle whose motors something else drives."""
        cause = asked(self.link, lambda vehicle: foreign_motion(vehicle, idle_thrust=self.idle_thrust))
        if cause:
            raise DeviceError(f"{self.uri}: {cause}.")

    @property
    def uri(self) -> str:
        """The vehicle's address."""
        return self.link.uri

    @property
    def reports_battery(self) -> bool:
        """Whether the vehicle's log has the battery's voltage."""
        return self.link.variable(BATTERY) is not None

    def vehicle(self, loop: Loop) -> Vehicle:
        """Return the vehicle in a loop."""
        if self._vehicle is None or self._vehicle.loop is not loop:
            self._vehicle, self._supervisor, self._motors = Vehicle(self.link, loop=loop), None, None
        return self._vehicle

    def supervisor(self, loop: Loop) -> Supervisor:
        """Return its supervisor in a loop."""
        vehicle = self.vehicle(loop)
        if self._supervisor is None:
            self._supervisor = Supervisor(vehicle)
        return self._supervisor

    def motors(self, loop: Loop) -> AppMotors | StockMotors:
        """Return its motors in a loop, driven as its firmware allows."""
        vehicle, limits = self.vehicle(loop), self.limits
        if self._motors is None:
            if self.firmware.kind == "stock":
                self._motors = StockMotors(vehicle, limits)
            else:
                self._motors = AppMotors(vehicle, self.firmware, limits, self.supervisor(loop))
        return self._motors

    def commands(self) -> Device:
        """Return the motors as a device of a run."""

        def opened(loop: Loop, clock: HostClock) -> Instrument:
            return MotorCommands(self.motors(loop), loop=loop, clock=clock)

        return self._device("commands.csv", MotorCommands.columns, opened, eventful=True)

    def crossings(self) -> Device:
        """Return a sine's reports as a device of a run. Raises DeviceError for a vehicle that cannot play one."""
        if self.firmware.kind == "stock":
            raise DeviceError(f"{self.uri}: {NO_APP}")

        def opened(loop: Loop, clock: HostClock) -> Instrument:
            motors = self.motors(loop)
            assert isinstance(motors, AppMotors)
            return Crossings(motors, self.vehicle(loop), self.firmware, loop=loop, clock=clock)

        return self._device("crossings.csv", Crossings.columns, opened, eventful=True)

    def pings(self) -> Device:
        """Return round trips as a device of a run."""

        def opened(loop: Loop, clock: HostClock) -> Instrument:
            return Pings(self.vehicle(loop), self.firmware, loop=loop, clock=clock)

        return self._device("pings.csv", Pings.columns_of(self.firmware), opened)

    def supervisor_log(self) -> Device:
        """Return the supervisor's states as a device of a run."""

        def opened(loop: Loop, clock: HostClock) -> Instrument:
            return SupervisorLog(self.supervisor(loop), self.vehicle(loop), loop=loop, clock=clock)

        return self._device("supervisor.csv", SupervisorLog.columns, opened, eventful=True)

    def watch(self, period_ms: int = USUAL_MS) -> list[Device]:
        """Return what every experiment with motors records: the usual log and the supervisor's states."""
        return [self.usual_log(period_ms), self.supervisor_log()]

    def usual_log(self, period_ms: int = USUAL_MS) -> Device:
        """Return the log of every experiment: battery, motor commands, and speeds where the vehicle reports them."""
        speeds = [names for names in (DECK_SPEEDS, MOTOR_SPEEDS) if self.link.variable(names[0]) is not None]
        return self.log((BATTERY, *APPLIED, *(speeds[0] if speeds else ())), period_ms=period_ms)

    def speed_log(self, period_ms: int, *, deck: bool) -> Device:
        """Return a log with the rotors' speeds, as the RPM deck or the brushless motors report them.

        Raises DeviceError for a vehicle that reports none.
        """
        names = DECK_SPEEDS if deck else MOTOR_SPEEDS
        if self.link.variable(names[0]) is None:
            what = "RPM deck" if deck else "motors that report their speed"
            raise DeviceError(f"{self.uri}: this vehicle has no {what}: it does not log {names[0]}.")
        return self.log((BATTERY, *APPLIED, *names), period_ms=period_ms)

    def inertial_log(self, period_ms: int, **facts: Any) -> Device:
        """Return a log of gyro and accelerometer; `facts` about their rate go into run.toml.

        Raises DeviceError for a firmware that does not log them.
        """
        missing = [name for name in INERTIAL if self.link.variable(name) is None]
        if missing:
            raise DeviceError(f"{self.uri}: this firmware does not log {', '.join(missing)}.")
        device = self.log(INERTIAL, period_ms=period_ms)
        record = device.record.model_copy(update={"rate_hz": 1000 / period_ms, **facts})
        return replace(device, record=record, reading=turning())

    def log(self, names: Sequence[str], *, period_ms: int) -> Device:
        """Return a log of variables as a device of a run; those that the vehicle does not have are left out."""
        there = [name for name in names if self.link.variable(name) is not None]

        def opened(loop: Loop, clock: HostClock) -> Instrument:
            return CrazyflieLog(
                self.vehicle(loop),
                there,
                period_ms=period_ms,
                stop_below_v=self.setting.stop_below_v if BATTERY in there else None,
                idle_thrust=self.idle_thrust,
                loop=loop,
                clock=clock,
            )

        place = 1 + there.index(BATTERY) if BATTERY in there else 0
        device = self._device("crazyflie.csv", ("t", "vehicle_ms", *there), opened, period_ms=period_ms)
        return replace(device, reading=volts(place) if place else None)

    def _device(
        self,
        file: str,
        columns: Sequence[str],
        opened: Callable[[Loop, HostClock], Instrument],
        *,
        eventful: bool = False,
        **more: Any,
    ) -> Device:
        common = {
            "uri": self.uri,
            "firmware": self.firmware.kind,
            "crtp_version": self.link.firmware_protocol,
            "ports": self.firmware.ports._asdict(),
        }
        record = DeviceRecord.model_validate({"file": file, "columns": tuple(columns), **common, **more})
        return Device(record=record, open=opened, eventful=eventful)


def connect_vehicle(setting: CrazyflieLink, held: ExitStack) -> ReadyVehicle:
    """Find and lock the vehicle, connect, and find out its firmware and state. Raises DeviceError."""
    uri = setting.uri or find_vehicle()
    held.enter_context(DeviceLock.take(uri))
    link = connect(uri)
    held.callback(link.close)
    ports = AppPorts(setting.thrust_port, setting.sine_port, setting.ping_port)

    async def introduced(vehicle: Vehicle) -> tuple[Firmware, VehicleState | None, int]:
        return await firmware_of(vehicle, ports), *await state_and_idle(vehicle)

    firmware, state, idle_thrust = asked(link, introduced)
    return ReadyVehicle(link, firmware, setting, state, idle_thrust)


async def state_and_idle(vehicle: Vehicle) -> tuple[VehicleState | None, int]:
    """Return the supervisor's state, None where the firmware reports none, and the idle thrust of one that is armed.

    Raises DeviceError for a vehicle that does not answer.
    """
    state = await present_state(vehicle)
    parameter = vehicle.wire.parameter(IDLE_THRUST)
    if state is None or state.arms_itself or parameter is None:
        return state, 0
    idle_thrust = await vehicle.read_parameter(parameter, tries=_TRIES)
    if idle_thrust is None:
        raise DeviceError(f"{vehicle.uri}: the vehicle did not report {IDLE_THRUST}: the link loses packets.")
    return state, int(idle_thrust)
