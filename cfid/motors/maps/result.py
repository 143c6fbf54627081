"""From points to motor maps as a result: quantities, covariances, lines and figures."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.common_causes import (
    force_scales,
    power_law,
    scales_of_weights,
    tachometer_scales,
    thrust_in_torque,
    torque_scales,
    with_common_causes,
)
from cfid.estimate.polynomials import PointFit, PolynomialFit, joint_covariance
from cfid.findings import Finding, explained, note, rejection
from cfid.motors.maps.data import Evidence, Measurements, Stand, evidence_of
from cfid.motors.maps.estimation import (
    GIVEN_BY,
    OUTLIER_WEIGHT,
    OVER_SPEED,
    OVER_VOLTAGE,
    InverseMap,
    MaximumThrust,
    Method,
    MotorMap,
    SpeedThrustMap,
    VoltageComparison,
    compare_thrust,
    fit_map,
    fit_thrust_of_speed,
    invert,
    listed,
    maximum_thrust,
    on_battery,
)
from cfid.motors.maps.scales import ScalesCheck, verified
from cfid.motors.points import column, motor_table
from cfid.motors.vibration.data import Rotors
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.records.plausibility import implausible_gravity
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import RigFacts
from cfid.units import FULL_COMMAND, ROTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

_POWERS = {
    "motor.max_thrust_n": {"N": 1},
    "motor.hover_mass_kg": {"N": 1},
    "motor.thrust_per_speed_squared_n_s2": {"N": 1, "rad/s": -2},
}
_UNITS = {"thrust": "N", "speed": "rad/s", "torque": "Nm"}
_MOST_PAGES = 4  # of reduced records, each a figure
_INVERSE, _MAXIMUM = "motor.command_of_thrust", ("motor.max_thrust_n", "motor.hover_mass_kg")


def fit_thrust(
    points: Measurements,
    *,
    gravity_mps2: float = USUAL_GRAVITY_MPS2,
    stand: Stand | None = None,
    scales: Path | Sequence[Path] = (),
    method: Method = "default",
) -> Result:
    """Fit one motor's thrust over command, its inverse and largest thrust, and thrust over a logged voltage.

    `points` are runs, tables of a thrust stand or their paths, and `stand` the facts that these do not contain;
    `scales` are runs or tables of a second instrument, each run together with those that it completes. Raises
    ConfigError, DataError or FitError, the last where nothing can be fitted at all.
    """
    evidence = evidence_of(points, stand)
    mapped = _mapped("thrust", evidence, method)
    most, inverse, findings = maximum_thrust(mapped, gravity_mps2=gravity_mps2), None, list[Finding]()
    try:
        inverse = invert(mapped)
        findings += inverse.findings
    except FitError as error:
        findings += [*most.findings, rejection("inverse-not-given", str(error), _INVERSE)]
    voltage, about_voltage = _by_voltage(evidence, max_thrust_n=most.thrust_n if inverse else None)
    if inverse:
        motors = column(evidence.points, "motors")
        motors = np.ones(len(evidence.points)) if motors is None else motors
        sagging = (
            on_battery(most, voltage, order=mapped.fit.order, motors=motors[voltage.used])
            if voltage and method == "default"
            else None
        )
        most = sagging or most
        findings += [*most.findings, *_fewer_motors(most, voltage, motors=float(np.nanmin(motors, initial=ROTORS)))]
    over_speed, about_speed = _by_speed(evidence, method)
    weighed = [scales] if isinstance(scales, Path) else scales
    verification, about_scales = verified(mapped, weighed, stand or Stand(), evidence.loadcells, gravity_mps2)
    return _result(
        mapped,
        evidence,
        quantities={
            **(_inverse_quantities(inverse) | _maximum_quantities(most) if inverse else {}),
            **(_voltage_quantities(voltage) if voltage else {}),
        },
        most=most if inverse else None,
        findings=(
            *findings,
            *about_voltage,
            *about_speed,
            *about_scales,
            *implausible_gravity(gravity_mps2, "motor.*"),
        ),
        lines=(
            *((_inverse_line(inverse), _maximum_line(most)) if inverse else ()),
            *(Dependent(line, OVER_VOLTAGE) for line in (voltage.lines if voltage else ())),
            *((_verification_line(verification),) if verification else ()),
        ),
        merits={
            "voltage_rms_n": voltage.voltage_rms if voltage else None,
            "command_rms_n": voltage.command_rms if voltage else None,
            "better_form": voltage.better if voltage else None,
            "max_thrust_at_v": Dependent(most.volts if inverse else None, "motor.max_thrust_n"),
            **{
                f"verification_{name}": Dependent(getattr(verification, name, None), "motor.thrust_poly")
                for name in ("rms_n", "rms_percent", "gain", "gain_std")
            },
        },
        over_speed=over_speed,
        voltage=voltage,
        verification=verification,
    )


def fit_speed(
    points: Measurements,
    *,
    stand: Stand | None = None,
    rotors: Rotors | None = None,
    method: Method = "default",
) -> Result:
    """Fit one rotor's speed over command, and thrust over speed where both were measured; otherwise as `fit_thrust`.

    With `rotors`, missing speeds are estimated from the load cell's vibration. Tables of thrust and
    speed without a command give thrust over speed alone.
    """
    evidence = evidence_of(points, stand, rotors)
    if evidence.points["command"].isna().all():
        return _of_speed_alone(evidence, method)
    mapped = _mapped("speed", evidence, method)
    over_speed, findings = _by_speed(evidence, method)
    return _result(mapped, evidence, findings=findings, over_speed=over_speed)


def fit_torque(
    points: Measurements,
    *,
    stand: Stand | None = None,
    method: Method = "default",
) -> Result:
    """Fit one motor's torque over its thrust; otherwise as `fit_thrust`."""
    evidence = evidence_of(points, stand)
    return _result(_mapped("torque", evidence, method), evidence)


