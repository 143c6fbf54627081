"""Compare the values that different experiments give for one property of the vehicle, over the joint uncertainty.

Causes of uncertainty that both fits share, such as an arm, count once, since they shift both values alike. Rejected
quantities and quantities without a standard uncertainty are not compared.
"""

import math
from collections.abc import Iterator
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from uncertainties import UFloat

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


class _Pair(NamedTuple):
    """Two values of one property, each with the name of its experiment.

    Where the first is `at_least` as large as the second, it may exceed it.
    """

    title: str
    unit: str
    first: tuple[str, UFloat | None]
    second: tuple[str, UFloat | None]
    at_least: bool = False


def agreements_of(values: Values) -> list[dict[str, Any]]:
    """Return the comparisons that a campaign's values allow, each with its difference and whether the values agree.

    `in_std` is the difference over its standard uncertainty, `finding` a sentence where the two values disagree.
    """
    agreements = [_compared(pair) for pair in _pairs(values)]
    return [agreement for agreement in agreements if agreement is not None]


def _pairs(values: Values) -> Iterator[_Pair]:
    """Yield the pairs to compare, in the order of the experiments; a value is None where it is unknown."""
    tf, flight, thrust_map = "cfid tf identify", "cfid fit flight", "cfid fit thrust"
    per_command, lag = f"Thrust per command about {MIDDLE:.0f}", "Time constant of motor and rotor"
    slope, sines = _slope(values, "motor.thrust_poly"), _number(values, "tf.time_constant_s")
    for key in _gain_keys(values):
        series = key.removeprefix("tf.").removesuffix("static_gain_n").removeprefix("series.").rstrip(".")
        first = f"{tf}, {series}" if series else tf
        yield _Pair(per_command, unit_of(key), (first, _number(values, key)), (thrust_map, slope))
    vehicle = values.rig.vehicle
    held = thrust_map, _number(values, "motor.hover_mass_kg")
    weighed = "weighing (rig.toml)", measured(vehicle.mass_kg, vehicle.mass_std_kg)
    yield _Pair("Mass held by four motors at full command", "kg", held, weighed, at_least=True)
    yield from _power(values)
    scales = "cfid fit thrust --verify", _scales_over_map(values)
    yield _Pair("Thrust by scales over the thrust map", "1", scales, ("definition", measured(1.0, 0.0)))
    # A sine yields a mean of spinning up and down.
    yield _Pair(lag, "s", ("the mean of steps of cfid fit dynamics", _mean_of_steps(values)), (tf, sines))
    pings, crossings = _number(values, "latency.clock_skew"), _skew(values)
    by_pings, by_crossings = ("cfid tf latency", pings), (f"the crossings of {tf}", crossings)
    yield _Pair("Rate of the vehicle's clock, relative error", "1", by_pings, by_crossings)
    for mounts in combinations(values.rig.mounts, 2):
        if _are_parallel(values, *mounts):
            near, far = ((f"mount {mount}", _number(values, f"inertia.centre_kg_m2.{mount}")) for mount in mounts)
            yield _Pair("Inertia about one axis by two distances", "kg m^2", near, far)
    for name, (axis, _) in zip(("roll", "pitch", "yaw"), vehicle.body_frame.axes, strict=True):
        flown = flight, _number(values, f"flight.inertia_kg_m2.{name}")
        yield _Pair(f"Moment of inertia about {name}", "kg m^2", flown, ("cfid fit inertia", _moment(values, axis)))
    yield _Pair(per_command, "N", (flight, _slope(values, "flight.thrust_poly")), (thrust_map, slope))
    yield from _thrust_in_hover(values)
    yield _Pair(lag, "s", (flight, _number(values, "flight.time_constant_s")), (tf, sines))
    for key, verb, rising in (("flight.rising_s", "speeds up", True), ("flight.falling_s", "slows down", False)):
        steps = "cfid fit dynamics", _mean_of_steps(values, rising=rising)
        yield _Pair(f"Time constant of a rotor that {verb}", "s", (flight, _number(values, key)), steps)


