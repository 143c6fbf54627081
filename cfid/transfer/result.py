"""Convert sine runs to the result of `cfid tf identify`: quantities, findings and printed lines."""

from cmath import phase
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cfid.errors import CfidError
from cfid.estimate.common_causes import arm_scales, force_scales, power_law, with_common_causes
from cfid.findings import Finding, note, rejection, warning
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result
from cfid.records.run import Run
from cfid.transfer.comparison import Comparison, GainAndLag, Published, compared
from cfid.transfer.estimation import Delay, TransferFit
from cfid.transfer.frequency_response import SETTLE_S
from cfid.transfer.identification import Identified, identify_all
from cfid.transfer.likelihood import Shape
from cfid.transfer.model import Form
from cfid.transfer.sines.alignment import Sign
from cfid.transfer.sines.data import SineSet, read_sines
from cfid.transfer.sines.plan import CUTOFF_HZ, SAMPLE_S
from cfid.transfer.summary import convention_lines, fit_lines
from cfid.transfer.thesis import ThesisFit, ThesisFits, ThesisSettings, fit_all, settings_of
from cfid.units import COVERAGE_95

Quantities = dict[str, Parameter]

SECTION = "tf"

_WANTED = ("tf.numerator", "tf.denominator", "tf.static_gain_n", "tf.time_constant_s", "tf.delay_s")


def fit(
    runs: SineSet | Sequence[Run | Path | str],
    *,
    sign: Sign = "auto",
    shape: Shape | Literal["auto"] = "first+delay",
    form: Form = "hold",
    settle_s: float = SETTLE_S,
    cutoff_hz: float = CUTOFF_HZ,
    settings: Callable[[int], ThesisSettings] = settings_of,
    thrust_poly: Sequence[float] | None = None,
    compare: Published | None = None,
    method: Literal["default", "thesis"] = "default",
) -> Result:
    """Return the transfer function from command to thrust, of all series together and of each by itself.

    Runs are those of `cfid log sine`; use `read_sines` for files, and for channels other than the motor's own arm.
    `settle_s` at the start of each run and sines above `cutoff_hz` are left out; `settings` gives the constants of
    C.2.5 for runs of N samples. The static gain is compared with the slope of `thrust_poly`, newtons over the command
    with the highest power first, and with a function that the thesis published. Raises DataError and FitError with a
    run's name.
    """
    sines = runs if isinstance(runs, SineSet) else read_sines(runs)
    command = sines.runs[0].sine.middle
    slope_n = None if thrust_poly is None else float(np.polyval(np.polyder(np.array(thrust_poly)), command))
    comparison = Comparison(slope_n, command, compare)
    if method == "thesis":
        return replace(_of_thesis(fit_all(sines.series, settings, sign=sign), sines, comparison), facts=_facts(sines))
    found = identify_all(sines.series, shape=shape, form=form, settle_s=settle_s, cutoff_hz=cutoff_hz, sign=sign)
    try:
        thesis: ThesisFit | str = fit_all(sines.series, settings, sign=sign).joint
    except CfidError as error:
        thesis = str(error)
    result = replace(_of_fit(found, thesis, sines, comparison, settle_s=settle_s), facts=_facts(sines))
    scales = (force_scales if sines.channel == "Fz" else arm_scales)(sines.rigs)
    return with_common_causes(result, power_law(result.quantities, {"N": scales}, {"tf*.static_gain_n": {"N": 1}}))


def _facts(sines: SineSet) -> dict[str, float]:
    """Return the arm that converted torques to thrust, if all sines have the same."""
    arms = {rig.loadcell.arm_mm for rig in sines.rigs if rig.loadcell.arm_mm is not None}
    return {"loadcell.arm_mm": arms.pop()} if len(arms) == 1 and sines.channel != "Fz" else {}


