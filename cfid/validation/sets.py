"""Make parameter sets: from a campaign's rig, from its flights, and from complete published values."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError
from cfid.flight.model import ThrustLag
from cfid.flight.rows import AXES
from cfid.records.rig_file import Rig
from cfid.report import published
from cfid.report.axes import turned
from cfid.units import FULL_COMMAND, MM, RPM
from cfid.validation.measured import Measured
from cfid.validation.rollout import ParameterSet

_NO_YAW = "no torque about yaw, whose moment is unknown: it stands as the sum of the others"
_BEYOND = 20.0  # times mass times arm squared, or one over it: bodies have 0.2 to 2
ARM_M = 0.046  # of a Crazyflie 2.x, from its centre to a motor's axis, for published sets


class NoVoltageError(ConfigError):
    """A published set's thrust is a function of volts, and the log has none."""


def sets_of(measured: Measured, *, in_volts: bool) -> tuple[list[ParameterSet], list[str]]:
    """Return the sets that parameters give for a log with or without voltage, and why other sets are incomplete.

    One set is from the rig's experiments, with rig.toml's mass and arm; the other is from flights, with the mass and
    arm that scaled them.
    """
    found, missing = [], []
    makers: dict[str, Callable[[Measured, str, bool], ParameterSet]] = {"rig": _of_rig, "flight": _of_flights}
    for what, make in makers.items():
        try:
            one = make(measured, f"{measured.name} ({what})", in_volts)
        except KeyError as error:
            missing.append(f"{measured.name}: no set of the {what}: {error.args[0]}")
            continue
        if fault := _impossible(one):
            missing.append(f"{measured.name}: no set of the {what}: {fault}, which no vehicle has.")
        else:
            found.append(one)
    return found, missing


def _impossible(one: ParameterSet) -> str:
    """Return the impossible value of a set in words, "" if all are possible."""
    sizes = {"mass": one.mass_kg, "arm": one.arm_m, **dict(zip(AXES, one.moments_kg_m2, strict=True))}
    wrong = next((name for name, size in sizes.items() if not 0 < size < math.inf), None)
    if wrong is not None:
        return f"{wrong} {sizes[wrong]:g}"
    of_points = one.mass_kg * one.arm_m**2  # with the mass at the motors, the moment about yaw is twice this
    far = next((axis for axis in AXES if not 1 / _BEYOND < sizes[axis] / of_points < _BEYOND), None)
    if far is not None:
        return f"moment about {far} of {sizes[far] / of_points:.3g} times mass times arm squared"
    slow = one.lag is not None and not all(0 <= tau_s < 1 for tau_s in one.lag)
    return f"lags of {one.lag.rising_s:g} and {one.lag.falling_s:g} s" if one.lag is not None and slow else ""


def published_set(name: str, *, in_volts: bool) -> ParameterSet:
    """Return a published set. Raises ConfigError for another name, NoVoltageError if it needs the battery's voltage."""
    make = PUBLISHED.get(name)
    if make is None:
        raise ConfigError(f"`with` {name}: no campaign folder, and no published set ({', '.join(PUBLISHED)}).")
    one = make()
    if one.in_volts and not in_volts:
        raise NoVoltageError(f"`with` {name}: its thrust is of volts, and the log has no battery voltage (pm.vbat).")
    return one


def _of_rig(at: Measured, name: str, in_volts: bool) -> ParameterSet:
    if at.rig is None:
        raise KeyError("no rig.toml with mass and arm belongs to the fit.")
    matrix = turned(at["inertia.matrix_kg_m2"].value, at.rig.vehicle.body_frame)
    lag_s = at["tf.time_constant_s"].value
    thrust_n, in_volts = _thrust(at, "motor", in_volts)
    return ParameterSet(
        name=name,
        origin="its experiments on the rig",
        mass_kg=at.rig.vehicle.mass_kg,
        moments_kg_m2=(matrix["roll"], matrix["pitch"], matrix["yaw"]),
        arm_m=_arm_m(at.rig),
        torque_m=float(at["motor.torque_poly"].value[-2]),
        thrust_n=thrust_n,
        in_volts=in_volts,
        lag=ThrustLag(lag_s, lag_s),
    )


def _of_flights(at: Measured, name: str, in_volts: bool) -> ParameterSet:
    roll, pitch = (float(at[f"flight.inertia_kg_m2.{axis}"].value) for axis in ("roll", "pitch"))
    yaw, torque_m = at.get("flight.inertia_kg_m2.yaw"), _torque_m(at)
    known = yaw is not None and torque_m is not None
    thrust_n, in_volts = _thrust(at, "flight", in_volts)
    forward, left = (at.get(f"flight.drag_over_mass_per_s.{axis}") for axis in ("forward", "left"))
    return ParameterSet(
        name=name,
        origin="its flights" + ("" if known else f", {_NO_YAW}"),
        mass_kg=float(at["flight.mass_kg"].value),
        moments_kg_m2=(roll, pitch, roll + pitch if yaw is None else float(yaw.value)),
        arm_m=float(at["flight.arm_m"].value),
        torque_m=0.0 if yaw is None or torque_m is None else torque_m,
        thrust_n=thrust_n,
        in_volts=in_volts,
        lag=ThrustLag(at["flight.rising_s"].value, at["flight.falling_s"].value),
        drag_per_s=None if forward is None or left is None else (float(forward.value), float(left.value)),
    )


