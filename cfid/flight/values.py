"""Convert flights' quantities to their units, with covariances and their dependence on mass, arm and torque."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.common_causes import Cause
from cfid.estimate.linear import std_of
from cfid.flight.braking import AxisDrag
from cfid.flight.equations import DELAYS, LAGS, THRUST, TURNS
from cfid.flight.estimation import FlightFit
from cfid.flight.rows import AXES, LEVER
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.units import FULL_COMMAND, MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

MOMENTS = {axis: f"flight.inertia_kg_m2.{axis}" for axis in AXES}
_RISING, _FALLING, _MEAN = "flight.rising_s", "flight.falling_s", "flight.time_constant_s"
DELAY, SINGLE = "flight.delay_s", "flight.single_lag_s"
# Each quantity's weights on the time constants and the delays of accelerometer and gyro.
_TIMES = {
    _RISING: (1.0, 0.0, 0.0, 0.0),
    _FALLING: (0.0, 1.0, 0.0, 0.0),
    _MEAN: (0.5, 0.5, 0.0, 0.0),
    DELAY: (0.0, 0.0, 0.0, 1.0),
    SINGLE: (0.5, 0.5, 1.0, 0.0),
}
TIMES = tuple(_TIMES)
# Without the battery's voltage, thrust's slope is that of all rotors together, under which the voltage drops: it is up
# to 15 % less than that of one rotor against another, which turns the vehicle. `_WITH_SAG` has the powers with which
# values depend on it.
LOAD_SAG_STD = 0.08
# A Crazyflie's firmware divides accelerations by the mean of 200 samples at rest (processAccScale), which includes the
# zero error: 0.02 g of it (see `estimation`) become a scale of everything except the weight itself.
RESCALED_STD = 0.02
# Thrust falls by k times the speed of the air along the rotor's axis. Simulated flights with k of 0.03, 0.06 and 0.08
# s/m (a propeller without thrust at 12 m/s) gave a falling lag that was too long by 1.6, 2.7 and 3.3 %, a rising one
# that was too short by half as much, and a mean of both that was too long by 0.4 times as much.
INFLOW_STD = 0.02
_WITH_INFLOW = {_RISING: -0.5, _FALLING: 1.0, _MEAN: 0.4, SINGLE: 0.4}
_WITH_SAG = {**dict.fromkeys(MOMENTS.values(), 1.0), **dict.fromkeys((_RISING, _FALLING, _MEAN, SINGLE), 0.25)}


@dataclass(frozen=True, kw_only=True)
class Body:
    """What a flight cannot determine: mass, arm from the centre to a motor's axis, torque of a rotor over its thrust.

    Each has its standard uncertainty; None is unknown. `load_sag_std` is the share of thrust's slope by which a
    battery's sag under load may reduce it where the log has no voltage, `rescaled_std` is the uncertainty of the scale
    of accelerations that a firmware divides by their size at rest, and `inflow_std` is the effect of inflow on the
    falling lag.
    """

    mass_kg: float
    mass_std_kg: float
    arm_m: float | None = None
    arm_std_m: float | None = None
    torque_m: float | None = None
    torque_std_m: float | None = None
    load_sag_std: float = LOAD_SAG_STD
    rescaled_std: float = RESCALED_STD
    inflow_std: float = INFLOW_STD


def thrust_key(found: FlightFit) -> str:
    """Return the key of the thrust, as a function of the motor's voltage or of the command."""
    return "flight.thrust_voltage_poly" if found.in_volts else "flight.thrust_poly"


def quantities_of(found: FlightFit, body: Body) -> dict[str, Parameter]:
    """Return thrust, times, and the moments with a known lever; mass, arm and torque are taken as exact."""
    value, covariance = _of_thrust(found, body)
    std = found.std
    quantities = {
        thrust_key(found): Parameter(value=value.tolist(), std=std_of(covariance).tolist()),
        **{key: Parameter(value=value_s, std=std_s) for key, (value_s, std_s) in times_of(found).items()},
    }
    for place, axis in enumerate(AXES):
        lever = lever_m(axis, body)
        gain, gain_std = float(found.values[TURNS][place]), float(std[TURNS][place])
        if lever is not None and gain != 0:  # a gyro that is stuck shows no rotation
            moment = lever * body.mass_kg / gain
            quantities[MOMENTS[axis]] = Parameter(value=moment, std=abs(moment * gain_std / gain))
    return quantities


def times_of(found: FlightFit) -> dict[str, tuple[float, float]]:
    """Return the time constants, the gyro's delay and sums of them in s, each with its standard uncertainty."""
    times = np.array(list(_TIMES.values()))
    stds = std_of(times @ found.covariance[: DELAYS.stop, : DELAYS.stop] @ times.T)
    values = times @ found.values[: DELAYS.stop]
    return {key: (float(value), float(std)) for key, value, std in zip(_TIMES, values, stds, strict=True)}


