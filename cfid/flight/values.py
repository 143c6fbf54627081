"""Convert flights' quantities to their units, with covariances and their dependence on mass, arm and torque."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.common_causes import Cause
from cfid.estimate.linear import std_of
from cfid.flight.braking import AxisDrag
from cfid.flight.estimation import FlightFit
from cfid.flight.model import DELAYS, LAGS, THRUST, TURNS
from cfid.flight.rows import AXES, LEVER
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.units import FULL_COMMAND, MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

RESTS_ON = ("vehicle.mass_kg", "vehicle.mass_std_kg", "loadcell.arm_mm", "loadcell.arm_std_mm")
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
# to 15 % less than that of one rotor against another, which turns the vehicle.
LOAD_SAG_STD = 0.08
# A Crazyflie's firmware divides accelerations by the mean of 200 samples at rest (processAccScale), which includes the
# zero error: 0.02 g of it (see `estimation`) become a scale of everything except the weight itself.
RESCALED_STD = 0.02
# Thrust falls by k times the speed of the air along the rotor's axis. Simulated flights with k of 0.03, 0.06 and 0.08
# s/m (a propeller without thrust at 12 m/s) gave a falling lag that was too long by 1.6, 2.7 and 3.3 %, a rising one
# that was too short by half as much, and a mean of both that was too long by 0.4 times as much.
INFLOW_STD = 0.02
# The powers with which quantities depend on the units of the causes.
_POWERS = {
    _RISING: {"inflow": -0.5, "sag": 0.25},
    _FALLING: {"inflow": 1.0, "sag": 0.25},
    _MEAN: {"inflow": 0.4, "sag": 0.25},
    SINGLE: {"inflow": 0.4, "sag": 0.25},
    MOMENTS["roll"]: {"kg": 1.0, "m": 1.0, "m/s^2": 1.0, "sag": 1.0},
    MOMENTS["pitch"]: {"kg": 1.0, "m": 1.0, "m/s^2": 1.0, "sag": 1.0},
    MOMENTS["yaw"]: {"kg": 1.0, "N m/N": 1.0, "m/s^2": 1.0, "sag": 1.0},
    "flight.drag_kg_per_s.*": {"kg": 1.0, "m/s^2": 1.0},
    "flight.drag_over_mass_per_s.*": {"m/s^2": 1.0},
}


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


def thrust_key(fit: FlightFit) -> str:
    """Return the key of the thrust, as a function of the motor's voltage or of the command."""
    return "flight.thrust_voltage_poly" if fit.in_volts else "flight.thrust_poly"


def lever_m(axis: str, body: Body) -> float | None:
    """Return a rotor's moment about an axis divided by its thrust, None where it is unknown."""
    if axis == "yaw":
        return body.torque_m
    return None if body.arm_m is None else LEVER * body.arm_m


def times_of(fit: FlightFit) -> dict[str, tuple[float, float]]:
    """Return the time constants, the gyro's delay and sums of them in s, each with its standard uncertainty."""
    times = np.array(list(_TIMES.values()))
    stds = std_of(times @ fit.covariance[: DELAYS.stop, : DELAYS.stop] @ times.T)
    values = times @ fit.values[: DELAYS.stop]
    return {key: (float(value), float(std)) for key, value, std in zip(_TIMES, values, stds, strict=True)}


def quantities_of(fit: FlightFit, drags: Mapping[str, AxisDrag | None], body: Body) -> dict[str, Parameter]:
    """Return thrust, times, moments with a known lever, and drag; mass, arm and torque are taken as exact."""
    value, covariance = _thrust(fit, body)
    quantities = {
        thrust_key(fit): Parameter(value=value.tolist(), std=std_of(covariance).tolist()),
        **{key: Parameter(value=value_s, std=std_s) for key, (value_s, std_s) in times_of(fit).items()},
    }
    for axis, gain, gain_std in zip(AXES, fit.values[TURNS].tolist(), fit.std[TURNS].tolist(), strict=True):
        lever = lever_m(axis, body)
        if lever is not None and gain != 0:  # a gyro that is stuck shows no rotation
            moment = lever * body.mass_kg / gain
            quantities[MOMENTS[axis]] = Parameter(value=moment, std=abs(moment * gain_std / gain))
    return quantities | drag_quantities(drags, body)


