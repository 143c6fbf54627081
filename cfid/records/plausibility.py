"""Reject what a platform cannot have: quantities that were found, and numbers that were typed or read."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

from cfid.findings import Finding, note, rejection
from cfid.quantities.plausible import implausible, out_of_range
from cfid.quantities.registry import Platform, Range
from cfid.records.parameters import Parameter, plain
from cfid.records.result import Result
from cfid.records.rig_file import Rig

LARGER_MOTOR = "motor-of-larger-vehicle"  # code: the recording is of a motor too large for a small quadrocopter
_BY_PLATFORM = (
    "implausible",
    "implausible-input",
    "flight-moment-unlike-arm",
)  # codes of what a quadrocopter cannot have
_ALIKE = {  # quantities that rest on the same force, arm, wind or line through stamps
    "motor.thrust_poly": (
        "motor.command_of_thrust", "motor.max_thrust_n", "motor.hover_mass_kg", "motor.thrust_voltage_poly",
        "motor.thrust_per_speed_squared_n_s2", "motor.thrust_speed_poly",
    ),
    "tf.static_gain_n": ("tf.numerator", "tf.series.*.static_gain_n", "tf.series.*.numerator", "tf.frequency_response"),
    "drag.simple_kg_per_rad": ("drag.*",),
    "latency.clock_skew": ("latency.clock_offset_s",),
}  # fmt: skip
_SAYS_NOTHING = "-not-excited"  # ends codes of quantities that a recording does not show at all
_BACKWARDS = "flight-wrong-way"  # the code of a wrong sign, for any platform
_OTHERWISE = 'For another kind of body write platform = "other" under [vehicle] in rig.toml (`cfid new` makes one).'


class Given(NamedTuple):
    """A number that was typed or read, with its name, plausible range and the range's unit."""

    name: str
    number: float
    expected: Range
    unit: str


def judged(result: Result, rig: Rig | None) -> Result:
    """Return a result with a rejection of each quantity that the rig's platform cannot have.

    For the platform `other`, rejections that rest on what a quadrocopter can have are withdrawn. The same holds for a
    recording of a larger motor where no rig states the vehicle.
    """
    own = tuple(one for one in result.findings if one.code not in _BY_PLATFORM)
    larger = rig is None and any(one.code == LARGER_MOTOR for one in result.findings)
    if larger or platform_of(rig) == "other":
        return replace(result, findings=(*own, *_implausible(result.quantities, "other")))
    named = [
        one for one in result.findings if one.code in ("implausible", _BACKWARDS) or one.code.endswith(_SAYS_NOTHING)
    ]
    rest = {key: found for key, found in result.quantities.items() if not any(one.concerns(key) for one in named)}
    return replace(result, findings=(*result.findings, *implausible_quantities(rest, rig)))


def implausible_quantities(quantities: Mapping[str, Parameter], rig: Rig | None) -> tuple[Finding, ...]:
    """Return a rejection of each quantity that the rig's platform cannot have, and of those with the same inputs."""
    return _implausible(quantities, platform_of(rig))


def _implausible(quantities: Mapping[str, Parameter], platform: Platform) -> tuple[Finding, ...]:
    advice = f" {_OTHERWISE}" if platform != "other" else ""
    found: list[Finding] = []
    for key, one in quantities.items():
        measured_to = _measured_to(quantities) if key == "motor.thrust_poly" else None
        fault = implausible(key, plain(one.value), std=plain(one.std), platform=platform, measured_to=measured_to)
        if fault and not any(finding.concerns(key) for finding in found):
            found.append(rejection("implausible", f"{fault}{advice}", key, *_ALIKE.get(key, ())))
    return tuple(found)


def _measured_to(quantities: Mapping[str, Parameter]) -> float | None:
    """Return the largest command at which a motor was measured, None where no table states it."""
    rows = quantities["motor.table"].value if "motor.table" in quantities else ()
    return max((row["cmd"] for row in rows if isfinite(row["cmd"])), default=None)


def implausible_inputs(given: Iterable[Given], rig: Rig | None, *resting: str) -> tuple[Finding, ...]:
    """Return, for each number that the rig's platform cannot have, a rejection of the quantities that rest on it."""
    if platform_of(rig) == "other":
        return ()
    faults = (out_of_range(f"the {one.name} is implausible", one.number, one.expected, one.unit) for one in given)
    return tuple(rejection("implausible-input", f"{fault} {_OTHERWISE}", *resting) for fault in faults if fault)


def implausible_gravity(gravity_mps2: float, *resting: str) -> tuple[Finding, ...]:
    """Return a rejection of the quantities that rest on a gravity found nowhere on earth, whatever the platform."""
    fault = implausible("gravity_mps2", gravity_mps2)
    return (rejection("gravity-implausible", fault, *resting),) if fault else ()


def platform_of(rig: Rig | None) -> Platform:
    """Return the platform that a rig states; without a rig, that of any small quadrocopter."""
    return "crazyflie" if rig is None else rig.vehicle.platform


def taken_as_exact(what: str, *quantities: str) -> Finding:
    """Return the note on a number that was given without a standard uncertainty."""
    text = f"the {what} is taken as exact: it was given without a standard uncertainty (write NUMBER:STD)."
    return note("input-taken-as-exact", text, *quantities)