def _compared(pair: _Pair) -> dict[str, Any] | None:
    """Return a comparison, None where a value or the joint uncertainty is unknown."""
    (first_name, first), (second_name, second) = pair.first, pair.second
    if first is None or second is None:
        return None
    difference = first - second
    if not (math.isfinite(difference.nominal_value) and math.isfinite(difference.std_dev) and difference.std_dev > 0):
        return None
    apart = in_std(difference)
    agrees = apart >= -_LARGEST_IN_STD and (pair.at_least or apart <= _LARGEST_IN_STD)
    finding = (
        f"{pair.title}: {first_name} gives {first.nominal_value:.4g} {pair.unit}, {second_name} "
        f"{second.nominal_value:.4g} {pair.unit}: {abs(apart):.1f} standard uncertainties of the difference apart "
        f"(limit {_LARGEST_IN_STD:g}). One of the two is wrong: check scales, mounts and battery of both."
    )
    return {
        "title": pair.title,
        "first": first_name,
        "second": second_name,
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


def _number(values: Values, key: str) -> UFloat | None:
    quantity = values.accepted(key)
    return None if quantity is None else quantity.number()


def _slope(values: Values, key: str) -> UFloat | None:
    """Return the slope of a thrust map at the sines' mean command."""
    quantity = values.accepted(key)
    return None if quantity is None else _at(quantity, MIDDLE, slope=True)


def _at(polynomial: Quantity, x: float, *, slope: bool = False) -> UFloat:
    """Return the value of a polynomial at x, or its slope there."""
    powers = list(range(len(polynomial.parameter.value)))
    if not registered(polynomial.key).lowest_first:
        powers.reverse()
    return polynomial.number([power * x ** max(power - 1, 0) if slope else x**power for power in powers])


def _gain_keys(values: Values) -> list[str]:
    """Return the keys of the static gains: that of all series, and of several series each."""
    series = [value.key for value in values if value.key.startswith("tf.series.")]
    gains = sorted(key for key in series if key.endswith(".static_gain_n"))
    return ["tf.static_gain_n", *(gains if len(gains) > 1 else ())]


def _power(values: Values) -> Iterator[_Pair]:
    """Compare a rotor's torque times its speed with the least power that its thrust can take [Lei].

    No rotor takes less than T^1.5 / sqrt(2 rho A), which reveals speeds or torques that are too small. A rotor without
    a stated radius is assumed to be as large as the platform allows.
    """
    thrust, speed, torque = (values.accepted(f"motor.{name}_poly") for name in ("thrust", "speed", "torque"))
    expected, stated = range_of("rotor_radius_m", values.rig.vehicle.platform), values.find("rotor_radius_m")
    if thrust is None or speed is None or torque is None or expected is None:
        return
    thrust_n, speed_rad_s = _at(thrust, MIDDLE), _at(speed, MIDDLE)
    radius_m = (None if stated is None else stated.parameter.value) or expected.largest
    if min(thrust_n.nominal_value, speed_rad_s.nominal_value, radius_m) > 0:
        air_kg_per_m3 = measured(_AIR_KG_PER_M3, _AIR_KG_PER_M3 * _AIR_STD)
        ideal_w = thrust_n**1.5 / (2 * air_kg_per_m3 * math.pi * radius_m**2) ** 0.5
        first = "cfid fit torque times cfid fit speed", _at(torque, thrust_n.nominal_value) * speed_rad_s
        second = f"an ideal rotor of {1e3 * radius_m:.3g} mm with this thrust", ideal_w
        yield _Pair(f"Power of a rotor at command {MIDDLE:.0f}", "W", first, second, at_least=True)


def _scales_over_map(values: Values) -> UFloat | None:
    quality = values.in_force["thrust"].quality if "thrust" in values.in_force else {}
    gain, std = quality.get("verification_gain"), quality.get("verification_gain_std")
    return measured(gain, std) if is_number(gain) and is_number(std) and std else None


def _mean_of_steps(values: Values, *, rising: bool | None = None) -> UFloat | None:
    """Return the mean time constant and the scatter of accepted steps: up, down or all; None for fewer than two."""
    steps = values.find("dynamics.time_constant_s")
    rows: Any = plain(steps.parameter.value) if steps is not None and steps.accepted else []
    counting = [row for row in rows if row.get("accepted") and (rising is None or row.get("rising") is rising)]
    if len(counting) < 2:
        return None
    return _with_scatter([row["time_constant_s"] for row in counting], [row["std_s"] or 0.0 for row in counting])


def _with_scatter(values: list[float], stds: list[float]) -> UFloat:
    """Return the mean of values whose scatter and own standard uncertainties both count."""
    scatter = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    return measured(float(np.mean(values)), math.hypot(scatter, float(np.sqrt(np.mean(np.square(stds))))))


def _skew(values: Values) -> UFloat | None:
    """Return the rate of the vehicle's clock from crossings, which may scatter from run to run."""
    series: Any = values.in_force["tf"].quality.get("series", {}) if "tf" in values.in_force else {}
    skews = [
        (skew, std)
        for table in series.values()
        for skew, std in zip(table.get("clock_skew") or (), table.get("clock_skew_std") or (), strict=False)
        if is_number(skew) and is_number(std)
    ]
    return _with_scatter([skew for skew, _ in skews], [std for _, std in skews]) if skews else None


def _are_parallel(values: Values, first: str, second: str) -> bool:
    one, other = (np.array(values.rig.mounts[mount].direction, dtype=np.float64) for mount in (first, second))
    return bool(np.linalg.norm(np.cross(one, other)) < _PARALLEL * np.linalg.norm(one) * np.linalg.norm(other))


def _moment(values: Values, axis: int) -> UFloat | None:
    """Return 1 / (J^-1)_ii of the inertia matrix J: a torque about axis i over the angular acceleration about axis i.

    This is what a flight shows, since other torques are not correlated with this one, and the products of inertia turn
    the vehicle about other axes too. With g = J^-1 e_i / (J^-1)_ii, the value is g^T J g, and its derivative with
    respect to J is g g^T. Returns None for a singular matrix.
    """
    inertia = values.accepted("inertia.matrix_kg_m2")
    matrix = np.zeros((3, 3)) if inertia is None else np.array(inertia.parameter.value, dtype=np.float64)
    if inertia is None or not np.linalg.det(matrix) > 0:
        return None
    column = np.linalg.inv(matrix)[axis]
    turning = column / column[axis]
    return inertia.number([turning[i] * turning[j] * (1 if i == j else 2) for i, j in ENTRIES.values()])


def _thrust_in_hover(values: Values) -> Iterator[_Pair]:
    """Compare the thrust at the voltage at which the vehicle hovers, to 0.1 V; a flight shows thrust best there."""
    flown, on_rig = (values.accepted(f"{experiment}.thrust_voltage_poly") for experiment in ("flight", "motor"))
    mass = values.find("flight.mass_kg")
    if flown is None or on_rig is None or mass is None or mass.parameter.value is None:
        return
    held_n = mass.parameter.value * values.rig.site.gravity_mps2 / ROTORS
    volts = np.arange(1, 10 * _HIGHEST_V + 1) / 10
    holds = np.polynomial.polynomial.polyval(volts, np.array(flown.parameter.value, dtype=np.float64)) >= held_n
    if holds.any():
        volt = float(volts[holds.argmax()])
        sides = ("cfid fit flight", _at(flown, volt)), ("cfid fit thrust", _at(on_rig, volt))
        yield _Pair(f"Thrust of a rotor at {volt:.1f} V, about hover", "N", *sides)