def lever_m(axis: str, body: Body) -> float | None:
    """Return a rotor's moment about an axis divided by its thrust, None where it is unknown."""
    if axis == "yaw":
        return body.torque_m
    return None if body.arm_m is None else LEVER * body.arm_m


def _of_thrust(found: FlightFit, body: Body) -> tuple[Array, Array]:
    """Return one rotor's thrust polynomial (3,) in the order and units of its key, with its covariance (3, 3)."""
    over = 1.0 if found.in_volts else FULL_COMMAND
    outward = np.diag(body.mass_kg / over ** np.arange(3.0))
    if not found.in_volts:
        outward = outward[::-1]
    return outward @ found.thrust, outward @ found.covariance[THRUST, THRUST] @ outward.T


def covariances_of(found: FlightFit, body: Body) -> tuple[Covariance, ...]:
    """Return the covariances of the thrust's coefficients, and of both time constants."""
    value, covariance = _of_thrust(found, body)
    return (
        *covariance_between({thrust_key(found): value.tolist()}, covariance),
        *covariance_between({_RISING: found.lag.rising_s, _FALLING: found.lag.falling_s}, found.covariance[LAGS, LAGS]),
    )


def causes_of(
    body: Body, *, in_volts: bool, rescaled: bool
) -> tuple[dict[str, dict[Cause, float]], dict[str, dict[str, float]]]:
    """Return the causes by the unit that they scale, and the powers with which quantities depend on them.

    `rescaled` accelerations have a scale that their firmware took at rest.
    """
    mass = Cause("mass", body.mass_std_kg / body.mass_kg if body.mass_std_kg else None)
    arm = Cause("arm", None if not body.arm_m or body.arm_std_m is None else body.arm_std_m / body.arm_m)
    torque_std = None if not body.torque_m or body.torque_std_m is None else body.torque_std_m / body.torque_m
    torque = Cause("torque over thrust", torque_std)
    inflow = Cause("thrust's fall with inflow", body.inflow_std)
    measured: dict[str, dict[Cause, float]] = {"kg": {mass: 1.0}, "N": {mass: 1.0}, "inflow": {inflow: 1.0}}
    if body.arm_m is not None:
        measured["m"] = {arm: 1.0}
    if body.torque_m is not None:
        measured["N m/N"] = {torque: 1.0}
    if not in_volts:
        measured["sag"] = {Cause("the battery's sag under load", body.load_sag_std): 1.0}
    if rescaled:
        measured["m/s^2"] = {_rescaled(body): 1.0}
    powers = {
        **{MOMENTS[axis]: {"kg": 1.0, "m": 1.0, "m/s^2": 1.0} for axis in ("roll", "pitch")},
        MOMENTS["yaw"]: {"kg": 1.0, "N m/N": 1.0, "m/s^2": 1.0},
        "flight.drag_kg_per_s.*": {"kg": 1.0, "m/s^2": 1.0},
        "flight.drag_over_mass_per_s.*": {"m/s^2": 1.0},
        **{key: {"inflow": power} for key, power in _WITH_INFLOW.items()},
    }
    with_sag = {key: {**powers.get(key, {}), "sag": power} for key, power in _WITH_SAG.items()}
    return measured, {**with_sag, **{key: one for key, one in powers.items() if key not in with_sag}}


def rescaled_thrust(found: FlightFit, body: Body) -> dict[Cause, dict[str, Array]]:
    """Return how a scale that a firmware takes at rest affects thrust: it scales everything except the weight."""
    value, _ = _of_thrust(found, body)
    weight = np.zeros_like(value)
    weight[0 if found.in_volts else -1] = body.mass_kg * USUAL_GRAVITY_MPS2 / len(MOTORS)
    return {_rescaled(body): {thrust_key(found): body.rescaled_std * (value - weight)}}


def _rescaled(body: Body) -> Cause:
    return Cause("the accelerometer's scale", body.rescaled_std)


def drag_quantities(drags: Mapping[str, AxisDrag | None], body: Body) -> dict[str, Parameter]:
    """Return drag over mass, and drag, along the axes with a fit."""
    found = {axis: one for axis, one in drags.items() if one is not None}
    rates = {
        f"flight.drag_over_mass_per_s.{axis}": Parameter(value=one.rate, std=one.std) for axis, one in found.items()
    }
    mass = body.mass_kg
    forces = {
        f"flight.drag_kg_per_s.{axis}": Parameter(value=-mass * one.rate, std=mass * one.std)
        for axis, one in found.items()
    }
    return rates | forces


def given(body: Body) -> dict[str, Parameter]:
    """Return the mass, the arm and the torque over thrust that scale the other quantities, to be stored with them."""
    given = {"flight.mass_kg": Parameter(value=body.mass_kg, std=body.mass_std_kg)}
    if body.torque_m is not None:
        given["flight.torque_m"] = Parameter(value=body.torque_m, std=body.torque_std_m)
    if body.arm_m is not None:
        given["flight.arm_m"] = Parameter(value=body.arm_m, std=body.arm_std_m)
    return given
