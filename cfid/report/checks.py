"""Compare the values that different experiments give for one property of the vehicle, over the joint uncertainty.

Causes of uncertainty that both fits share, such as an arm, count once, since they shift both values alike. Rejected
quantities and quantities without a standard uncertainty are not compared.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from uncertainties import UFloat

from cfid.published import axis_of
from cfid.quantities.registry import range_of, registered, unit_of
from cfid.quantities.values import ENTRIES, is_number
from cfid.records.parameters import plain
from cfid.records.uncertain import in_std, measured
from cfid.records.values import Quantity, Values
from cfid.units import ROTORS
from cfid.wire.app import MIDDLE

_LARGEST_IN_STD = 3.0  # standard uncertainties of the difference; beyond it, two values disagree
_PARALLEL = 1e-3  # rad, between the directions of two mounts
_AIR_KG_PER_M3, _AIR_STD = 1.2, 0.1  # the second one is relative: 0 to 30 degrees C, up to 1000 m
_HIGHEST_V = 10.0  # of a motor: two cells
_FLOWN = "cfid fit flight"


class _Pair(NamedTuple):
    """Two values of one property, each with the name of its experiment; the first may exceed the second `at_least`."""

    title: str
    first: str
    first_value: UFloat
    second: str
    second_value: UFloat
    unit: str
    at_least: bool = False


def agreements_of(values: Values) -> list[dict[str, Any]]:
    """Return the comparisons that a campaign's values allow, each with its difference and whether the values agree.

    `in_std` is the difference over its standard uncertainty, `finding` a sentence where the two values disagree.
    """
    pairs = (
        *_gains(values),
        *_hovering_mass(values),
        *_power(values),
        *_scales(values),
        *_time_constants(values),
        *_clocks(values),
        *_distances(values),
        *_flown_moments(values),
        *_flown_thrust(values),
        *_flown_time_constants(values),
    )
    return [agreement for pair in pairs if (agreement := _compared(pair)) is not None]


def _compared(pair: _Pair) -> dict[str, Any] | None:
    """Return a comparison, None where its joint uncertainty is unknown."""
    first, second = pair.first_value, pair.second_value
    difference = first - second
    if not (math.isfinite(difference.nominal_value) and math.isfinite(difference.std_dev) and difference.std_dev > 0):
        return None
    apart = in_std(difference)
    agrees = apart >= -_LARGEST_IN_STD and (pair.at_least or apart <= _LARGEST_IN_STD)
    finding = (
        f"{pair.title}: {pair.first} gives {first.nominal_value:.4g} {pair.unit}, {pair.second} "
        f"{second.nominal_value:.4g} {pair.unit}: {abs(apart):.1f} standard uncertainties of the difference apart "
        f"(limit {_LARGEST_IN_STD:g}). One of the two is wrong: check scales, mounts and battery of both."
    )
    return {
        "title": pair.title,
        "first": pair.first,
        "second": pair.second,
        "unit": pair.unit,
        "first_value": first.nominal_value,
        "first_std": first.std_dev,
        "second_value": second.nominal_value,
        "second_std": second.std_dev,
        "difference": difference.nominal_value,
        "difference_std": difference.std_dev,
        "in_std": apart,
        "at_least": pair.at_least,
        "agrees": agrees,
        "finding": "" if agrees else finding,
    }


def _at(polynomial: Quantity, x: float, *, slope: bool = False) -> UFloat:
    """Return the value of a polynomial at x, or its slope there."""
    powers = list(range(len(polynomial.parameter.value)))
    if not registered(polynomial.key).lowest_first:
        powers.reverse()
    return polynomial.number([power * x ** max(power - 1, 0) if slope else x**power for power in powers])


def _gains(values: Values) -> Iterator[_Pair]:
    """Compare each static gain of the transfer function with the slope of the thrust map at the sines' mean command."""
    thrust = values.accepted("motor.thrust_poly")
    if thrust is None:
        return
    slope = _at(thrust, MIDDLE, slope=True)
    keys = sorted(value.key for value in values if value.key.startswith("tf.series."))
    series = [key for key in keys if key.endswith(".static_gain_n")]
    for key in ("tf.static_gain_n", *(series if len(series) > 1 else ())):
        if (gain := values.accepted(key)) is not None:
            name = key.removeprefix("tf.").removesuffix("static_gain_n").removeprefix("series.").rstrip(".")
            first = f"cfid tf identify{f', {name}' if name else ''}"
            title = f"Thrust per command about {MIDDLE:.0f}"
            yield _Pair(title, first, gain.number(), "cfid fit thrust", slope, unit_of(key))