def drag_quantities(drags: Mapping[str, AxisDrag | None], body: Body) -> dict[str, Parameter]:
    """Return drag over mass, and drag with the mass taken as exact."""
    quantities = {}
    for key, factor in (("flight.drag_over_mass_per_s", 1.0), ("flight.drag_kg_per_s", -body.mass_kg)):
        for axis, drag in drags.items():
            if drag is not None:
                quantities[f"{key}.{axis}"] = Parameter(value=factor * drag.rate, std=abs(factor) * drag.std)
    return quantities


def given(body: Body) -> dict[str, Parameter]:
    """Return the mass, the arm and the torque over thrust that scale the other quantities, to be stored with them."""
    stated = {"flight.mass_kg": Parameter(value=body.mass_kg, std=body.mass_std_kg)}
    if body.torque_m is not None:
        stated["flight.torque_m"] = Parameter(value=body.torque_m, std=body.torque_std_m)
    if body.arm_m is not None:
        stated["flight.arm_m"] = Parameter(value=body.arm_m, std=body.arm_std_m)
    return stated


def covariances_of(fit: FlightFit, body: Body) -> tuple[Covariance, ...]:
    """Return the covariances of the thrust's coefficients, and of both time constants."""
    value, covariance = _thrust(fit, body)
    return (
        *covariance_between({thrust_key(fit): value.tolist()}, covariance),
        *covariance_between({_RISING: fit.lag.rising_s, _FALLING: fit.lag.falling_s}, fit.covariance[LAGS, LAGS]),
    )


def causes_of(
    body: Body, *, in_volts: bool, rescaled: bool
) -> tuple[dict[str, dict[Cause, float]], dict[str, dict[str, float]]]:
    """Return the causes by the unit that they scale, and the powers with which quantities depend on them.

    `rescaled` accelerations have a scale that their firmware took at rest.
    """

    def share(value: float | None, std: float | None) -> float | None:
        return std / value if value and std is not None else None

    mass = Cause("mass", share(body.mass_kg, body.mass_std_kg or None))
    causes = {"kg": {mass: 1.0}, "N": {mass: 1.0}, "inflow": {Cause("thrust's fall with inflow", body.inflow_std): 1.0}}
    if body.arm_m is not None:
        causes["m"] = {Cause("arm", share(body.arm_m, body.arm_std_m)): 1.0}
    if body.torque_m is not None:
        causes["N m/N"] = {Cause("torque over thrust", share(body.torque_m, body.torque_std_m)): 1.0}
    if not in_volts:
        causes["sag"] = {Cause("the battery's sag under load", body.load_sag_std): 1.0}
    if rescaled:
        causes["m/s^2"] = {_rescaled(body): 1.0}
    return causes, _POWERS


def rescaled_thrust(fit: FlightFit, body: Body) -> dict[Cause, dict[str, Array]]:
    """Return how a scale that a firmware takes at rest affects thrust: it scales everything except the weight."""
    value, _ = _thrust(fit, body)
    weight = np.zeros_like(value)
    weight[0 if fit.in_volts else -1] = body.mass_kg * USUAL_GRAVITY_MPS2 / len(MOTORS)
    return {_rescaled(body): {thrust_key(fit): body.rescaled_std * (value - weight)}}


def _rescaled(body: Body) -> Cause:
    return Cause("the accelerometer's scale", body.rescaled_std)


def _thrust(fit: FlightFit, body: Body) -> tuple[Array, Array]:
    """Return one rotor's thrust polynomial (3,) in the order and units of its key, with its covariance (3, 3)."""
    over = 1.0 if fit.in_volts else FULL_COMMAND
    outward = np.diag(body.mass_kg / over ** np.arange(3.0))
    if not fit.in_volts:
        outward = outward[::-1]
    return outward @ fit.thrust, outward @ fit.covariance[THRUST, THRUST] @ outward.T
