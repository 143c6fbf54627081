"""Compare the values that different experiments give for one property of the vehicle, over the joint uncertainty.

Causes of uncertainty that both fits share, such as an arm, count once, since they shift both values alike.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from uncertainties import UFloat

from cfid.findings import Finding, warning
from cfid.quantities.registry import range_of, unit_of
from cfid.quantities.values import is_number
from cfid.records.fits import Fit
from cfid.records.parameters import plain
from cfid.records.rig_file import Rig
from cfid.records.uncertain import in_std, measured
from cfid.records.values import Quantity, Values
from cfid.wire.app import MIDDLE

LARGEST_IN_STD = 3.0  # standard uncertainties of the difference; beyond it, two values disagree
_PARALLEL = 1e-3  # rad, between the directions of two mounts
_AIR_KG_PER_M3, _AIR_STD = 1.2, 0.1  # the second one is relative: 0 to 30 degrees C, up to 1000 m


@dataclass(frozen=True)
class Agreement:
    """Two values of one property with their standard uncertainties, their difference, and whether they agree.

    `at_least` is true where the first value may exceed the second. `in_std` is the difference over its standard
    uncertainty.
    """

    title: str
    first: str
    second: str
    unit: str
    first_value: float
    first_std: float
    second_value: float
    second_std: float
    difference: float
    difference_std: float
    in_std: float
    at_least: bool = False

    @property
    def agrees(self) -> bool:
        """Whether the two values agree."""
        return self.in_std >= -LARGEST_IN_STD and (self.at_least or self.in_std <= LARGEST_IN_STD)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A warning where the two values disagree."""
        if self.agrees:
            return ()
        text = (
            f"{self.title}: {self.first} gives {self.first_value:.4g} {self.unit}, {self.second} "
            f"{self.second_value:.4g} {self.unit}: {abs(self.in_std):.1f} standard uncertainties of the difference "
            f"apart (limit {LARGEST_IN_STD:g}). One of the two is wrong: check scales, mounts and battery of both."
        )
        return (warning("experiments-disagree", text),)


def agreements_of(known: Values, held: Mapping[str, Fit]) -> tuple[Agreement, ...]:
    """Return the comparisons that a campaign's values allow; `held` has the fits in force.

    Rejected quantities and quantities without a standard uncertainty are not compared.
    """
    return (
        *_gains(known),
        *_hovering(known),
        *_power(known),
        *_scales(held),
        *_time_constants(known),
        *_clocks(known, held),
        *_distances(known),
    )


def _gains(known: Values) -> Iterator[Agreement]:
    """Compare each static gain of the transfer function with the slope of the thrust map at the sines' mean command."""
    map_slope = slope_of(known, "motor.thrust_poly")
    if map_slope is None:
        return
    series = sorted(value.key for value in known if _is_series_gain(value.key))
    for key in ("tf.static_gain_n", *(series if len(series) > 1 else ())):
        if (gain := known.accepted(key)) is not None:
            name = key.removeprefix("tf.").removesuffix("static_gain_n").removeprefix("series.").rstrip(".")
            first = f"cfid tf identify{f', {name}' if name else ''}"
            title = f"Thrust per command about {MIDDLE:.0f}"
            yield from compared(title, (first, gain.number()), ("cfid fit thrust", map_slope), unit_of(key))


def slope_of(known: Values, key: str) -> UFloat | None:
    """Return the slope of an accepted thrust map at the sines' mean command, None without such a map."""
    thrust = known.accepted(key)
    if thrust is None:
        return None
    powers = range(len(thrust.parameter.value) - 1, -1, -1)
    return thrust.number([power * MIDDLE ** max(power - 1, 0) for power in powers])


def _is_series_gain(key: str) -> bool:
    return key.startswith("tf.series.") and key.endswith(".static_gain_n")


def _hovering(known: Values) -> Iterator[Agreement]:
    """Compare the mass that four motors hold at full command with the weighed mass; a vehicle that flies holds more."""
    held = known.accepted("motor.hover_mass_kg")
    if held is None:
        return
    vehicle = known.rig.vehicle
    weighed = measured(vehicle.mass_kg, vehicle.mass_std_kg)
    first = ("cfid fit thrust, four motors at full command", held.number())
    yield from compared("Mass held, at least that weighed", first, ("rig.toml", weighed), "kg", at_least=True)


def _power(known: Values) -> Iterator[Agreement]:
    """Compare a rotor's torque times its speed with the least power that its thrust can take [Lei].

    No rotor takes less than T^1.5 / sqrt(2 rho A), which reveals speeds or torques that are too small. A rotor without
    a stated radius is assumed to be as large as the platform allows.
    """
    names = ("motor.thrust_poly", "motor.speed_poly", "motor.torque_poly")
    maps = [found for name in names if (found := known.accepted(name)) is not None]
    expected = range_of("rotor_radius_m", known.rig.vehicle.platform)
    if len(maps) < len(names) or expected is None:
        return
    thrust, speed, torque = maps
    force, turning = _at(thrust, MIDDLE), _at(speed, MIDDLE)
    stated = known.find("rotor_radius_m")
    radius_m = expected.largest if stated is None else stated.parameter.value or expected.largest
    if min(force.nominal_value, turning.nominal_value, radius_m) <= 0:
        return
    air_kg_per_m3 = measured(_AIR_KG_PER_M3, _AIR_KG_PER_M3 * _AIR_STD)
    ideal_w = force**1.5 / (2 * air_kg_per_m3 * math.pi * radius_m**2) ** 0.5
    first = ("cfid fit torque times cfid fit speed", _at(torque, force.nominal_value) * turning)
    second = (f"the thrust by a rotor of {1e3 * radius_m:.3g} mm", ideal_w)
    title = f"Power of a rotor at {MIDDLE:.0f}, at least an ideal one's"
    yield from compared(title, first, second, "W", at_least=True)