def _of_fit(
    found: Identified, thesis: ThesisFit | str, sines: SineSet, comparison: Comparison, *, settle_s: float
) -> Result:
    fit = found.fit
    ours = GainAndLag(fit.dynamics.static_gain_n, fit.time_constant_s)
    of_thesis = None if isinstance(thesis, str) else thesis
    joint = _function("tf", fit)
    each = {name: _function(f"tf.series.{name}", own) for name, own in found.each.items()}
    rows = [
        {"series": series.name, **_row(own.periods, own.frequency_rad_s, own.value), "std": own.std}
        for series in fit.measured
        for own in series.responses
    ]
    return Result(
        command="tf identify",
        section=SECTION,
        method="default",
        quantities={
            **joint,
            "tf.sample_time_s": Parameter(value=fit.sample_s),
            **{key: quantity for own in each.values() for key, quantity in own.items()},
            "tf.frequency_response": Parameter(value=rows),
        },
        wanted=_WANTED,
        covariances=_covariances(fit),
        merits={
            **_merits(found),
            "thesis": None if of_thesis is None else _thesis_merits(of_thesis, "tf"),
            **comparison.merits(ours),
        },
        findings=(*sines.findings, *found.findings, *_findings(found, joint, each), *comparison.findings(ours)),
        sources=sines.sources,
        lines=(
            *fit_lines(found),
            *_thesis_lines(thesis, ours),
            *comparison.lines(ours),
        ),
        drawings=lambda: _fit_figures(found, of_thesis, settle_s),
    )


def _findings(found: Identified, joint: Quantities, each: Mapping[str, Quantities]) -> list[Finding]:
    """Return findings against the joint function and that of each series; a single series is both."""
    if len(found.each) == 1:
        (alone,) = each.values()
        findings = [*found.fit.findings((*joint, *alone))]
    else:
        findings = [
            *found.fit.findings(tuple(joint)),
            *(
                finding.at(f"{name} for itself")
                for name, fit in found.each.items()
                for finding in fit.findings(tuple(each[name]))
            ),
        ]
    if len(found.each) > 1 and not found.fit.accepted and all(fit.accepted for fit in found.each.values()):
        text = "each series has a transfer function, but not the same: identify them one by one."
        findings.append(rejection("series-differ", text, *joint))
    if found.fit.dynamics.static_gain_n <= 0:
        text = "the static gain is negative: thrust falls where the command rises. Is the sign that of the channel?"
        findings.append(warning("static-gain-negative", text, "tf.static_gain_n"))
    return findings + _negative_delay(found.fit.mean_delay)


def _negative_delay(delay: Delay) -> list[Finding]:
    """Return a note where the force precedes its command as stamped, beyond what noise explains."""
    if delay.delay_s >= -COVERAGE_95 * delay.std_s:
        return []
    text = (
        f"the force comes {-1e3 * delay.delay_s:.2f} +- {1e3 * delay.std_s:.2g} ms before its command as stamped: "
        "reports of commands arrive by radio, later than these act. It belongs to the link, not to the motor: where "
        "the radio's shortest latency wanders, within a minute or so, this delay does so too, by more than its "
        "uncertainty."
    )
    return [note("transfer-delay-negative", text, "tf.delay_s")]


def _of_thesis(found: ThesisFits, sines: SineSet, comparison: Comparison) -> Result:
    fit = found.joint
    ours = GainAndLag(fit.static_gain_n, fit.time_constant_s)
    joint = _thesis_function("tf", fit)
    each = {name: _thesis_function(f"tf.series.{name}", own) for name, own in found.each.items()}
    rows = [
        {"series": name, **_row(own.periods, own.omega_rad / SAMPLE_S, own.value), "std": None}
        for name, fitted in found.each.items()
        for own in fitted.responses
    ]
    if len(each) == 1:
        rejections = fit.rejections((*joint, *next(iter(each.values()))))
    else:
        apart = (one for name, own in found.each.items() for one in own.rejections(tuple(each[name])))
        rejections = (*fit.rejections(tuple(joint)), *apart)
    lines: tuple[str | Dependent, ...] = (
        *convention_lines(fit.numerator, fit.denominator, form="thesis", sample_s=SAMPLE_S),
        "latencies of radio and load cell are left out, as in the thesis: the time constant is biased by them",
        *comparison.lines(ours),
    )
    return Result(
        command="tf identify",
        section=SECTION,
        method="thesis",
        quantities={
            **joint,
            "tf.sample_time_s": Parameter(value=SAMPLE_S),
            **{key: quantity for own in each.values() for key, quantity in own.items()},
            "tf.frequency_response": Parameter(value=rows),
        },
        wanted=_WANTED,
        merits={
            "form": "thesis",
            "frequencies": len(fit.responses),
            "series": {name: _thesis_merits(own, f"tf.series.{name}") for name, own in found.each.items()},
            **comparison.merits(ours),
        },
        findings=(*sines.findings, *fit.findings, *rejections, *comparison.findings(ours)),
        sources=sines.sources,
        lines=lines,
        drawings=lambda: _thesis_figures(found),
    )