def _mapped(quantity: Any, evidence: Evidence, method: Method) -> MotorMap:
    with _with_findings(evidence):
        return fit_map(quantity, evidence.points, method=method, expected=evidence.expected)


@contextmanager
def _with_findings(evidence: Evidence) -> Iterator[None]:
    """Add the findings about the points to an error that nothing can be fitted to them, since they may be the cause."""
    try:
        yield
    except FitError as error:
        raise explained(error, evidence.findings) from None


def _of_speed_alone(evidence: Evidence, method: Method) -> Result:
    """Fit thrust over speed to points whose commands are not stated."""
    with _with_findings(evidence):
        over_speed = fit_thrust_of_speed(evidence.points, method=method)

    def drawings() -> Figures:
        from cfid.motors.maps.figures import speed_thrust_figure

        return {"thrust_of_speed": speed_thrust_figure(over_speed)}

    return Result(
        command="fit speed",
        method=method,
        quantities=_speed_quantities(over_speed),
        wanted=OVER_SPEED[:1],
        covariances=covariances(over_speed=over_speed),
        merits={"points": len(over_speed.thrust_n), "difference_n": over_speed.difference_n},
        findings=(*evidence.findings, *over_speed.findings),
        sources=evidence.sources,
        lines=evidence.lines,
        drawings=drawings,
    )


def _by_voltage(
    evidence: Evidence, *, max_thrust_n: float | None
) -> tuple[VoltageComparison | None, Sequence[Finding]]:
    """Compare thrust over motor voltage with thrust over command, where the battery's voltage is known."""
    if "vbat_v" not in evidence.points or evidence.points["vbat_v"].isna().all():
        return None, ()
    try:
        compared = compare_thrust(evidence.points, max_thrust_n=max_thrust_n)
    except FitError as error:
        return None, (rejection("voltage-not-fitted", f"thrust of motor voltage: {error}", OVER_VOLTAGE),)
    return compared, compared.findings


def _by_speed(evidence: Evidence, method: Method) -> tuple[SpeedThrustMap | None, Sequence[Finding]]:
    """Fit thrust over speed, where both were measured."""
    if not {"thrust_n", "speed_rad_s"} <= set(evidence.points):
        return None, ()
    try:
        over_speed = fit_thrust_of_speed(evidence.points, method=method)
    except FitError as error:
        return None, (rejection("thrust-of-speed-not-fitted", f"thrust of speed: {error}", *OVER_SPEED),)
    return over_speed, over_speed.findings


