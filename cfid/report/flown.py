"""Compare results of flights with results of the rig, over the joint uncertainty."""

from collections.abc import Iterator

import numpy as np
from uncertainties import UFloat

from cfid.quantities.values import ENTRIES
from cfid.records.parameters import Parameter
from cfid.records.values import Quantity, Values
from cfid.report.agreement import Agreement, compared, of_steps, slope_of
from cfid.report.axes import axis_of
from cfid.units import ROTORS
from cfid.wire.app import MIDDLE

_FLOWN = "cfid fit flight"
_MATRIX = "inertia.matrix_kg_m2"
_HIGHEST_V = 10.0  # of a motor: two cells


def flown_agreements(known: Values) -> tuple[Agreement, ...]:
    """Return the comparisons of flights with the rig that a campaign's parameters allow.

    Rejected quantities and quantities without a standard uncertainty are not compared.
    """
    return (*_moments(known), *_thrust(known), *_thrust_over_voltage(known), *_time_constants(known))


def _moments(known: Values) -> Iterator[Agreement]:
    """Compare the moments of inertia, each as seen in flight."""
    matrix, frame = known.accepted(_MATRIX), known.rig.vehicle.body_frame
    for axis, along in (("roll", frame.forward), ("pitch", frame.left), ("yaw", frame.up)):
        moment = known.accepted(f"flight.inertia_kg_m2.{axis}")
        if matrix is not None and moment is not None:
            on_rig = _turned_alone(matrix, axis_of(along)[0])
            if on_rig is not None:
                sides = (_FLOWN, moment.number()), ("cfid fit inertia", on_rig)
                yield from compared(f"Moment of inertia about {axis}", *sides, "kg m^2")


def _turned_alone(inertia: Quantity, axis: int) -> UFloat | None:
    """Return 1 / (J^-1)_ii of the inertia matrix J: a torque about axis i over the angular acceleration about axis i.

    This is what a flight shows, since other torques are not correlated with this one, and the products of inertia turn
    the vehicle about other axes too. With g = J^-1 e_i / (J^-1)_ii, the value is g^T J g, and its derivative with
    respect to J is g g^T. Returns None for a singular matrix.
    """
    matrix = np.array(inertia.parameter.value, dtype=np.float64)
    if not np.linalg.det(matrix) > 0:
        return None
    column = np.linalg.inv(matrix)[axis]
    turning = column / column[axis]
    weights = [turning[i] * turning[j] * (1 if i == j else 2) for i, j in ENTRIES.values()]
    return inertia.number(weights)


def _thrust(known: Values) -> Iterator[Agreement]:
    in_flight, on_rig = (slope_of(known, key) for key in ("flight.thrust_poly", "motor.thrust_poly"))
    if in_flight is not None and on_rig is not None:
        sides = (_FLOWN, in_flight), ("cfid fit thrust", on_rig)
        yield from compared(f"Thrust per command about {MIDDLE:.0f}", *sides, "N")


def _thrust_over_voltage(known: Values) -> Iterator[Agreement]:
    """Compare the thrust at the voltage at which the vehicle hovers, to 0.1 V; a flight shows thrust best there."""
    flown, on_rig = (known.accepted(key) for key in ("flight.thrust_voltage_poly", "motor.thrust_voltage_poly"))
    mass = known.find("flight.mass_kg")
    if flown is None or on_rig is None or mass is None or mass.parameter.value is None:
        return
    held_n = mass.parameter.value * known.rig.site.gravity_mps2 / ROTORS
    volts = _hovering_v(flown.parameter, held_n=held_n)
    if volts is not None:
        sides = (_FLOWN, _at_v(flown, volts)), ("cfid fit thrust", _at_v(on_rig, volts))
        yield from compared(f"Thrust of a rotor at {volts:.1f} V, about hover", *sides, "N")


def _hovering_v(flown: Parameter, *, held_n: float) -> float | None:
    """Return the lowest motor voltage, in steps of 0.1 V, at which a rotor holds `held_n`; None if no voltage does."""
    volts = np.arange(1, 10 * _HIGHEST_V + 1) / 10
    holds = np.polynomial.polynomial.polyval(volts, np.array(flown.value, dtype=np.float64)) >= held_n
    return float(volts[holds.argmax()]) if holds.any() else None


def _at_v(thrust: Quantity, volts: float) -> UFloat:
    """Return the value at a voltage of a map with its lowest power first."""
    return thrust.number([volts**power for power in range(len(thrust.parameter.value))])


def _time_constants(known: Values) -> Iterator[Agreement]:
    """Compare the mean lag with that of sines, which average up and down, and the lags up and down with steps."""
    lag, of_sines = (known.accepted(f"{kind}.time_constant_s") for kind in ("flight", "tf"))
    if lag is not None and of_sines is not None:
        sides = (_FLOWN, lag.number()), ("cfid tf identify", of_sines.number())
        yield from compared("Time constant of motor and rotor", *sides, "s")
    for key, verb, rising in (("flight.rising_s", "speeds up", True), ("flight.falling_s", "slows down", False)):
        one, steps = known.accepted(key), of_steps(known, rising=rising)
        if one is not None and steps is not None:
            sides = (_FLOWN, one.number()), ("cfid fit dynamics", steps)
            yield from compared(f"Time constant of a rotor that {verb}", *sides, "s")