def _hovering_mass(values: Values) -> Iterator[_Pair]:
    """Compare the mass that four motors hold at full command with the weighed mass; a vehicle that flies holds more."""
    vehicle, held = values.rig.vehicle, values.accepted("motor.hover_mass_kg")
    if held is not None:
        weighed = measured(vehicle.mass_kg, vehicle.mass_std_kg)
        first = "cfid fit thrust, four motors at full command"
        yield _Pair("Mass held, at least that weighed", first, held.number(), "rig.toml", weighed, "kg", True)


def _power(values: Values) -> Iterator[_Pair]:
    """Compare a rotor's torque times its speed with the least power that its thrust can take [Lei].

    No rotor takes less than T^1.5 / sqrt(2 rho A), which reveals speeds or torques that are too small. A rotor without
    a stated radius is assumed to be as large as the platform allows.
    """
    thrust, speed, torque = (values.accepted(f"motor.{name}_poly") for name in ("thrust", "speed", "torque"))
    expected = range_of("rotor_radius_m", values.rig.vehicle.platform)
    if thrust is None or speed is None or torque is None or expected is None:
        return
    thrust_n, speed_rad_s = _at(thrust, MIDDLE), _at(speed, MIDDLE)
    stated = values.find("rotor_radius_m")
    radius_m = expected.largest if stated is None else stated.parameter.value or expected.largest
    if min(thrust_n.nominal_value, speed_rad_s.nominal_value, radius_m) <= 0:
        return
    air_kg_per_m3 = measured(_AIR_KG_PER_M3, _AIR_KG_PER_M3 * _AIR_STD)
    ideal_w = thrust_n**1.5 / (2 * air_kg_per_m3 * math.pi * radius_m**2) ** 0.5
    taken_w = _at(torque, thrust_n.nominal_value) * speed_rad_s
    title, first = f"Power of a rotor at {MIDDLE:.0f}, at least an ideal one's", "cfid fit torque times cfid fit speed"
    yield _Pair(title, first, taken_w, f"the thrust by a rotor of {1e3 * radius_m:.3g} mm", ideal_w, "W", True)


def _scales(values: Values) -> Iterator[_Pair]:
    """Compare the thrust map with scales, by their ratio."""
    quality = values.in_force["thrust"].quality if "thrust" in values.in_force else {}
    gain, std = quality.get("verification_gain"), quality.get("verification_gain_std")
    if is_number(gain) and is_number(std) and std:
        sides = "scales over map", measured(gain, std), "agreement", measured(1.0, 0.0)
        yield _Pair("Thrust by scales over the thrust map", *sides, "1")


def _time_constants(values: Values) -> Iterator[_Pair]:
    """Compare the time constant of steps with that of the transfer function.

    A sine yields a mean of spinning up and down, so the uncertainty is the scatter of the steps, not that of their
    mean.
    """
    steps, lag = _mean_of_steps(values), values.accepted("tf.time_constant_s")
    if steps is not None and lag is not None:
        sides = "cfid fit dynamics, mean of steps", steps, "cfid tf identify", lag.number()
        yield _Pair("Time constant of motor and rotor", *sides, "s")


def _mean_of_steps(values: Values, *, rising: bool | None = None) -> UFloat | None:
    """Return the mean time constant and the scatter of accepted steps: up, down or all; None for fewer than two."""
    steps = values.find("dynamics.time_constant_s")
    rows: list[Any] = plain(steps.parameter.value) if steps is not None and steps.accepted else []
    counting = [row for row in rows if row.get("accepted") and (rising is None or row.get("rising") is rising)]
    if len(counting) < 2:
        return None
    return _with_scatter([row["time_constant_s"] for row in counting], [row["std_s"] or 0.0 for row in counting])


def _with_scatter(values: list[float], stds: list[float]) -> UFloat:
    """Return the mean of values whose scatter and own standard uncertainties both count."""
    scatter = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    return measured(float(np.mean(values)), math.hypot(scatter, float(np.sqrt(np.mean(np.square(stds))))))


