"""Which parameters and log variables the simulated vehicle has: a modest choice of the firmware's own."""

import math
from typing import Protocol

from cfid.sim.crazyflie_log import Variable
from cfid.sim.crazyflie_params import Parameter
from cfid.sim.crazyflie_supervisor import Supervisor
from cfid.sim.propulsion import Four
from cfid.sim.stepping import Array

_EMPTY_V, _FULL_V = 3.0, 4.2
_ROOM_C = 24.0
_LARGEST_U16 = 65535
_MOTORS = range(4)


class Sensed(Protocol):
    """What a vehicle knows of itself."""

    supervisor: Supervisor
    acc_z_g: float

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
        """What brushless motors' drivers report, or nothing."""


def parameters(*, rpm_deck: bool, idle: int = 0) -> list[Parameter]:
    """Return the parameters with their values after a start, `idle` that of powerDist.idleThrust."""
    return [
        Parameter("motorPowerSet.enable", "B", 0),
        *(Parameter(f"motorPowerSet.m{motor + 1}", "H", 0) for motor in _MOTORS),
        Parameter("pm.lowVoltage", "f", 3.2, persistent=True),
        Parameter("pm.criticalLowVoltage", "f", 3.0, persistent=True),
        Parameter("system.selftestPassed", "b", 1, read_only=True, core=True),
        Parameter("system.assertInfo", "B", 0),
        Parameter("supervisor.infdmp", "B", 0),
        Parameter("supervisor.tmblChckEn", "B", 1, persistent=True),
        Parameter("stabilizer.stop", "B", 0, core=True),
        Parameter("stabilizer.estimator", "B", 1, core=True),
        Parameter("stabilizer.controller", "B", 1, core=True),
        Parameter("commander.enHighLevel", "B", 0, core=True),
        Parameter("flightmode.althold", "B", 0, core=True),
        Parameter("pid_rate.roll_kp", "f", 250.0, persistent=True),
        Parameter("powerDist.idleThrust", "I", idle, persistent=True, core=True),
        Parameter("health.startPropTest", "B", 0),
        Parameter("crtpsrv.echoDelay", "H", 0),
        Parameter("deck.bcRpm", "B", rpm_deck, read_only=True),
        Parameter("firmware.revision0", "I", 0x2A18FC29, read_only=True, core=True),
        Parameter("firmware.revision1", "H", 0x9D7B, read_only=True, core=True),
        Parameter("firmware.modified", "B", 0, read_only=True, core=True),
        Parameter("supervisor.prefltTimeout", "H", 30000, persistent=True),
        Parameter("supervisor.landedTimeout", "H", 3000, persistent=True),
        Parameter("supervisor.spinupTimeout", "H", 2000, persistent=True),
    ]


def variables(vehicle: Sensed, *, rpm_deck: bool, brushless: bool) -> list[Variable]:
    """Return the log variables; of a vehicle that is fastened and level."""
    supervisor = vehicle.supervisor
    found = [
        Variable("pm.vbat", "f", lambda: vehicle.volts),
        Variable("pm.vbatMV", "H", lambda: 1000 * vehicle.volts),
        Variable("pm.batteryLevel", "B", lambda: _level(vehicle.volts)),
        Variable("pm.state", "b", lambda: 0),
        Variable("supervisor.info", "H", lambda: supervisor.bits),
        Variable("sys.canfly", "B", lambda: supervisor.can_fly),
        Variable("sys.isFlying", "B", lambda: supervisor.flying),
        Variable("sys.isTumbled", "B", lambda: supervisor.tumbled),
        *(_constant(f"stabilizer.{angle}", 0.0) for angle in ("roll", "pitch", "yaw")),
        Variable("stabilizer.thrust", "f", lambda: max(vehicle.motors)),
        *(_constant(f"gyro.{axis}", 0.0) for axis in "xyz"),
        Variable("acc.x", "f", lambda: math.sqrt(max(0.0, 1 - vehicle.acc_z_g**2))),
        _constant("acc.y", 0.0),
        Variable("acc.z", "f", lambda: vehicle.acc_z_g),
        _constant("baro.temp", _ROOM_C),
        *(_command(vehicle, f"motor.m{motor + 1}", "H", motor) for motor in _MOTORS),
        *(_command(vehicle, f"motor.m{motor + 1}req", "i", motor) for motor in _MOTORS),
    ]
    found += [_reported_speed(vehicle, motor) for motor in _MOTORS] if brushless else []
    return found + ([_deck_speed(vehicle, motor) for motor in _MOTORS] if rpm_deck else [])


def _constant(name: str, value: float) -> Variable:
    return Variable(name, "f", lambda: value)


def _command(vehicle: Sensed, name: str, kind: str, motor: int) -> Variable:
    return Variable(name, kind, lambda: vehicle.motors[motor])


def _reported_speed(vehicle: Sensed, motor: int) -> Variable:
    """Return a speed in revolutions a minute as a brushless motor's driver reports it."""
    return Variable(f"motor.m{motor + 1}_rpm", "H", lambda: min(vehicle.rotors_rpm[motor], _LARGEST_U16))


def _deck_speed(vehicle: Sensed, motor: int) -> Variable:
    """Return a speed in revolutions a minute as the RPM deck measures it."""
    rpm_a_rad_per_s = 60 / math.tau
    return Variable(
        f"rpm.m{motor + 1}", "H", lambda: min(vehicle.speed_rad_per_s[motor] * rpm_a_rad_per_s, _LARGEST_U16)
    )


def _level(volts: float) -> float:
    """Return the charge in percent, in steps of ten, as its voltage hints at it."""
    return 10 * round(10 * min(max((volts - _EMPTY_V) / (_FULL_V - _EMPTY_V), 0.0), 1.0))
