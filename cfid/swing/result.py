"""Collect the results of one swing's fit: quantities, findings, lines and figures."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from uncertainties import nominal_value, std_dev

from cfid.counted import counted
from cfid.errors import ConfigError, FitError
from cfid.findings import Finding, rejection, warning
from cfid.recordings.angle import AngleRecord, AngleSource, AxisRecord, labelled
from cfid.recordings.periods import PeriodRecord, axis_record
from cfid.records.parameters import Parameter
from cfid.records.plausibility import (
    implausible_gravity,
    implausible_inputs,
    implausible_quantities,
    platform_of,
    taken_as_exact,
)
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import EncoderScale, Rig
from cfid.swing.body import (
    MountedSwing,
    axis_inertias,
    body_of_swing,
    budget,
    contradicted_axes,
    effects,
    given_numbers,
    moment_fault,
    rests_on,
    rig_around,
    surroundings,
    threads_of,
)
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.pendulum import NO_THREADS, Coefficients, Threads
from cfid.swing.periods import timed_frequency
from cfid.swing.thesis import DampedCosine, fit_damped_cosine, fit_flexible, log_decrement
from cfid.swing.window import SMALLEST_PEAK_RAD, FreeSwing, check_peaks, peaks_on, swing_in

Method = Literal["default", "thesis"]

FREQUENCY = "swing.natural_frequency_squared_s2"
INERTIA = "swing.axis_inertia_kg_m2"
_DAMPING = {
    "swing.viscous_nms_per_rad": "viscous_per_s",
    "swing.coulomb_nm": "coulomb_per_s2",
    "swing.quadratic_nms2_per_rad2": "quadratic_per_rad",
}
_OTHER_BODY = {"testbody": "testbody", "fixture": "fixture"}  # the vehicle has no name here
_THESIS_BIAS = (
    "the thesis' damped cosine takes sin(phi) for phi: its inertia is too high, by 1 % at 20 degrees; its standard "
    "uncertainty counts noise alone."
)


def fit(
    recording: AngleSource,
    *,
    axis: str | None = None,
    rig: Rig | None = None,
    mass_kg: float | None = None,
    mass_std_kg: float | None = None,
    distance_m: float | None = None,
    distance_std_m: float | None = None,
    gravity_mps2: float | None = None,
    gravity_std_mps2: float | None = None,
    peaks: int | Mapping[str, int] | None = None,
    smallest_peak_rad: float = SMALLEST_PEAK_RAD,
    from_s: float | None = None,
    to_s: float | None = None,
    method: Method = "default",
) -> Result:
    """Fit a free swing: natural frequency and damping, and the axis inertia where mass and distance are known.

    A record of timed periods gives the natural frequency, and no damping.

    Mass and distance are given as numbers, or those of the mount `axis` of the rig are used: the given rig, or that of
    the campaign that contains the recording. `axis` is the recording's label by default. The window ends at peak
    `peaks`, with the release as the first, or at the last peak of at least `smallest_peak_rad`; `from_s` and `to_s`,
    since the first sample, limit it.

    Raises ConfigError for arguments that contradict each other, DataError for a recording without a swing, and FitError
    when no pendulum follows it.
    """
    record = axis_record(recording)
    if axis is not None:
        record = labelled(record, axis=axis)
    axis = record.label.axis
    rig = rig_around([record], rig)
    mass, distance = (mass_kg, mass_std_kg), (distance_m, distance_std_m)
    hung = body_of_swing(rig, axis=axis, body=record.label.body, mass=mass, distance=distance)
    around = surroundings(rig, gravity_mps2, gravity_std_mps2)
    check_peaks(peaks, [axis] if axis else [])
    threads = NO_THREADS if hung is None else threads_of(hung[0].mounts[hung[1]], around.gravity_mps2)
    window = {"smallest_peak_rad": smallest_peak_rad, "from_s": from_s, "to_s": to_s}
    encoder = EncoderScale() if rig is None else rig.encoder
    swing = estimate(record, threads, encoder, method=method, peaks=peaks_on(axis, peaks), **window)
    frequency, frequency_std = swing.frequency
    quantities = {FREQUENCY: Parameter(value=frequency, std=frequency_std)}
    findings = [*record.findings, *swing.findings]
    checks, lines = _thesis_checks(swing)
    if hung is not None:
        body, mount = hung
        given = axis_inertias([swing.mounted(mount)], body, around)
        (inertia,), (about_centre,) = given.about_axis_kg_m2, given.about_centre_kg_m2
        quantities[INERTIA] = parameter(inertia)
        if swing.window is not None:
            for key, name in _DAMPING.items():
                ratio, ratio_std = getattr(swing.coefficients, name), getattr(swing.std, name)
                torque_std = math.hypot(ratio_std * nominal_value(inertia), ratio * std_dev(inertia))
                quantities[key] = Parameter(value=ratio * nominal_value(inertia), std=torque_std or None)
        shares = {cause: share[0] / abs(nominal_value(inertia)) for cause, share in budget(*effects([inertia])).items()}
        text = ", ".join(f"{cause} {100 * share:.2g} %" for cause, share in shares.items())
        lines.append(Dependent(f"standard uncertainty of the inertia: {text}", INERTIA))
        resting = tuple(key for key in quantities if key != FREQUENCY)
        platform = "crazyflie" if record.label.body in _OTHER_BODY else platform_of(rig)
        distances = filter(None, map(nominal_value, given.distance_m))
        findings += [
            *(
                replace(finding, where=(name,), quantities=(INERTIA,))
                for name, finding in contradicted_axes(body, [record])
            ),
            *implausible_inputs(given_numbers(body, distances, platform), rig, *resting),
            *moment_fault(
                "this swing", nominal_value(inertia), nominal_value(about_centre), std_dev(about_centre), *resting
            ),
            *implausible_gravity(around.gravity_mps2, *resting),
        ]
        if distance_m is not None:
            stds = {"mass": mass_std_kg, "distance": distance_std_m}
            findings += [taken_as_exact(name, INERTIA) for name, std in stds.items() if std is None]
    if swing.window is not None:
        angle, speed = zip(swing.start, swing.start_std, strict=True)
        quantities["swing.start_angle_rad"] = Parameter(value=angle[0], std=angle[1])
        quantities["swing.start_speed_rad_per_s"] = Parameter(value=speed[0], std=speed[1])
        zero_rad = swing.window.rest_rad + swing.coefficients.zero_rad
        quantities["swing.zero_rad"] = Parameter(value=zero_rad, std=swing.std.zero_rad or None)
        quantities["swing.peaks_used"] = Parameter(value=swing.window.peaks_used)
    return Result(
        command="fit swing",
        section=" ".join(filter(None, ("swing", _OTHER_BODY.get(record.label.body or ""), axis or record.name))),
        method=method,
        quantities=quantities,
        wanted=(FREQUENCY, INERTIA),
        merits={**swing.merits, **checks},
        findings=(*findings, *implausible_quantities(quantities, rig)),
        sources=(record.source,),
        rests_on=rests_on([axis or ""], body=record.label.body),
        lines=(*(() if swing.window is None else (_window_line(swing.window),)), swing.line, *lines),
        drawings=lambda: _drawings(record, swing),
    )


def parameter(value: Any) -> Parameter:
    """Return an uncertain number as a quantity; its standard uncertainty is None where it is exact."""
    return Parameter(value=float(nominal_value(value)), std=float(std_dev(value)) or None)


@dataclass(frozen=True, kw_only=True)
class SwingEstimate:
    """One swing, fitted by either method; damping is per inertia. `fitted` is the method's own result.

    Of timed periods, `window` and `fitted` are None, and there is no damping.
    """

    coefficients: Coefficients
    std: Coefficients
    merits: Mapping[str, Any]
    findings: tuple[Finding, ...]
    line: str
    window: FreeSwing | None = None
    fitted: SwingFit | DampedCosine | None = None
    start: tuple[float, float] = (0.0, 0.0)
    start_std: tuple[float | None, ...] = (None, None)

    @property
    def frequency(self) -> tuple[float, float]:
        """The natural frequency squared and its standard uncertainty."""
        return self.coefficients.natural_frequency_squared_s2, self.std.natural_frequency_squared_s2

    def mounted(self, mount: str) -> MountedSwing:
        """Return the natural frequency squared as a measurement about a mount, the clock's part by itself."""
        value, std = self.frequency
        if not isinstance(self.fitted, SwingFit) or self.window is None:
            return MountedSwing(axis=mount, value=value, std=std)
        clock_std = 2 * self.window.time_scale_std
        return MountedSwing(
            axis=mount,
            value=value,
            std=math.sqrt(max(std**2 - (clock_std * value) ** 2, 0.0)),
            clock_std=clock_std,
            timed_by=self.window.timed_by,
        )


