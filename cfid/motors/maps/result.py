"""From points to motor maps as a result: quantities, inverse, voltage form, thrust over speed, scales, figures."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cfid.errors import FitError
from cfid.estimate.common_causes import (
    force_scales,
    power_law,
    tachometer_scales,
    thrust_in_torque,
    torque_scales,
    with_common_causes,
)
from cfid.findings import Finding, explained, rejection
from cfid.motors.maps import estimation, values
from cfid.motors.maps.data import Points, evidence_of
from cfid.motors.maps.estimation import GIVEN_BY, OVER_SPEED, Method, MotorMap, Order, SpeedThrustMap
from cfid.motors.maps.evidence import Evidence, Stand
from cfid.motors.maps.inverse import invert, maximum_thrust, on_battery
from cfid.motors.maps.scales import ScalesCheck
from cfid.motors.maps.voltage import KEY, VoltageComparison, compare_thrust
from cfid.motors.maps.weighing import verified
from cfid.motors.vibration.data import Rotors
from cfid.records.covariances import Covariance
from cfid.records.parameters import Parameter
from cfid.records.plausibility import implausible_gravity
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import RigFacts
from cfid.units import ROTORS, USUAL_GRAVITY_MPS2

_POWERS = {
    "motor.max_thrust_n": {"N": 1},
    "motor.hover_mass_kg": {"N": 1},
    "motor.thrust_per_speed_squared_n_s2": {"N": 1, "rad/s": -2},
}
_MOST_PAGES = 4  # of reduced records, each a figure


@dataclass(frozen=True, kw_only=True)
class _MapDetails:
    """Additions to a map: its numbers, lines and findings, and the input of its figures."""

    parameters: Mapping[str, Parameter]
    covariances: tuple[Covariance, ...]
    findings: Sequence[Finding] = ()
    lines: Sequence[Dependent] = ()
    merits: Mapping[str, Any] | None = None
    over_speed: SpeedThrustMap | None = None
    voltage: VoltageComparison | None = None
    verification: ScalesCheck | None = None


def fit_thrust(
    points: Points,
    *,
    gravity_mps2: float = USUAL_GRAVITY_MPS2,
    order: Order = 2,
    robust: bool = True,
    stand: Stand | None = None,
    scales: Path | Sequence[Path] = (),
    method: Method = "default",
) -> Result:
    """Fit one motor's thrust over command, its inverse and largest thrust, and thrust over a logged voltage.

    `points` are runs, tables of a thrust stand or their paths, and `stand` the facts that these do not contain;
    `scales` are runs or tables of a second instrument, each run together with those that it completes. Raises
    ConfigError, DataError or FitError, the last where nothing can be fitted at all.
    """
    found = evidence_of(points, stand)
    with _with_findings(found):
        mapped = estimation.fit_thrust(
            found.points, method=method, order=order, robust=robust, expected=found.expected or None
        )
    most = maximum_thrust(mapped, gravity_mps2=gravity_mps2)
    parameters, lines, findings = values.map_parameters(mapped), list[Dependent](), list(most.findings)
    given = None
    try:
        inverse = invert(mapped)
        parameters |= values.inverse_parameters(inverse) | values.maximum_parameters(most)
        lines += values.inverse_lines(inverse)
        given = most
        findings += inverse.findings
    except FitError as error:
        findings.append(rejection("inverse-not-given", str(error), "motor.command_of_thrust"))
    voltage, about_voltage = _by_voltage(found, max_thrust_n=given.thrust_n if given else None)
    motors = np.ones(len(found.points.command)) if found.motors is None else found.motors
    ran = motors[voltage.used] if voltage else motors
    if (
        method == "default"
        and given
        and voltage
        and (sagging := on_battery(given, voltage, order=mapped.fit.order, motors=ran))
    ):
        given, findings = sagging, [*(one for one in findings if one not in given.findings), *sagging.findings]
        parameters |= values.maximum_parameters(given)
    if given is not None:
        lines += values.maximum_lines(given)
        findings += values.fewer_motors(given, voltage, motors=float(np.nanmin(motors, initial=ROTORS)))
    over_speed, about_speed = _by_speed(found, method, robust=robust)
    weighed = [scales] if isinstance(scales, Path) else scales
    verification, about_scales = verified(mapped, weighed, stand or Stand(), found.loadcells, gravity_mps2)
    details = _MapDetails(
        parameters={
            **parameters,
            **(values.voltage_parameters(voltage) if voltage else {}),
            **(values.speed_parameters(over_speed) if over_speed else {}),
        },
        covariances=values.covariances(mapped, most=given, voltage=voltage, over_speed=over_speed),
        findings=(
            *findings,
            *about_voltage,
            *about_speed,
            *about_scales,
            *implausible_gravity(gravity_mps2, "motor.*"),
        ),
        lines=(*lines, *(values.verification_lines(verification) if verification else ())),
        merits={
            "voltage_rms_n": voltage.voltage_rms if voltage else None,
            "command_rms_n": voltage.command_rms if voltage else None,
            "better_form": voltage.better if voltage else None,
            "max_thrust_at_v": Dependent(given.volts if given else None, "motor.max_thrust_n"),
            **values.verification_merits(verification),
        },
        over_speed=over_speed,
        voltage=voltage,
        verification=verification,
    )
    return _result(mapped, found, details)


def fit_speed(
    points: Points,
    *,
    order: Order = 1,
    robust: bool = True,
    stand: Stand | None = None,
    rotors: Rotors | None = None,
    method: Method = "default",
) -> Result:
    """Fit one rotor's speed over command, and thrust over speed where both were measured; otherwise as `fit_thrust`.

    With `rotors`, missing speeds are estimated from the load cell's vibration. Tables of thrust and
    speed without a command give thrust over speed alone.
    """
    found = evidence_of(points, stand, rotors)
    if np.isnan(found.points.command).all():
        return _of_speed_alone(found, method, robust=robust)
    with _with_findings(found):
        mapped = estimation.fit_speed(
            found.points, method=method, order=order, robust=robust, expected=found.expected or None
        )
    over_speed, findings = _by_speed(found, method, robust=robust)
    details = _MapDetails(
        parameters=values.map_parameters(mapped) | (values.speed_parameters(over_speed) if over_speed else {}),
        covariances=values.covariances(mapped, over_speed=over_speed),
        findings=findings,
        over_speed=over_speed,
    )
    return _result(mapped, found, details)


def _of_speed_alone(found: Evidence, method: Method, *, robust: bool) -> Result:
    """Fit thrust over speed to points whose commands are not stated."""
    with _with_findings(found):
        mapped = estimation.fit_thrust_of_speed(found.points, method=method, robust=robust)
    return Result(
        command="fit speed",
        method=method,
        quantities=values.speed_parameters(mapped),
        wanted=estimation.OVER_SPEED[:1],
        covariances=values.covariances(over_speed=mapped),
        merits={"points": len(mapped.thrust_n), "difference_n": mapped.difference_n},
        findings=(*found.findings, *mapped.findings),
        sources=found.sources,
        lines=found.lines,
        drawings=lambda: _of_speed(mapped),
    )


def _of_speed(mapped: SpeedThrustMap) -> Figures:
    from cfid.motors.maps.figures import speed_thrust_figure

    return {"thrust_of_speed": speed_thrust_figure(mapped)}


def fit_torque(
    points: Points, *, order: Order = 1, robust: bool = True, stand: Stand | None = None, method: Method = "default"
) -> Result:
    """Fit one motor's torque over its thrust; otherwise as `fit_thrust`."""
    found = evidence_of(points, stand)
    with _with_findings(found):
        mapped = estimation.fit_torque(
            found.points, method=method, order=order, robust=robust, expected=found.expected or None
        )
    details = _MapDetails(parameters=values.map_parameters(mapped), covariances=values.covariances(mapped))
    return _result(mapped, found, details)


