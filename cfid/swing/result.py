"""Collect the results of one swing's fit: quantities, findings, lines and figures."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, FitError
from cfid.findings import Finding, rejection, warning
from cfid.recordings.angle import AngleRecord, AngleSource, AxisRecord, labelled
from cfid.recordings.periods import PeriodRecord, axis_record
from cfid.records.parameters import Parameter
from cfid.records.plausibility import implausible_gravity, implausible_quantities, platform_of, taken_as_exact
from cfid.records.result import Dependent, Figures, Result
from cfid.records.rig_file import Rig, thesis_rig
from cfid.swing.collocation import NO_THREADS, Coefficients, Threads
from cfid.swing.data import (
    body_of_swing,
    check_peaks,
    peaks_on,
    rests_on,
    rig_around,
    surroundings,
    swing_in,
    threads_of,
    turned_about,
)
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.free_swing import FreeSwing
from cfid.swing.periods import timed_frequency
from cfid.swing.release import SMALLEST_PEAK_RAD
from cfid.swing.thesis import DampedCosine, fit_damped_cosine, fit_flexible, log_decrement
from cfid.swing.values import INERTIA, InertiaAbout, findings_about, inertia_about

Method = Literal["default", "thesis"]

FREQUENCY = "swing.natural_frequency_squared_s2"
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
    body = body_of_swing(rig, axis=axis, body=record.label.body, mass=mass, distance=distance)
    around = surroundings(rig or thesis_rig(), gravity_mps2, gravity_std_mps2)
    check_peaks(peaks, [axis] if axis else [])
    swung, directions = (None, ()) if body is None else turned_about(body[0], [record])
    threads = NO_THREADS if body is None else threads_of(body[0].mounts[body[1]], around.gravity_mps2)
    window = {"smallest_peak_rad": smallest_peak_rad, "from_s": from_s, "to_s": to_s}
    found = estimate(record, threads, method=method, peaks=peaks_on(axis, peaks), **window)
    swing, (checks, check_lines) = found.swing, _checks(found)
    inertia = (
        None if body is None or swung is None else inertia_about(found.coefficients, found.std, swung, body[1], around)
    )
    quantities = _quantities(found, inertia)
    platform = "crazyflie" if record.label.body in _OTHER_BODY else platform_of(rig)
    return Result(
        command="fit swing",
        section=" ".join(filter(None, ("swing", _OTHER_BODY.get(record.label.body or ""), axis or record.name))),
        method=method,
        quantities=quantities,
        wanted=(FREQUENCY, INERTIA),
        merits={**found.merits, **checks},
        findings=(
            *record.findings,
            *found.findings,
            *(replace(finding, where=(mount,), quantities=(INERTIA,)) for mount, finding in directions),
            *implausible_quantities(quantities, rig),
            *(() if body is None or inertia is None else findings_about(body[0], inertia, rig, platform)),
            *(() if inertia is None else implausible_gravity(around.gravity_mps2, *inertia.quantities)),
            *(() if distance_m is None else _exact(mass=mass_std_kg, distance=distance_std_m)),
        ),
        sources=(record.source,),
        rests_on=rests_on([axis or ""], body=record.label.body),
        lines=(
            *(() if swing is None else (_window_line(swing),)),
            found.line,
            *check_lines,
            *(() if inertia is None else (Dependent(inertia.budget, INERTIA),)),
        ),
        drawings=lambda: _drawings(record, found),
    )


@dataclass(frozen=True, kw_only=True)
class SwingEstimate:
    """One swing, fitted by either method; damping is per inertia. `fitted` is the method's own result.

    Of timed periods, `swing` and `fitted` are None, and there is no damping.
    """

    coefficients: Coefficients
    std: Coefficients
    merits: Mapping[str, Any]
    findings: tuple[Finding, ...]
    line: str
    swing: FreeSwing | None = None
    fitted: SwingFit | DampedCosine | None = None
    start: tuple[float, float] = (0.0, 0.0)
    start_std: tuple[float | None, ...] = (None, None)


def estimate(record: AxisRecord, threads: Threads, *, method: Method, **window: Any) -> SwingEstimate:
    """Find the free swing in a recording and fit it: the way from a swing to a frequency for every command.

    `threads` carry the body; `window` are arguments of `find_swing`. Raises DataError for a recording without a swing
    and FitError when no pendulum follows it, both naming the file; ConfigError for a window or a method of timed
    periods.
    """
    if isinstance(record, PeriodRecord):
        return _by_periods(record, threads, method=method, **window)
    if not isinstance(record, AngleRecord):
        raise TypeError(record)
    swing = swing_in(record, threads, **window)
    try:
        return _by_thesis(swing) if method == "thesis" else _by_default(swing)
    except FitError as error:
        raise FitError(f"{record.path}: {error}") from None


def _by_default(swing: FreeSwing) -> SwingEstimate:
    fitted = fit_swing(swing)
    quality = fitted.quality
    return SwingEstimate(
        swing=swing,
        fitted=fitted,
        coefficients=fitted.coefficients,
        std=fitted.std,
        start=(fitted.output_error.start_angle_rad, fitted.output_error.start_speed_rad_per_s),
        start_std=fitted.start_std,
        merits={
            "accepted": fitted.accepted,
            "rms": fitted.residual_rms_rad,
            "misfit": quality.misfit,
            "distortion": quality.distortion,
            "drift": quality.drift,
            "drift_std": quality.drift_std,
            **_imperfections(fitted),
            **_window(swing),
        },
        findings=fitted.findings,
        line=f"residual {1e3 * fitted.residual_rms_rad:.3g} mrad rms, "
        f"waveform off by {100 * quality.distortion:.2g} % of the start angle, drift {100 * quality.drift:+.2g} %",
    )


def _by_thesis(swing: FreeSwing) -> SwingEstimate:
    cosine, rejections = fit_damped_cosine(swing), _rejections_of(swing)
    residual = cosine.angle_rad - cosine.model_rad
    rms = float((residual @ residual / len(residual)) ** 0.5)
    return SwingEstimate(
        swing=swing,
        fitted=cosine,
        coefficients=Coefficients(*cosine.frequencies),
        std=Coefficients(*cosine.std),
        start=(cosine.start_angle_rad, cosine.start_speed_rad_per_s),
        start_std=(None, None),
        merits={"accepted": not rejections, "rms": rms, **_window(swing)},
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
    cut = {"peaks": peaks, "from_s": from_s, "to_s": to_s}
    given = [name for name, value in cut.items() if value is not None]
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


def _rejections_of(swing: FreeSwing) -> tuple[Finding, ...]:
    """Return why no pendulum describes a record, for a method without checks of its own."""
    try:
        return tuple(one for one in fit_swing(swing).findings if one.severity == "rejection")
    except FitError as error:
        return (rejection("swing-no-pendulum", str(error), "swing.*"),)


def _drawings(record: AxisRecord, found: SwingEstimate) -> Figures:
    if found.swing is None or found.fitted is None:
        return {}
    from cfid.swing.figures import swing_figure, thesis_swing_figure

    name, swing, fitted = f"{record.path.stem}_swing", found.swing, found.fitted
    if isinstance(fitted, SwingFit):
        return {name: swing_figure(swing, fitted, title=record.name)}
    return {f"{name}_thesis": thesis_swing_figure(swing, fitted, fit_flexible(swing), title=record.name)}


def _imperfections(fitted: SwingFit) -> dict[str, tuple[float, float]]:
    """Return what the rig adds to a pendulum, each with its standard uncertainty: shares of gravity, or degrees."""
    values, std = np.array(fitted.instrument), np.array(fitted.instrument_std)
    if fitted.output_error.setup.gyro_per_s is not None:
        return {"gyro_scale_error": (float(values[0]), float(std[0]))}
    frequency = fitted.coefficients.natural_frequency_squared_s2
    size = float(np.linalg.norm(values))
    disc = size, float(np.linalg.norm(values / (size or 1.0) * std))
    return {
        "cable": (fitted.coefficients.spring_per_s2 / frequency, fitted.std.spring_per_s2 / frequency),
        "disc_deg": (math.degrees(disc[0]), math.degrees(disc[1])),
    }


def _checks(found: SwingEstimate) -> tuple[dict[str, Dependent], tuple[Dependent, ...]]:
    """Return the results of the thesis' other methods, as figures and as lines."""
    swing = found.swing
    if swing is None:
        return {}, ()
    if not isinstance(found.fitted, SwingFit):
        nonlinear = fit_flexible(swing).frequencies
        line = (
            "nonlinear equation (2.9) on the flexible function (2.16): "
            f"{nonlinear.natural_frequency_squared_s2:.6g} 1/s^2"
        )
        return {"nonlinear_equation": Dependent(nonlinear._asdict(), FREQUENCY)}, (Dependent(line, FREQUENCY),)
    decrement = log_decrement(swing)
    scatter = decrement.viscous_scatter_per_s
    figures = {"log_decrement": {**decrement.frequencies._asdict(), "viscous_scatter_per_s": scatter}}
    lines = [
        f"check: decay by the logarithmic decrement {decrement.frequencies.viscous_per_s / 2:.3g} 1/s, scatter "
        f"{scatter / 2:.2g}; its period gives {decrement.frequencies.natural_frequency_squared_s2:.6g} 1/s^2",
    ]
    with suppress(FitError):  # a swing may be sound where a damped cosine does not follow it
        linear = fit_damped_cosine(swing).frequencies
        # An inertia is m g r over W: a frequency that is too low gives an inertia that is too high.
        excess = found.coefficients.natural_frequency_squared_s2 / linear.natural_frequency_squared_s2 - 1
        figures = {"damped_cosine": {**linear._asdict(), "relative_inertia_excess": excess}, **figures}
        lines = [
            f"check: the thesis' damped cosine would give {linear.natural_frequency_squared_s2:.6g} 1/s^2, "
            f"an inertia {100 * excess:+.2f} % off",
            *lines,
        ]
    return (
        {name: Dependent(each, FREQUENCY) for name, each in figures.items()},
        tuple(Dependent(line, FREQUENCY) for line in lines),
    )


def _quantities(found: SwingEstimate, inertia: InertiaAbout | None) -> dict[str, Parameter]:
    values, std, swing = found.coefficients, found.std, found.swing
    frequency = Parameter(value=values.natural_frequency_squared_s2, std=std.natural_frequency_squared_s2)
    if swing is None:
        return {FREQUENCY: frequency, **({} if inertia is None else {INERTIA: inertia.quantities[INERTIA]})}
    return {
        FREQUENCY: frequency,
        **({} if inertia is None else inertia.quantities),
        "swing.start_angle_rad": Parameter(value=found.start[0], std=found.start_std[0]),
        "swing.start_speed_rad_per_s": Parameter(value=found.start[1], std=found.start_std[1]),
        "swing.zero_rad": Parameter(value=swing.rest_rad + values.zero_rad, std=std.zero_rad or None),
        "swing.peaks_used": Parameter(value=swing.peaks_used),
    }


def _exact(**stds: float | None) -> list[Finding]:
    """Return notes on numbers that were given without a standard uncertainty."""
    return [taken_as_exact(name, INERTIA) for name, std in stds.items() if std is None]


def _window(swing: FreeSwing) -> dict[str, Any]:
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