def _torque_m(at: Measured) -> float | None:
    """Return the torque over thrust that scaled a flight's moment about yaw, else the rig's, None if neither exists."""
    scaled, rig = at.get("flight.torque_m"), at.get("motor.torque_poly")
    if scaled is not None:
        return float(scaled.value)
    return None if rig is None else float(rig.value[-2])


def _arm_m(rig: Rig) -> float:
    arm_mm = rig.facts.loadcell.arm_mm
    if arm_mm is None:
        raise KeyError("arm_mm is not in rig.toml.")
    return MM * arm_mm


def _thrust(at: Measured, experiment: str, in_volts: bool) -> tuple[tuple[float, ...], bool]:
    """Return one rotor's thrust, lowest power first, over volts if log and campaign have them, else over commands."""
    of_volts = at.get(f"{experiment}.thrust_voltage_poly")
    if in_volts and of_volts is not None:
        return tuple(map(float, of_volts.value)), True
    return _over_full_command([float(one) for one in at[f"{experiment}.thrust_poly"].value]), False


def _over_full_command(poly: Sequence[float]) -> tuple[float, ...]:
    """Convert coefficients over the command, highest first, to ones over the command relative to full, lowest first."""
    return tuple(one * FULL_COMMAND**power for power, one in enumerate(reversed(poly)))


def _value(table: Sequence[published.Published], who: str, vehicle: str) -> float:
    found = next(one for one in table if (one.who, one.vehicle) == (who, vehicle)).values[0]
    assert found is not None
    return found


def _moments(who: str, vehicle: str) -> tuple[float, float, float]:
    one = next(one for one in published.INERTIA if (one.who, one.vehicle) == (who, vehicle))
    xx, yy, zz, xy, xz, yz = one.matrix_kg_m2
    matrix = turned([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], one.axes)
    return matrix["roll"], matrix["pitch"], matrix["yaw"]


def _thesis() -> ParameterSet:
    lag_s = _value(published.DYNAMICS, "thesis (3.16)", "2.0")
    commands = np.array(published.COMMANDS) / FULL_COMMAND
    thrust = next(one for one in published.THRUST_N if one.who == "thesis").values
    return ParameterSet(
        name="thesis",
        origin=published.APPENDIX_A,
        mass_kg=_value(published.MASS_KG, "thesis", "Crazyflie 2.0"),
        moments_kg_m2=_moments("thesis", "Crazyflie 2.0"),
        arm_m=ARM_M,
        torque_m=_value(published.TORQUE_PER_THRUST_M, "thesis", "Crazyflie 2.0"),
        thrust_n=_through(commands, thrust, degree=2),
        in_volts=False,
        lag=ThrustLag(lag_s, lag_s),
    )


def _pybullet() -> ParameterSet:
    # rad/s, its linear function of the command.
    speeds = [RPM * (0.2685 * command + 4070.3) for command in published.COMMANDS]
    one = next(one for one in published.THRUST_AT_SPEED_N if one.who == "gym-pybullet-drones").values[0]
    assert one is not None
    k = one / published.SPEEDS_RAD_S[0] ** 2
    return ParameterSet(
        name="gym-pybullet-drones",
        origin=published.PYBULLET,
        mass_kg=_value(published.MASS_KG, "gym-pybullet-drones", "Crazyflie 2.x"),
        moments_kg_m2=_moments("gym-pybullet-drones", "2.x"),
        arm_m=ARM_M,
        torque_m=_value(published.TORQUE_PER_THRUST_M, "gym-pybullet-drones", "2.x"),
        thrust_n=_through(np.array(published.COMMANDS) / FULL_COMMAND, [k * speed**2 for speed in speeds], degree=2),
        in_volts=False,
    )


def _firmware() -> ParameterSet:
    thrust = next(
        one
        for one in published.THRUST_AT_VOLTAGE_N
        if (one.who, one.vehicle) == ("Bitcraze firmware", "2.x, legacy propellers")
    )
    return ParameterSet(
        name="firmware",
        origin=published.FIRMWARE,
        mass_kg=_value(published.MASS_KG, "Bitcraze firmware", "Crazyflie 2.x"),
        moments_kg_m2=_moments("Bitcraze firmware (Lee)", "Crazyflie 2.x"),
        arm_m=ARM_M,
        torque_m=_value(published.TORQUE_PER_THRUST_M, "Bitcraze firmware", "2.x, legacy propellers"),
        thrust_n=_through(np.array(published.VOLTS), thrust.values, degree=3),
        in_volts=True,
    )


def _through(at: npt.NDArray[np.float64], values: Sequence[float | None], *, degree: int) -> tuple[float, ...]:
    """Return the polynomial, lowest power first, through these values."""
    known = np.array(values, dtype=np.float64)
    return tuple(map(float, np.polynomial.polynomial.polyfit(at, known, degree)))


PUBLISHED: Mapping[str, Callable[[], ParameterSet]] = {
    "thesis": _thesis,
    "gym-pybullet-drones": _pybullet,
    "firmware": _firmware,
}
