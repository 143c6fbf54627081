"""Finds, locks and connects a vehicle, and offers its instruments for a run."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from cfid.errors import DeviceError
from cfid.records.rig_file import CrazyflieLink
from cfid.records.run import DeviceRecord
from cfid.rig.app_motors import AppMotors
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Instrument
from cfid.rig.lock import DeviceLock
from cfid.rig.motor_commands import MotorCommands, StockMotors
from cfid.rig.motor_log import APPLIED, foreign_motion
from cfid.rig.motors import Firmware, Limits, firmware_of
from cfid.rig.pings import Pings
from cfid.rig.progress import Reading, turning, volts
from cfid.rig.sine import Crossings
from cfid.rig.supervisor import Supervisor, SupervisorLog, present_state
from cfid.rig.tables import connect
from cfid.rig.vehicle import BATTERY, Vehicle, asked
from cfid.rig.vehicle_log import CrazyflieLog
from cfid.units import MOTORS
from cfid.wire.app import AppPorts
from cfid.wire.supervisor import VehicleState

DECK_SPEEDS = tuple(f"rpm.m{motor}" for motor in MOTORS)
MOTOR_SPEEDS = tuple(f"motor.m{motor}_rpm" for motor in MOTORS)
INERTIAL = tuple(f"{sensor}.{axis}" for sensor in ("gyro", "acc") for axis in "xyz")
IDLE_THRUST = "powerDist.idleThrust"
OBEYS_SINCE = 10  # version of the protocol; of its two releases, the app compiles only with the one that obeys
USUAL_MS = 10
NO_APP = "a sine is played on board: this needs cfid's app on the vehicle (firmware_patches/README.md explains how)."


@dataclass
class ReadyVehicle:
    """A connected vehicle. The instruments of one recording share its link, its supervisor and its motors."""

    vehicle: Vehicle
    firmware: Firmware
    setting: CrazyflieLink
    state: VehicleState | None = None  # as it was found; None where the firmware reports none
    idle_thrust: int = 0

    def __post_init__(self) -> None:
        """Attach the supervisor."""
        self._supervisor = Supervisor(self.vehicle)

    @property
    def limits(self) -> Limits:
        """The motors' limits by rig.toml and the rotors; the parameters of stock firmware ignore idle thrust."""
        idle_thrust = self.idle_thrust if self.firmware.kind == "app" else 0
        return Limits(largest_command=self.setting.largest_command, idle_thrust=idle_thrust)

    def refuse_unfit(self) -> None:
        """Raise DeviceError for a vehicle whose motors cannot or must not be started in its present state."""
        if self.state is not None and self.state.remedy:
            raise DeviceError(f"{self.uri}: the vehicle is {self.state.name}: {self.state.remedy}.")
        if self.firmware.kind == "app" and self.vehicle.link.firmware_protocol < OBEYS_SINCE:
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
        cause = asked(self.vehicle, lambda vehicle: foreign_motion(vehicle, idle_thrust=self.idle_thrust))
        if cause:
            raise DeviceError(f"{self.uri}: {cause}.")

    @property
    def uri(self) -> str:
        """The vehicle's address."""
        return self.vehicle.uri

    @property
    def reports_battery(self) -> bool:
        """Whether the vehicle's log has the battery's voltage."""
        return self.vehicle.link.variable(BATTERY) is not None

    def motors(self) -> AppMotors | StockMotors:
        """Return its motors for one recording, driven as its firmware allows."""
        if self.firmware.kind == "stock":
            return StockMotors(self.vehicle, self.limits)
        return AppMotors(self.vehicle, self.firmware, self.limits, self._supervisor)

    def commands(self) -> MotorCommands:
        """Return the motors as an instrument of a run."""
        return MotorCommands(self.motors(), self._record("commands.csv", MotorCommands.columns))

    def crossings(self) -> Crossings:
        """Return a sine's reports as an instrument of a run. Raises DeviceError for a vehicle that cannot play one."""
        motors = self.motors()
        if isinstance(motors, StockMotors):
            raise DeviceError(f"{self.uri}: {NO_APP}")
        record = self._record("crossings.csv", Crossings.columns)
        return Crossings(motors, self.vehicle, self.firmware, record)

    def pings(self) -> Pings:
        """Return round trips as an instrument of a run."""
        return Pings(self.vehicle, self.firmware, self._record("pings.csv", Pings.columns_of(self.firmware)))

    def supervisor_log(self) -> SupervisorLog:
        """Return the supervisor's states as an instrument of a run."""
        return SupervisorLog(self._supervisor, self.vehicle, self._record("supervisor.csv", SupervisorLog.columns))

    def watch(self, period_ms: int = USUAL_MS) -> list[Instrument]:
        """Return what every experiment with motors records: the usual log and the supervisor's states."""
        return [self.usual_log(period_ms), self.supervisor_log()]

    def usual_log(self, period_ms: int = USUAL_MS) -> CrazyflieLog:
        """Return the log of every experiment: battery, motor commands, and speeds where the vehicle reports them."""
        speeds = [names for names in (DECK_SPEEDS, MOTOR_SPEEDS) if self.vehicle.link.variable(names[0]) is not None]
        return self.log((BATTERY, *APPLIED, *(speeds[0] if speeds else ())), period_ms=period_ms)

    def speed_log(self, period_ms: int, *, deck: bool) -> CrazyflieLog:
        """Return a log with the rotors' speeds, as the RPM deck or the brushless motors report them.

        Raises DeviceError for a vehicle that reports none.
        """
        names = DECK_SPEEDS if deck else MOTOR_SPEEDS
        if self.vehicle.link.variable(names[0]) is None:
            what = "RPM deck" if deck else "motors that report their speed"
            raise DeviceError(f"{self.uri}: this vehicle has no {what}: it does not log {names[0]}.")
        return self.log((BATTERY, *APPLIED, *names), period_ms=period_ms)

    def inertial_log(self, period_ms: int) -> CrazyflieLog:
        """Return a log of gyro and accelerometer. Raises DeviceError for a firmware that does not log them."""
        missing = [name for name in INERTIAL if self.vehicle.link.variable(name) is None]
        if missing:
            raise DeviceError(f"{self.uri}: this firmware does not log {', '.join(missing)}.")
        return self.log(INERTIAL, period_ms=period_ms, reading=turning(), rate_hz=1000 / period_ms)

    def log(self, names: Sequence[str], *, period_ms: int, reading: Reading | None = None, **more: Any) -> CrazyflieLog:
        """Return a log of variables as an instrument of a run; those that the vehicle does not have are left out."""
        known = [name for name in names if self.vehicle.link.variable(name) is not None]
        return CrazyflieLog(
            self.vehicle,
            known,
            self._record("crazyflie.csv", ("t", "vehicle_ms", *known), period_ms=period_ms, **more),
            period_ms=period_ms,
            stop_below_v=self.setting.stop_below_v if BATTERY in known else None,
            idle_thrust=self.idle_thrust,
            reading=volts(1 + known.index(BATTERY)) if BATTERY in known else reading,
        )

    def _record(self, file: str, columns: Sequence[str], **more: Any) -> DeviceRecord:
        common = {
            "uri": self.uri,
            "firmware": self.firmware.kind,
        }
        return DeviceRecord.model_validate({"file": file, "columns": tuple(columns), **common, **more})