def _clocks(values: Values) -> Iterator[_Pair]:
    """Compare the vehicle's clock rate from pings with that from crossings, which may scatter from run to run."""
    pings = values.accepted("latency.clock_skew")
    series = values.in_force["tf"].quality.get("series") if "tf" in values.in_force else None
    tables = [table for table in series.values() if isinstance(table, Mapping)] if isinstance(series, Mapping) else []
    columns = [(table.get("clock_skew"), table.get("clock_skew_std")) for table in tables]
    skews = [
        (skew, std)
        for of_runs, stds in columns
        if isinstance(of_runs, list) and isinstance(stds, list)
        for skew, std in zip(of_runs, stds, strict=False)
        if is_number(skew) and is_number(std) and abs(skew) < 1 and 0 <= std < 1
    ]
    if pings is not None and skews:
        crossings = _with_scatter([skew for skew, _ in skews], [std for _, std in skews])
        sides = "cfid tf latency", pings.number(), "cfid tf identify, crossings", crossings
        yield _Pair("Rate of the vehicle's clock, less one", *sides, "1")


def _distances(values: Values) -> Iterator[_Pair]:
    """Compare the inertias about the centre of mass from two mounts along the same axis."""
    mounts = values.rig.mounts
    along = {name: np.array(mount.direction) / math.hypot(*mount.direction) for name, mount in mounts.items()}
    for first, second in combinations(mounts, 2):
        if np.linalg.norm(np.cross(along[first], along[second])) < _PARALLEL:
            near, far = (values.accepted(f"inertia.centre_kg_m2.{mount}") for mount in (first, second))
            if near is not None and far is not None:
                sides = f"mount {first}", near.number(), f"mount {second}", far.number()
                yield _Pair("Inertia about one axis by two distances", *sides, unit_of(near.key))


def _flown_moments(values: Values) -> Iterator[_Pair]:
    """Compare the moments of inertia, each as seen in flight."""
    matrix, frame = values.accepted("inertia.matrix_kg_m2"), values.rig.vehicle.body_frame
    for name, axis in (("roll", frame.forward), ("pitch", frame.left), ("yaw", frame.up)):
        flown = values.accepted(f"flight.inertia_kg_m2.{name}")
        on_rig = None if matrix is None else _turned_alone(matrix, axis_of(axis)[0])
        if flown is not None and on_rig is not None:
            sides = _FLOWN, flown.number(), "cfid fit inertia", on_rig
            yield _Pair(f"Moment of inertia about {name}", *sides, "kg m^2")


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
    return inertia.number([turning[i] * turning[j] * (1 if i == j else 2) for i, j in ENTRIES.values()])


def _flown_thrust(values: Values) -> Iterator[_Pair]:
    """Compare the thrust per command, and the thrust at the voltage at which the vehicle hovers, to 0.1 V.

    A flight shows the thrust best there; a map that never holds the vehicle is not compared.
    """
    flown, on_rig = (values.accepted(f"{experiment}.thrust_poly") for experiment in ("flight", "motor"))
    if flown is not None and on_rig is not None:
        slopes = _FLOWN, _at(flown, MIDDLE, slope=True), "cfid fit thrust", _at(on_rig, MIDDLE, slope=True)
        yield _Pair(f"Thrust per command about {MIDDLE:.0f}", *slopes, "N")
    flown, on_rig = (values.accepted(f"{experiment}.thrust_voltage_poly") for experiment in ("flight", "motor"))
    mass = values.find("flight.mass_kg")
    if flown is None or on_rig is None or mass is None or mass.parameter.value is None:
        return
    held_n = mass.parameter.value * values.rig.site.gravity_mps2 / ROTORS
    volts = np.arange(1, 10 * _HIGHEST_V + 1) / 10
    holds = np.polynomial.polynomial.polyval(volts, np.array(flown.parameter.value, dtype=np.float64)) >= held_n
    if holds.any():
        volt = float(volts[holds.argmax()])
        sides = _FLOWN, _at(flown, volt), "cfid fit thrust", _at(on_rig, volt)
        yield _Pair(f"Thrust of a rotor at {volt:.1f} V, about hover", *sides, "N")


def _flown_time_constants(values: Values) -> Iterator[_Pair]:
    """Compare the mean lag with that of sines, which average up and down, and the lags up and down with steps."""
    lag, of_sines = (values.accepted(f"{experiment}.time_constant_s") for experiment in ("flight", "tf"))
    if lag is not None and of_sines is not None:
        sides = _FLOWN, lag.number(), "cfid tf identify", of_sines.number()
        yield _Pair("Time constant of motor and rotor", *sides, "s")
    for key, verb, rising in (("flight.rising_s", "speeds up", True), ("flight.falling_s", "slows down", False)):
        flown, steps = values.accepted(key), _mean_of_steps(values, rising=rising)
        if flown is not None and steps is not None:
            sides = _FLOWN, flown.number(), "cfid fit dynamics", steps
            yield _Pair(f"Time constant of a rotor that {verb}", *sides, "s")
