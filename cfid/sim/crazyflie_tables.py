"""Lists the simulated vehicle's parameters and log variables, a selection of the firmware's."""

import math
from typing import Protocol

from cfid.sim.crazyflie_log import LoggedVariable
from cfid.sim.crazyflie_params import FirmwareParameter
from cfid.sim.crazyflie_supervisor import SimulatedSupervisor
from cfid.sim.imu import ImuSample
from cfid.sim.propulsion import Four
from cfid.sim.stepping import Array

_EMPTY_V, _FULL_V = 3.0, 4.2
_ROOM_C = 24.0
_LARGEST_U16 = 65535
_MOTORS = range(4)


class Sensed(Protocol):
    """The vehicle's state that its log variables show."""

    supervisor: SimulatedSupervisor

    @property
    def inertial(self) -> ImuSample:
        """What gyro and accelerometer show."""

    @property
    def motors(self) -> Four:
        """The commands in force."""

    @property
    def volts(self) -> float:
        """The battery's voltage."""

    @property
    def speed_rad_per_s(self) -> Array:
        """How fast the rotors turn (4,)."""

    @property
    def rotors_rpm(self) -> list[float]:
        """The speeds that brushless motors' drivers report, or nothing."""


def parameters(*, rpm_deck: bool, idle: int = 0) -> list[FirmwareParameter]:
    """Return the parameters with their values after a start, `idle` that of powerDist.idleThrust."""
    return [
        FirmwareParameter("motorPowerSet.enable", "B", 0),
        *(FirmwareParameter(f"motorPowerSet.m{motor + 1}", "H", 0) for motor in _MOTORS),
        FirmwareParameter("pm.lowVoltage", "f", 3.2, persistent=True),
        FirmwareParameter("pm.criticalLowVoltage", "f", 3.0, persistent=True),
        FirmwareParameter("system.selftestPassed", "b", 1, read_only=True, core=True),
        FirmwareParameter("system.assertInfo", "B", 0),
        FirmwareParameter("supervisor.infdmp", "B", 0),
        FirmwareParameter("supervisor.tmblChckEn", "B", 1, persistent=True),
        FirmwareParameter("stabilizer.stop", "B", 0, core=True),
        FirmwareParameter("stabilizer.estimator", "B", 1, core=True),
        FirmwareParameter("stabilizer.controller", "B", 1, core=True),
        FirmwareParameter("commander.enHighLevel", "B", 0, core=True),
        FirmwareParameter("flightmode.althold", "B", 0, core=True),
        FirmwareParameter("pid_rate.roll_kp", "f", 250.0, persistent=True),
        FirmwareParameter("powerDist.idleThrust", "I", idle, persistent=True, core=True),
        FirmwareParameter("health.startPropTest", "B", 0),
        FirmwareParameter("crtpsrv.echoDelay", "H", 0),
        FirmwareParameter("deck.bcRpm", "B", rpm_deck, read_only=True),
        FirmwareParameter("firmware.revision0", "I", 0x2A18FC29, read_only=True, core=True),
        FirmwareParameter("firmware.revision1", "H", 0x9D7B, read_only=True, core=True),
        FirmwareParameter("firmware.modified", "B", 0, read_only=True, core=True),
        FirmwareParameter("supervisor.prefltTimeout", "H", 30000, persistent=True),
        FirmwareParameter("supervisor.landedTimeout", "H", 3000, persistent=True),
        FirmwareParameter("supervisor.spinupTimeout", "H", 2000, persistent=True),
    ]


def variables(vehicle: Sensed, *, rpm_deck: bool, brushless: bool) -> list[LoggedVariable]:
    """Return the log variables of a vehicle that is fastened or hangs in a swing."""
    supervisor = vehicle.supervisor
    found = [
        LoggedVariable("pm.vbat", "f", lambda: vehicle.volts),
        LoggedVariable("pm.vbatMV", "H", lambda: 1000 * vehicle.volts),
        LoggedVariable("pm.batteryLevel", "B", lambda: _level(vehicle.volts)),
        LoggedVariable("pm.state", "b", lambda: 0),
        LoggedVariable("supervisor.info", "H", lambda: supervisor.bits),
        LoggedVariable("sys.canfly", "B", lambda: supervisor.can_fly),
        LoggedVariable("sys.isFlying", "B", lambda: supervisor.flying),
        LoggedVariable("sys.isTumbled", "B", lambda: supervisor.tumbled),
        *(_constant(f"stabilizer.{angle}", 0.0) for angle in ("roll", "pitch", "yaw")),
        LoggedVariable("stabilizer.thrust", "f", lambda: max(vehicle.motors)),
        *(_inertial(vehicle, name, place) for name in ImuSample._fields for place in range(3)),
        _constant("baro.temp", _ROOM_C),
        *(_command(vehicle, f"motor.m{motor + 1}", "H", motor) for motor in _MOTORS),
        *(_command(vehicle, f"motor.m{motor + 1}req", "i", motor) for motor in _MOTORS),
    ]
    found += [_reported_speed(vehicle, motor) for motor in _MOTORS] if brushless else []
    return found + ([_deck_speed(vehicle, motor) for motor in _MOTORS] if rpm_deck else [])


def _constant(name: str, value: float) -> LoggedVariable:
    return LoggedVariable(name, "f", lambda: value)


def _inertial(vehicle: Sensed, name: str, place: int) -> LoggedVariable:
    sensor = name.partition("_")[0]
    return LoggedVariable(f"{sensor}.{'xyz'[place]}", "f", lambda: getattr(vehicle.inertial, name)[place])


def _command(vehicle: Sensed, name: str, kind: str, motor: int) -> LoggedVariable:
    return LoggedVariable(name, kind, lambda: vehicle.motors[motor])


def _reported_speed(vehicle: Sensed, motor: int) -> LoggedVariable:
    """Return a speed in revolutions a minute as a brushless motor's driver reports it."""
    return LoggedVariable(f"motor.m{motor + 1}_rpm", "H", lambda: min(vehicle.rotors_rpm[motor], _LARGEST_U16))


def _deck_speed(vehicle: Sensed, motor: int) -> LoggedVariable:
    """Return a speed in revolutions a minute as the RPM deck measures it."""
    rpm_a_rad_per_s = 60 / math.tau
    return LoggedVariable(
        f"rpm.m{motor + 1}", "H", lambda: min(vehicle.speed_rad_per_s[motor] * rpm_a_rad_per_s, _LARGEST_U16)
    )


def _level(volts: float) -> float:
    """Return the charge in percent, estimated from the voltage in steps of ten."""
    return 10 * round(10 * min(max((volts - _EMPTY_V) / (_FULL_V - _EMPTY_V), 0.0), 1.0))