def _result(
    mapped: MotorMap,
    evidence: Evidence,
    *,
    quantities: Mapping[str, Parameter] = {},
    most: MaximumThrust | None = None,
    findings: Sequence[Finding] = (),
    lines: Sequence[Dependent] = (),
    merits: Mapping[str, Any] = {},
    over_speed: SpeedThrustMap | None = None,
    voltage: VoltageComparison | None = None,
    verification: ScalesCheck | None = None,
) -> Result:
    """Return a map as a result, with the causes of error that instruments have."""
    key, fit = GIVEN_BY[mapped.quantity][0], mapped.fit

    def drawings() -> Figures:
        from cfid.motors.maps.figures import map_figure, speed_thrust_figure, staircase_figure, voltage_figure

        name = f"fit_{mapped.quantity}"
        figures = {name: map_figure(mapped, verification=verification)}
        for record in evidence.reduced[:_MOST_PAGES]:
            figures[f"{name}_{record.name}"] = staircase_figure(record)
        if over_speed is not None:
            figures["thrust_of_speed"] = speed_thrust_figure(over_speed)
        if voltage is not None:
            figures["thrust_of_voltage"] = voltage_figure(voltage)
        return {**figures, **(_of_the_rig(evidence.loadcells) if mapped.quantity == "thrust" else {})}

    result = Result(
        command=f"fit {mapped.quantity}",
        method=mapped.method,
        quantities={
            key: Parameter(value=fit.coefficients.tolist(), std=fit.std.tolist()),
            **quantities,
            **(_speed_quantities(over_speed) if over_speed else {}),
            **({"motor.table": Parameter(value=table)} if (table := motor_table(evidence.points)) else {}),
        },
        wanted=(key,),
        covariances=covariances(mapped, most=most, voltage=voltage, over_speed=over_speed),
        merits={
            "residual_norm": fit.residual_norm,
            "points": len(mapped.x),
            "degrees_of_freedom": fit.degrees_of_freedom,
            "scatter_over_stated": fit.inflation,
            "left_out_commands": list(mapped.left_out),
            **merits,
        },
        findings=(*evidence.findings, *mapped.findings, *findings),
        sources=evidence.sources,
        rests_on=("site",) if mapped.quantity == "thrust" else (),
        lines=(*evidence.lines, *(Dependent(line, key) for line in _map_lines(mapped)), *lines),
        drawings=drawings,
    )
    drifts = dict.fromkeys(evidence.drifts, 1 / max(len(evidence.reduced), 1))
    measured = {
        "N": force_scales(evidence.loadcells) | scales_of_weights(evidence.scales) | drifts,
        "N m": torque_scales(evidence.loadcells) | drifts,
        "rad/s": tachometer_scales(evidence.tachometers),
    }
    talk = thrust_in_torque(evidence.loadcells, key=key, count=fit.order + 1) if mapped.quantity == "torque" else {}
    return with_common_causes(result, power_law(result.quantities, measured, _POWERS), talk)


def _of_the_rig(loadcells: Sequence[RigFacts]) -> Figures:
    """Draw how the vehicle was mounted on the load cell, if all recordings state the same."""
    from cfid.drawing.rig import load_cell_figure

    stated = {rig.loadcell.yaw_deg for rig in loadcells}
    yaw_deg = stated.pop() if len(stated) == 1 else None
    if yaw_deg is None:
        return {}
    return {"thrust_rig": load_cell_figure(yaw_deg, title="Load cell, as rig.toml and the runs state it")}


# Quantities


def _inverse_quantities(inverse: InverseMap) -> dict[str, Parameter]:
    root = {
        "coefficients": inverse.coefficients.tolist(),
        "command_min": inverse.command_range[0],
        "command_max": inverse.command_range[1],
        "thrust_min_n": inverse.thrust_range_n[0],
        "thrust_max_n": inverse.thrust_range_n[1],
        "round_trip_command": inverse.round_trip_command,
        "round_trip_n": inverse.round_trip_n,
    }
    return {_INVERSE: Parameter(value=[root])}