def estimate(
    record: AxisRecord, threads: Threads, encoder: EncoderScale, *, method: Method, **window: Any
) -> SwingEstimate:
    """Find the free swing in a recording and fit it: the way from a swing to a frequency for every command.

    `threads` carry the body; `window` are arguments of `find_swing`. Raises DataError for a recording without a swing
    and FitError when no pendulum follows it, both naming the file; ConfigError for a window or a method of timed
    periods.
    """
    if isinstance(record, PeriodRecord):
        return _by_periods(record, threads, method=method, **window)
    if not isinstance(record, AngleRecord):
        raise TypeError(record)
    swing = swing_in(record, threads, encoder, **window)
    try:
        return _by_thesis(swing) if method == "thesis" else _by_default(swing)
    except FitError as error:
        raise FitError(f"{record.path}: {error}") from None


def _by_default(swing: FreeSwing) -> SwingEstimate:
    fit = fit_swing(swing)
    frequency = fit.coefficients.natural_frequency_squared_s2
    values, std = np.array(fit.instrument), np.array(fit.instrument_std)
    size = float(np.linalg.norm(values))
    # What the rig adds to a pendulum, each with its standard uncertainty.
    imperfections = {
        "cable": (fit.coefficients.spring_per_s2 / frequency, fit.std.spring_per_s2 / frequency),
        "disc_deg": (math.degrees(size), math.degrees(float(np.linalg.norm(values / (size or 1.0) * std)))),
    }
    if swing.rate_rad_per_s is not None:
        imperfections = {"gyro_scale_error": (float(values[0]), float(std[0]))}
    return SwingEstimate(
        window=swing,
        fitted=fit,
        coefficients=fit.coefficients,
        std=fit.std,
        start=(fit.output_error.start_angle_rad, fit.output_error.start_speed_rad_per_s),
        start_std=fit.start_std,
        merits={
            "accepted": fit.accepted,
            "rms": fit.residual_rms_rad,
            **{name: getattr(fit, name) for name in ("misfit", "distortion", "drift", "drift_std")},
            "budget_s2": Dependent(dict(fit.budget_s2), FREQUENCY),
            **imperfections,
            **_window_merits(swing),
        },
        findings=fit.findings,
        line=f"residual {1e3 * fit.residual_rms_rad:.3g} mrad rms, "
        f"shape off a pendulum's by {100 * fit.distortion:.2g} % of the start angle, drift {100 * fit.drift:+.2g} %",
    )