@contextmanager
def _with_findings(found: Evidence) -> Iterator[None]:
    """Add the findings about the points to an error that nothing can be fitted to them, since they may be the cause."""
    try:
        yield
    except FitError as error:
        raise explained(error, found.findings) from None


def _by_voltage(found: Evidence, *, max_thrust_n: float | None) -> tuple[VoltageComparison | None, Sequence[Finding]]:
    """Compare thrust over motor voltage with thrust over command, where the battery's voltage is known."""
    points = found.points
    if found.vbat_v is None or points.thrust_n is None or not np.isfinite(found.vbat_v).any():
        return None, ()
    try:
        compared = compare_thrust(
            command=points.command,
            vbat_v=found.vbat_v,
            thrust_n=points.thrust_n,
            std_n=points.thrust_std_n,
            shared_n=points.thrust_shared_n,
            max_thrust_n=max_thrust_n,
        )
    except FitError as error:
        return None, (rejection("voltage-not-fitted", f"thrust of motor voltage: {error}", KEY),)
    return compared, (compared.verdict, *compared.findings)


def _by_speed(found: Evidence, method: Method, *, robust: bool) -> tuple[SpeedThrustMap | None, Sequence[Finding]]:
    """Fit thrust over speed, where both were measured."""
    if found.points.thrust_n is None or found.points.speed_rad_s is None:
        return None, ()
    try:
        mapped = estimation.fit_thrust_of_speed(found.points, method=method, robust=robust)
    except FitError as error:
        return None, (rejection("thrust-of-speed-not-fitted", f"thrust of speed: {error}", *OVER_SPEED),)
    return mapped, mapped.findings