def _maximum_quantities(most: MaximumThrust) -> dict[str, Parameter]:
    """Return the check of the map in section 3.3.1."""
    return {
        "motor.max_thrust_n": Parameter(value=most.thrust_n, std=most.std_n),
        "motor.hover_mass_kg": Parameter(value=most.hover_mass_kg, std=most.hover_mass_std_kg),
    }


def _voltage_quantities(voltage: VoltageComparison) -> dict[str, Parameter]:
    """Return thrust over motor voltage, lowest power first, as in the firmware."""
    std = voltage.by_voltage.std[::-1].tolist()
    return {OVER_VOLTAGE: Parameter(value=voltage.lowest_first.tolist(), std=std)}


def _speed_quantities(over_speed: SpeedThrustMap) -> dict[str, Parameter]:
    """Return thrust over speed as k w^2 and as a full quadratic."""
    quadratic = over_speed.quadratic
    return {
        OVER_SPEED[0]: Parameter(value=over_speed.k_n_s2, std=over_speed.k_std_n_s2),
        OVER_SPEED[1]: Parameter(value=quadratic.coefficients.tolist(), std=quadratic.std.tolist()),
    }


# Covariances


class _Part(NamedTuple):
    """A fit to points of all windows, the values that it gives, and how these follow from its coefficients.

    `beyond` is a covariance in addition to the fit's.
    """

    fit: PolynomialFit
    windows: Array
    values: dict[str, Any]
    outward: Array
    beyond: Array


def covariances(
    mapped: MotorMap | None = None,
    *,
    most: MaximumThrust | None = None,
    voltage: VoltageComparison | None = None,
    over_speed: SpeedThrustMap | None = None,
) -> tuple[Covariance, ...]:
    """Return the covariance of maps fitted to the same points, and of the numbers calculated from them.

    A rejected voltage cubic is kept apart, so that it can be removed alone.
    """
    parts = []
    if mapped is not None:
        key, count = GIVEN_BY[mapped.quantity][0], mapped.fit.order + 1
        of_map = _part(mapped.fit, mapped.windows, {key: mapped.fit.coefficients.tolist()}, np.eye(count))
        parts.append(of_map if most is None or most.by_volts is not None else _with_maximum(of_map, most, FULL_COMMAND))
    if over_speed is not None:
        quadratic = {OVER_SPEED[1]: over_speed.quadratic.coefficients.tolist()}
        parts.append(_part(over_speed.square, over_speed.windows, {OVER_SPEED[0]: over_speed.k_n_s2}, np.eye(3)[:1]))
        parts.append(_part(over_speed.quadratic, over_speed.windows, quadratic, np.eye(3)))
    if voltage is None:
        return _joint(parts)
    windows = np.eye(len(voltage.used))[voltage.used]
    if most is not None and most.by_volts is not None and most.volts is not None:
        by_volts = _part(most.by_volts, windows, {}, np.empty((0, most.by_volts.order + 1)))
        parts.append(_with_maximum(by_volts, most, most.volts))
    lowest_first = voltage.lowest_first.tolist()
    cubic = _part(voltage.by_voltage, windows, {OVER_VOLTAGE: lowest_first}, np.eye(len(lowest_first))[::-1])
    return (*_joint(parts), *_joint([cubic])) if voltage.rejected else _joint([*parts, cubic])


def _part(fit: PolynomialFit, windows: Array, values: dict[str, Any], outward: Array) -> _Part:
    return _Part(fit, windows, values, outward, np.zeros((len(outward), len(outward))))


def _with_maximum(part: _Part, most: MaximumThrust, at: float) -> _Part:
    """Add largest thrust and hover mass, which follow from the polynomial `at` a command or voltage."""
    both = np.array([[1.0], [ROTORS / most.gravity_mps2]])
    return part._replace(
        values=part.values | {"motor.max_thrust_n": most.thrust_n, "motor.hover_mass_kg": most.hover_mass_kg},
        outward=np.vstack([part.outward, both * np.vander([float(at)], part.fit.order + 1)]),
        beyond=block_diag(part.beyond, most.beyond_std_n**2 * both @ both.T),
    )