def _at(map_over_x: Quantity, x: float) -> UFloat:
    """Return the value at x of a map with its highest power first."""
    return map_over_x.number([x**power for power in range(len(map_over_x.parameter.value) - 1, -1, -1)])


def _scales(held: Mapping[str, Fit]) -> Iterator[Agreement]:
    """Compare the thrust map with scales, by their ratio."""
    quality = held["thrust"].quality if "thrust" in held else {}
    gain, std = quality.get("verification_gain"), quality.get("verification_gain_std")
    if not (is_number(gain) and is_number(std) and std):
        return
    sides = ("scales over map", measured(gain, std)), ("agreement", measured(1.0, 0.0))
    yield from compared("Thrust by scales over the thrust map", *sides, "1")


def _time_constants(known: Values) -> Iterator[Agreement]:
    """Compare the time constant of steps with that of the transfer function.

    A sine yields a mean of spinning up and down, so the uncertainty is the scatter of the steps, not that of their
    mean.
    """
    steps, lag = of_steps(known), known.accepted("tf.time_constant_s")
    if steps is not None and lag is not None:
        sides = ("cfid fit dynamics, mean of steps", steps), ("cfid tf identify", lag.number())
        yield from compared("Time constant of motor and rotor", *sides, "s")


def of_steps(known: Values, *, rising: bool | None = None) -> UFloat | None:
    """Return the mean time constant and the scatter of accepted steps: up, down or all; None for fewer than two."""
    steps = known.find("dynamics.time_constant_s")
    if steps is None or not steps.accepted:
        return None
    rows: Sequence[Mapping[str, Any]] = [
        row
        for row in plain(steps.parameter.value)
        if row.get("accepted") and (rising is None or row.get("rising") is rising)
    ]
    if len(rows) < 2:
        return None
    values = np.array([row["time_constant_s"] for row in rows], dtype=np.float64)
    stds = np.array([row["std_s"] or 0.0 for row in rows], dtype=np.float64)
    return measured(float(values.mean()), math.hypot(values.std(ddof=1), float(np.sqrt(np.mean(stds**2)))))


def _clocks(known: Values, held: Mapping[str, Fit]) -> Iterator[Agreement]:
    """Compare the vehicle's clock rate from pings with that from crossings, which may scatter from run to run."""
    pings = known.accepted("latency.clock_skew")
    skews = _skews(held["tf"].quality.get("series")) if "tf" in held else []
    if pings is None or not skews:
        return
    values, stds = np.array(skews).T
    scatter = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    of_runs = measured(float(values.mean()), math.hypot(scatter, float(np.sqrt(np.mean(stds**2)))))
    sides = ("cfid tf latency", pings.number()), ("cfid tf identify, crossings", of_runs)
    yield from compared("Rate of the vehicle's clock, less one", *sides, "1")


def _skews(series: Any) -> list[tuple[float, float]]:
    """Return the clock skews of all series with their standard uncertainties; none for content of another form."""
    tables = [one for one in series.values() if isinstance(one, Mapping)] if isinstance(series, Mapping) else []
    columns = [(one.get("clock_skew"), one.get("clock_skew_std")) for one in tables]
    return [
        (skew, std)
        for skews, stds in columns
        if isinstance(skews, list) and isinstance(stds, list)
        for skew, std in zip(skews, stds, strict=False)
        if is_number(skew) and is_number(std) and abs(skew) < 1 and 0 <= std < 1
    ]


def _distances(known: Values) -> Iterator[Agreement]:
    """Compare the inertias about the centre of mass from two mounts along the same axis."""
    key = "inertia.centre_kg_m2"
    for first, second in _parallel_mounts(known.rig):
        one, other = (known.accepted(f"{key}.{mount}") for mount in (first, second))
        if one is not None and other is not None:
            sides = (f"mount {first}", one.number()), (f"mount {second}", other.number())
            yield from compared("Inertia about one axis by two distances", *sides, unit_of(f"{key}.{first}"))


def _parallel_mounts(rig: Rig) -> Iterator[tuple[str, str]]:
    directions = {name: np.array(mount.direction) / math.hypot(*mount.direction) for name, mount in rig.mounts.items()}
    names = list(directions)
    for place, first in enumerate(names):
        for second in names[place + 1 :]:
            if np.linalg.norm(np.cross(directions[first], directions[second])) < _PARALLEL:
                yield first, second


def compared(
    title: str, first: tuple[str, UFloat], second: tuple[str, UFloat], unit: str, *, at_least: bool = False
) -> Iterator[Agreement]:
    """Yield a comparison, unless its joint uncertainty is unknown."""
    (first_name, one), (second_name, other) = first, second
    apart = one - other
    if not (math.isfinite(apart.nominal_value) and math.isfinite(apart.std_dev) and apart.std_dev > 0):
        return
    yield Agreement(
        title=title,
        first=first_name,
        second=second_name,
        unit=unit,
        first_value=one.nominal_value,
        first_std=one.std_dev,
        second_value=other.nominal_value,
        second_std=other.std_dev,
        difference=apart.nominal_value,
        difference_std=apart.std_dev,
        in_std=in_std(apart),
        at_least=at_least,
    )