def _by_thesis(swing: FreeSwing) -> SwingEstimate:
    cosine = fit_damped_cosine(swing)
    try:  # the thesis' method has no checks of its own
        rejections = tuple(finding for finding in fit_swing(swing).findings if finding.severity == "rejection")
    except FitError as error:
        rejections = (rejection("swing-no-pendulum", str(error), "swing.*"),)
    rms = float(np.sqrt(np.mean((cosine.angle_rad - cosine.model_rad) ** 2)))
    return SwingEstimate(
        window=swing,
        fitted=cosine,
        coefficients=Coefficients(*cosine.frequencies),
        std=Coefficients(*cosine.std),
        start=(cosine.start_angle_rad, cosine.start_speed_rad_per_s),
        merits={"accepted": not rejections, "rms": rms, **_window_merits(swing)},
        findings=(*swing.findings, warning("swing-thesis-bias", _THESIS_BIAS, FREQUENCY, INERTIA), *rejections),
        line=f"damped cosine: residual {1e3 * rms:.3g} mrad rms",
    )


def _by_periods(
    record: PeriodRecord,
    threads: Threads,
    *,
    method: Method,
    peaks: int | None = None,
    smallest_peak_rad: float = SMALLEST_PEAK_RAD,
    from_s: float | None = None,
    to_s: float | None = None,
) -> SwingEstimate:
    given = [name for name, value in {"peaks": peaks, "from_s": from_s, "to_s": to_s}.items() if value is not None]
    given += ["min_angle_deg"] * (smallest_peak_rad != SMALLEST_PEAK_RAD) + ["method"] * (method == "thesis")
    if given:
        raise ConfigError(f"{record.path}: {', '.join(f'`{name}`' for name in given)}: not for timed periods.")
    timed = timed_frequency(record, threads)
    periods = int(record.periods.sum())
    return SwingEstimate(
        coefficients=Coefficients(timed.natural_frequency_squared_s2, 0.0),
        std=Coefficients(timed.std_s2, 0.0),
        merits={"accepted": True, "periods": periods, "period_s": timed.period_s},
        findings=timed.findings,
        line=f"{counted(periods, 'period')} in {counted(len(record.duration_s), 'row')}: {timed.period_s:.6g} s for "
        "small swings",
    )