def connect_vehicle(setting: CrazyflieLink, hardware: Hardware, held: ExitStack) -> ReadyVehicle:
    """Find and lock the vehicle, connect, and find out its firmware and state. Raises DeviceError."""
    uri = setting.uri or hardware.find_vehicle()
    held.enter_context(DeviceLock(uri))
    vehicle = connect(uri, hardware)
    held.callback(vehicle.link.close)
    ports = AppPorts(setting.thrust_port, setting.sine_port, setting.ping_port)

    async def introduced(vehicle: Vehicle) -> tuple[Firmware, VehicleState | None, int]:
        return await firmware_of(vehicle, ports), *await state_and_idle(vehicle)

    firmware, state, idle_thrust = asked(vehicle, introduced)
    return ReadyVehicle(vehicle, firmware, setting, state, idle_thrust)


async def state_and_idle(vehicle: Vehicle) -> tuple[VehicleState | None, int]:
    """Return the supervisor's state, None where the firmware reports none, and the idle thrust of one that is armed.

    Raises DeviceError for a vehicle that does not answer.
    """
    state = await present_state(vehicle)
    parameter = vehicle.link.parameter(IDLE_THRUST)
    if state is None or state.arms_itself or parameter is None:
        return state, 0
    idle_thrust = await vehicle.read_parameter(parameter, tries=5)
    if idle_thrust is None:
        raise DeviceError(f"{vehicle.uri}: the vehicle did not report {IDLE_THRUST}: the link loses packets.")
    return state, int(idle_thrust)