def _of_the_rig(loadcells: Sequence[RigFacts]) -> Figures:
    """Draw how the vehicle was mounted on the load cell, if all recordings state the same."""
    from cfid.drawing.rig import load_cell_figure

    stated = {rig.loadcell.yaw_deg for rig in loadcells}
    yaw_deg = stated.pop() if len(stated) == 1 else None
    if yaw_deg is None:
        return {}
    return {"thrust_rig": load_cell_figure(yaw_deg, title="Load cell, as rig.toml and the runs state it")}


def _result(mapped: MotorMap, found: Evidence, details: _MapDetails) -> Result:
    def drawings() -> Figures:
        from cfid.motors.maps.figures import map_figure, speed_thrust_figure, staircase_figure, voltage_figure

        name = f"fit_{mapped.quantity}"
        pages = {
            f"{name}_{r.name}": staircase_figure(r.time_s, r.thrust_n, r.staircase, title=r.name, thrust=r.thrust)
            for r in found.reduced[:_MOST_PAGES]
        }
        figures = {name: map_figure(mapped, verification=details.verification), **pages}
        if details.over_speed is not None:
            figures["thrust_of_speed"] = speed_thrust_figure(details.over_speed)
        if details.voltage is not None:
            figures["thrust_of_voltage"] = voltage_figure(details.voltage)
        return {**figures, **(_of_the_rig(found.loadcells) if mapped.quantity == "thrust" else {})}

    result = Result(
        command=f"fit {mapped.quantity}",
        method=mapped.method,
        quantities={**details.parameters, **values.table_parameter(found.points)},
        wanted=GIVEN_BY[mapped.quantity][:1],
        covariances=details.covariances,
        merits=values.figures_of_merit(mapped, **(details.merits or {})),
        findings=(*found.findings, *mapped.findings, *details.findings),
        sources=found.sources,
        rests_on=("site",) if mapped.quantity == "thrust" else (),
        lines=(*found.lines, *values.map_lines(mapped), *details.lines),
        drawings=drawings,
    )
    drifts = dict.fromkeys(found.drifts, 1 / max(len(found.reduced), 1))
    measured = {
        "N": force_scales(found.loadcells) | drifts,
        "N m": torque_scales(found.loadcells) | drifts,
        "rad/s": tachometer_scales(found.tachometers),
    }
    talk = (
        thrust_in_torque(found.loadcells, key="motor.torque_poly", count=mapped.fit.order + 1)
        if mapped.quantity == "torque"
        else {}
    )
    return with_common_causes(result, power_law(result.quantities, measured, _POWERS), talk)