def _thesis_checks(swing: SwingEstimate) -> tuple[dict[str, Dependent], list[Dependent]]:
    """Return the results of the thesis' other methods, as figures and as lines."""
    if swing.window is None:
        return {}, []
    if not isinstance(swing.fitted, SwingFit):
        nonlinear = fit_flexible(swing.window).frequencies
        line = (
            "nonlinear equation (2.9) on the flexible function (2.16): "
            f"{nonlinear.natural_frequency_squared_s2:.6g} 1/s^2"
        )
        return {"nonlinear_equation": Dependent(nonlinear._asdict(), FREQUENCY)}, [Dependent(line, FREQUENCY)]
    figures, lines = {}, []
    with suppress(FitError):  # a swing may be sound where a damped cosine does not follow it
        linear = fit_damped_cosine(swing.window).frequencies
        # An inertia is m g r over W: a frequency that is too low gives an inertia that is too high.
        excess = swing.frequency[0] / linear.natural_frequency_squared_s2 - 1
        figures["damped_cosine"] = Dependent({**linear._asdict(), "relative_inertia_excess": excess}, FREQUENCY)
        line = (
            f"check: the thesis' damped cosine would give {linear.natural_frequency_squared_s2:.6g} 1/s^2, "
            f"an inertia {100 * excess:+.2f} % off"
        )
        lines.append(Dependent(line, FREQUENCY))
    decrement, scatter = log_decrement(swing.window)
    decay = {**decrement._asdict(), "viscous_scatter_per_s": scatter}
    line = (
        f"check: decay by the logarithmic decrement {decrement.viscous_per_s / 2:.3g} 1/s, scatter "
        f"{scatter / 2:.2g}; its period gives {decrement.natural_frequency_squared_s2:.6g} 1/s^2"
    )
    return {**figures, "log_decrement": Dependent(decay, FREQUENCY)}, [*lines, Dependent(line, FREQUENCY)]


def _window_merits(swing: FreeSwing) -> dict[str, Any]:
    return {
        "release_s": swing.release_s,
        "window_s": [float(swing.time_s[swing.hand_gone]), float(swing.time_s[swing.end])],
        "peaks_found": len(swing.peak_time_s),
        "peaks_used": swing.peaks_used,
        "samples": swing.end - swing.hand_gone + 1,
    }


def _window_line(swing: FreeSwing) -> str:
    first, last = (abs(math.degrees(swing.peak_angle_rad[i])) for i in (0, swing.peaks_used - 1))
    return (
        f"window: release at {swing.release_s:.2f} s, fitted from {swing.time_s[swing.hand_gone]:.2f} to "
        f"{swing.time_s[swing.end]:.2f} s, {swing.peaks_used} of {counted(len(swing.peak_time_s), 'peak')}, "
        f"{first:.1f} down to {last:.1f} degrees"
    )


def _drawings(record: AxisRecord, swing: SwingEstimate) -> Figures:
    if swing.window is None or swing.fitted is None:
        return {}
    from cfid.swing.figures import swing_figure, thesis_swing_figure

    name = f"{record.path.stem}_swing"
    if isinstance(swing.fitted, SwingFit):
        return {name: swing_figure(swing.window, swing.fitted, title=record.name)}
    flexible = fit_flexible(swing.window)
    return {f"{name}_thesis": thesis_swing_figure(swing.window, swing.fitted, flexible, title=record.name)}
