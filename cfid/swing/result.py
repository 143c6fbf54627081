"""One swing's analysis, and its result in the contract's keys."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cfid.errors import FitError
from cfid.findings import Finding, rejection, warning
from cfid.records.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.records.parameters import Parameter
    from cfid.records.tables.angle import AngleRecord
    from cfid.swing.axis_inertias import Surroundings, SwungBody
    from cfid.swing.free_swing import FreeSwing
    from cfid.swing.model import Coefficients

_DAMPING = {
    "swing.viscous_nms_per_rad": ("viscous_per_s", "N m s/rad"),
    "swing.coulomb_nm": ("coulomb_per_s2", "N m"),
    "swing.quadratic_nms2_per_rad2": ("quadratic_per_rad", "N m s^2/rad^2"),
}
_THESIS_BIAS = (
    "the thesis' damped cosine takes sin(phi) for phi: its inertia is too high, by 1 % at 20 degrees; its standard "
    "uncertainty counts noise alone."
)


@dataclass(frozen=True, kw_only=True)
class AnalysedSwing:
    """What either method finds: frequencies (damping per inertia), the start, and how good it is."""

    method: str
    coefficients: "Coefficients"
    std: "Coefficients"
    start_angle_rad: float
    start_speed_rad_per_s: float
    start_std: tuple[float | None, float | None]
    quality: Mapping[str, Any]
    findings: tuple[Finding, ...]
    lines: tuple[str, ...]
    drawings: "Callable[[], Mapping[str, Figure]]"


def rejections_of(swing: "FreeSwing") -> tuple[Finding, ...]:
    """Return why no pendulum describes a record, for a method that has no checks of its own."""
    from cfid.swing.estimation import fit_swing

    try:
        return fit_swing(swing).quality.findings
    except FitError as error:
        return (rejection("swing-no-pendulum", str(error), "swing.*"),)


def analyse(record: "AngleRecord", swing: "FreeSwing", method: str) -> AnalysedSwing:
    """Fit a swing by the default method, or as the thesis did."""
    return _as_the_thesis(record, swing) if method == "thesis" else _by_default(record, swing)


def swing_outcome(
    record: "AngleRecord",
    swing: "FreeSwing",
    analysed: AnalysedSwing,
    *,
    axis: str | None,
    body: "tuple[SwungBody, str] | None",
    around: "Surroundings",
) -> Result:
    """Return the result of `cfid fit swing`, with inertia and torques where body and mount are known."""
    return Result(
        command="fit swing",
        section=f"swing {axis or record.name}",
        method=analysed.method,
        quantities=_parameters(swing, analysed, body, around),
        wanted=("swing.natural_frequency_squared_s2", "swing.axis_inertia_kg_m2"),
        quality=analysed.quality,
        findings=(
            *(warning("recording", text) for text in record.notes),
            *analysed.findings,
        ),
        sources=(record.source,),
        lines=(_window_line(swing), *analysed.lines),
        drawings=analysed.drawings,
        folder=record.path.parent,
    )


def _parameters(
    swing: "FreeSwing", analysed: AnalysedSwing, body: "tuple[SwungBody, str] | None", around: "Surroundings"
) -> "dict[str, Parameter]":
    from cfid.records.parameters import Parameter

    values, std = analysed.coefficients, analysed.std
    found = {
        "swing.natural_frequency_squared_s2": Parameter(
            value=values.natural_frequency_squared_s2, std=std.natural_frequency_squared_s2, unit="1/s^2"
        )
    }
    if body is not None:
        found |= _with_inertia(values, std, body, around)
    return found | {
        "swing.start_angle_rad": Parameter(value=analysed.start_angle_rad, std=analysed.start_std[0], unit="rad"),
        "swing.start_speed_rad_per_s": Parameter(
            value=analysed.start_speed_rad_per_s, std=analysed.start_std[1], unit="rad/s"
        ),
        "swing.zero_rad": Parameter(value=swing.rest_rad + values.zero_rad, std=std.zero_rad or None, unit="rad"),
        "swing.peaks_used": Parameter(value=swing.peaks_used, unit="1"),
    }


def _with_inertia(
    values: "Coefficients", std: "Coefficients", body: "tuple[SwungBody, str]", around: "Surroundings"
) -> "dict[str, Parameter]":
    import numpy as np

    from cfid.estimate.propagation import contributions
    from cfid.records.parameters import Parameter
    from cfid.swing.axis_inertias import AxisInertias, MountedSwing

    swung, mount = body
    measured = MountedSwing(axis=mount, value=values.natural_frequency_squared_s2, std=std.natural_frequency_squared_s2)
    axis_inertias = AxisInertias([measured], swung, around)
    inertia = float(axis_inertias.evaluate(axis_inertias.values).about_axis_kg_m2[0])
    moved = contributions(lambda v: axis_inertias.evaluate(v).about_axis_kg_m2, axis_inertias.inputs)
    inertia_std = float(np.linalg.norm(moved))
    found = {"swing.axis_inertia_kg_m2": Parameter(value=inertia, std=inertia_std or None, unit="kg m^2")}
    for key, (name, unit) in _DAMPING.items():
        ratio, ratio_std = getattr(values, name), getattr(std, name)
        deviation = math.hypot(ratio_std * inertia, ratio * inertia_std)
        found[key] = Parameter(value=ratio * inertia, std=deviation or None, unit=unit)
    return found


def _by_default(record: "AngleRecord", swing: "FreeSwing") -> AnalysedSwing:
    from cfid.swing.estimation import fit_swing
    from cfid.swing.thesis import fit_damped_cosine, log_decrement

    fit = fit_swing(swing)
    cosine, decrement = fit_damped_cosine(swing).frequencies, log_decrement(swing)
    frequency = fit.coefficients.natural_frequency_squared_s2
    # An inertia is m g r over W: a frequency that is too low is an inertia that is too high.
    excess = frequency / cosine.natural_frequency_squared_s2 - 1

    def drawings() -> "dict[str, Figure]":
        from cfid.swing.figures import swing_figure

        return {f"{record.path.stem}_swing": swing_figure(swing, fit, title=record.name)}

    checks = (
        f"check: the thesis' damped cosine would give {cosine.natural_frequency_squared_s2:.6g} 1/s^2, "
        f"an inertia {100 * excess:+.2f} % off",
        f"check: decay by the logarithmic decrement {decrement.frequencies.viscous_per_s / 2:.3g} 1/s, scatter "
        f"{decrement.viscous_scatter_per_s / 2:.2g}; its period gives "
        f"{decrement.frequencies.natural_frequency_squared_s2:.6g} 1/s^2",
    )
    return AnalysedSwing(
        method="default",
        coefficients=fit.coefficients,
        std=fit.std,
        start_angle_rad=fit.output_error.start_angle_rad,
        start_speed_rad_per_s=fit.output_error.start_speed_rad_per_s,
        start_std=fit.start_std,
        quality={
            "rms": fit.residual_rms_rad,
            "misfit": fit.quality.misfit,
            "distortion": fit.quality.distortion,
            "drift": fit.quality.drift,
            "drift_std": fit.quality.drift_std,
            "damping_terms": fit.terms,
            "damping_split_bic": fit.split_bic,
            **_window_quality(swing),
            "damped_cosine": {**cosine._asdict(), "relative_inertia_excess": excess},
            "log_decrement": {
                **decrement.frequencies._asdict(),
                "viscous_scatter_per_s": decrement.viscous_scatter_per_s,
            },
        },
        findings=fit.findings,
        lines=(
            f"damping: {', '.join(fit.terms) or 'none'}; residual {1e3 * fit.residual_rms_rad:.3g} mrad rms, waveform "
            f"off by "
            f"{100 * fit.quality.distortion:.2g} % of the start angle, drift {100 * fit.quality.drift:+.2g} %",
            *(checks if fit.accepted else ()),
        ),
        drawings=drawings,
    )


def _as_the_thesis(record: "AngleRecord", swing: "FreeSwing") -> AnalysedSwing:
    from cfid.swing.model import Coefficients
    from cfid.swing.thesis import fit_damped_cosine, fit_flexible

    cosine, flexible = fit_damped_cosine(swing), fit_flexible(swing)
    squared, viscous = cosine.frequencies
    residual = cosine.angle_rad - cosine.model_rad
    rms = float((residual @ residual / len(residual)) ** 0.5)

    nonlinear = (
        f"nonlinear equation (2.9) on the flexible function (2.16): "
        f"{flexible.frequencies.natural_frequency_squared_s2:.6g} 1/s^2"
    )
    rejected = rejections_of(swing)

    def drawings() -> "dict[str, Figure]":
        from cfid.swing.figures import thesis_swing_figure

        name = f"{record.path.stem}_swing_thesis"
        return {name: thesis_swing_figure(swing, cosine, flexible, title=record.name)}

    return AnalysedSwing(
        method="thesis",
        coefficients=Coefficients(squared, viscous, 0.0, 0.0, 0.0),
        std=Coefficients(*cosine.std, 0.0, 0.0, 0.0),
        start_angle_rad=cosine.start_angle_rad,
        start_speed_rad_per_s=cosine.start_speed_rad_per_s,
        start_std=(None, None),
        quality={"rms": rms, **_window_quality(swing), "nonlinear_equation": flexible.frequencies._asdict()},
        findings=(
            *swing.findings,
            warning(
                "swing-thesis-bias", _THESIS_BIAS, "swing.natural_frequency_squared_s2", "swing.axis_inertia_kg_m2"
            ),
            *rejected,
        ),
        lines=(f"damped cosine: residual {1e3 * rms:.3g} mrad rms", *(() if rejected else (nonlinear,))),
        drawings=drawings,
    )


def _window_quality(swing: "FreeSwing") -> dict[str, Any]:
    return {
        "release_s": swing.release_s,
        "window_s": [float(swing.time_s[swing.hand_gone]), float(swing.time_s[swing.end])],
        "peaks_found": len(swing.peak_time_s),
        "peaks_used": swing.peaks_used,
        "samples": swing.end - swing.hand_gone + 1,
    }


def _window_line(swing: "FreeSwing") -> str:
    first, last = (abs(math.degrees(swing.peak_angle_rad[i])) for i in (0, swing.peaks_used - 1))
    return (
        f"window: release at {swing.release_s:.2f} s, fitted from {swing.time_s[swing.hand_gone]:.2f} to "
        f"{swing.time_s[swing.end]:.2f} s, {swing.peaks_used} of {len(swing.peak_time_s)} peaks, "
        f"{first:.1f} down to {last:.1f} degrees"
    )