def _function(key: str, fit: TransferFit) -> Quantities:
    """Return a transfer function's quantities; for several series, the mean of their delays."""
    std, delay = fit.std, fit.mean_delay
    found = {
        "numerator": Parameter(value=fit.numerator.tolist(), std=std.numerator.tolist()),
        "denominator": Parameter(value=fit.denominator.tolist(), std=std.denominator.tolist()),
        "time_constant_s": Parameter(value=fit.time_constant_s, std=fit.time_constant_std_s),
        "static_gain_n": Parameter(value=fit.dynamics.static_gain_n, std=std.static_gain_n),
        "delay_s": Parameter(value=delay.delay_s, std=delay.std_s),
        "delay_after_quickest_s": Parameter(value=delay.after_quickest_s, std=delay.after_quickest_std_s),
    }
    if key == "tf" and len(fit.dynamics.lags_s) > 1:
        found["lags_s"] = Parameter(value=list(fit.dynamics.lags_s), std=list(std.lags_s))
    if key == "tf" and fit.shape == "zero":
        found["lead_s"] = Parameter(value=fit.dynamics.lead_s, std=std.lead_s)
    return {f"{key}.{name}": quantity for name, quantity in found.items()}


def _thesis_function(key: str, fit: ThesisFit) -> Quantities:
    """Return the quantities by the thesis method, which has no uncertainties and assumes a delay of zero."""
    return {
        f"{key}.numerator": Parameter(value=fit.numerator.tolist()),
        f"{key}.denominator": Parameter(value=fit.denominator.tolist()),
        f"{key}.time_constant_s": Parameter(value=fit.time_constant_s),
        f"{key}.static_gain_n": Parameter(value=fit.static_gain_n),
        f"{key}.delay_s": Parameter(value=0.0),
    }


def _covariances(fit: TransferFit) -> tuple[Covariance, ...]:
    """Return the covariance of the joint transfer function's values."""
    values = {
        "tf.numerator": fit.numerator.tolist(),
        "tf.denominator": fit.denominator.tolist(),
        "tf.static_gain_n": fit.dynamics.static_gain_n,
        "tf.time_constant_s": fit.time_constant_s,
        "tf.delay_s": fit.mean_delay.delay_s,
    }
    covariance = fit.std.covariance.copy()
    covariance[-1, -1] = fit.mean_delay.std_s**2  # including that of the mean delay of stamps
    return covariance_between(values, covariance)


def _merits(found: Identified) -> dict[str, Any]:
    fit = found.fit
    return {
        "shape": fit.shape,
        "form": fit.form,
        "frequencies": len(fit.model),
        "chi_squared": fit.chi_squared,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "probability": fit.probability,
        "misfit": fit.misfit,
        "corrected_aic": found.aicc,
        "series": {
            name: {
                "mean_lateness_s": series.mean_lateness_s,
                "clock_skew": [line.skew for line in series.lines],
                "clock_skew_std": [line.rate_std / line.rate**2 for line in series.lines],
                "runs": len(series.runs),
            }
            for name, series in found.aligned.items()
        },
    }


def _thesis_merits(fit: ThesisFit, of: str) -> dict[str, Dependent]:
    """Return the thesis method's values to compare with the transfer function `of` a key, or as those of a series."""
    found = {
        "numerator": fit.numerator.tolist(),
        "denominator": fit.denominator.tolist(),
        "static_gain_n": fit.static_gain_n,
        "time_constant_s": fit.time_constant_s,
    }
    return {name: Dependent(one, f"{of}.{name}") for name, one in found.items()}


def _thesis_lines(thesis: ThesisFit | str, ours: GainAndLag) -> list[str | Dependent]:
    """Return the thesis method's result for the same runs, or why there is none."""
    if isinstance(thesis, str):
        return [f"thesis method: no result: {thesis}"]
    theirs = GainAndLag(thesis.static_gain_n, thesis.time_constant_s)
    return [compared(f"thesis method, latency left out: {theirs.text(ours)}")]


def _row(periods: int, frequency_rad_s: float, value: complex) -> dict[str, Any]:
    return {"l": periods, "frequency_rad_s": frequency_rad_s, "magnitude": abs(value), "phase_rad": phase(value)}


def _fit_figures(found: Identified, thesis: ThesisFit | None, settle_s: float) -> Figures:
    from cfid.transfer.figures import fit_figures

    return fit_figures(found, thesis=thesis, settle_s=settle_s)


def _thesis_figures(found: ThesisFits) -> Figures:
    from cfid.transfer.figures import thesis_bode_figure

    return {"tf_bode_thesis": thesis_bode_figure(found.each, found.joint, sample_s=SAMPLE_S)}