def _joint(parts: Sequence[_Part]) -> tuple[Covariance, ...]:
    """Return the joint covariance of several fits, those whose own covariance is known."""
    known = [part for part in parts if np.isfinite(part.fit.covariance).all()]
    if not known:
        return ()
    outward, beyond = block_diag(*(part.outward for part in known)), block_diag(*(part.beyond for part in known))
    values = {key: value for part in known for key, value in part.values.items()}
    joint = joint_covariance([PointFit(part.fit, part.windows) for part in known])
    return covariance_between(values, outward @ joint @ outward.T + beyond)


# Lines


def _map_lines(mapped: MotorMap) -> list[str]:
    """Return lines with a map as the thesis writes it, and what hardly counts."""
    over = "thrust" if mapped.quantity == "torque" else "cmd"
    powers = range(mapped.fit.order, -1, -1)
    terms = [
        f"{value:+.7g}" + (f" {over}^{power}" if power > 1 else f" {over}" if power else "")
        for value, power in zip(mapped.fit.coefficients.tolist(), powers, strict=True)
    ]
    norm = f"norm of residuals {mapped.fit.residual_norm:.4g} {_UNITS[mapped.quantity]}"
    lines = [f"{mapped.quantity} = {' '.join(terms)} ({norm}, {counted(len(mapped.x), 'point')})"]
    outliers = np.unique(mapped.command[mapped.fit.weight < OUTLIER_WEIGHT]).tolist()
    if outliers:
        lines.append(f"counts little, more than four standard uncertainties off: command {listed(outliers)}")
    return lines


def _inverse_line(inverse: InverseMap) -> Dependent:
    """Return a line with range and round trip of the inverse."""
    low, high = (_plain(1e3 * thrust_n) for thrust_n in inverse.thrust_range_n)
    line = (
        f"command of thrust: from {low} to {high} mN (commands {inverse.command_range[0]:.0f} to "
        f"{inverse.command_range[1]:.0f}), there and back within {inverse.round_trip_command:.2g} commands, "
        f"{1e3 * inverse.round_trip_n:.2g} mN by rounding"
    )
    return Dependent(line, "motor.thrust_poly", _INVERSE)


def _maximum_line(most: MaximumThrust) -> Dependent:
    """Return a line on the mass that can hover, and on the battery's voltage for that."""
    at = "" if most.volts is None else f" at {most.volts:.2f} V, to which the battery sags under four"
    line = (
        f"at most {_plain(1e3 * most.thrust_n)} mN a motor{at}, measured {_plain(1e3 * most.measured_n)} mN at "
        f"{most.measured_command:.0f}: four motors hover {_plain(1e3 * most.hover_mass_kg)} g"
    )
    return Dependent(line, "motor.thrust_poly", *_MAXIMUM)


def _fewer_motors(most: MaximumThrust, voltage: VoltageComparison | None, *, motors: float) -> tuple[Finding, ...]:
    """Return a note where no voltage shows to what four motors lower the one that fewer `motors` had."""
    if motors >= ROTORS or most.volts is not None or (voltage and voltage.better == "command"):
        return ()
    text = (
        f"thrust at full command and hover mass hold at the voltage under {counted(round(motors), 'motor')}: four lower"
        " a battery's further, and hover up to a fifth less. Log the battery's voltage (pm.vbat)."
    )
    return (note("maximum-of-fewer-motors", text, *_MAXIMUM),)


def _verification_line(check: ScalesCheck) -> Dependent:
    """Return a line on how far a second instrument is from the map (figure 3.9)."""
    percent = f"{check.rms_percent:.2g} %" if check.rms_percent < 10 else f"{check.rms_percent:.0f} %"
    largest = float(np.abs(check.difference_n).max())
    line = (
        f"verification: {counted(len(check.command), 'reading')}, {1e3 * check.rms_n:.3g} mN rms ({percent}), at most "
        f"{1e3 * largest:.3g} mN from the map"
    )
    return Dependent(line, "motor.thrust_poly")


def _plain(value: float) -> str:
    """Return a number with four digits and no exponent: a large motor's thrust is 20340 mN, not 2e+04."""
    return np.format_float_positional(value, precision=4, fractional=False, trim="-")
