"""Convert sine runs to the results of `cfid tf identify` and `cfid tf verify`: quantities, findings, printed lines."""

from cmath import phase
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from math import hypot
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from cfid.errors import CfidError, DataError
from cfid.estimate.common_causes import arm_scales, force_scales, power_law, with_common_causes
from cfid.findings import Finding, rejection, warning
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result
from cfid.records.run import Run
from cfid.transfer.alignment import Sign, SineRun, align, with_end
from cfid.transfer.data import SineSet, read_sines
from cfid.transfer.estimation import Identified, Shape, TransferFit, identify
from cfid.transfer.model import TransferFunction
from cfid.transfer.plan import SAMPLE_S
from cfid.transfer.thesis import ThesisFit, ThesisFits, fit_all
from cfid.transfer.verification import Verification, verify_run
from cfid.units import COVERAGE_95

Quantities = dict[str, Parameter]

SECTION = "tf"

_WANTED = ("tf.numerator", "tf.denominator", "tf.static_gain_n", "tf.time_constant_s", "tf.delay_s")
_BESIDE = ("tf.series.*", "tf.sample_time_s", "tf.delay_after_quickest_s")
_GAIN, _LAG = "tf.static_gain_n", "tf.time_constant_s"
_LARGEST_OFF_SLOPE = 0.1  # of the thrust map's slope: the largest difference of a static gain without a warning


def fit(
    runs: SineSet | Sequence[Run | Path | str],
    *,
    sign: Sign = "auto",
    shape: Shape | Literal["auto"] = "first+delay",
    thrust_poly: Sequence[float] | None = None,
    method: Literal["default", "thesis"] = "default",
) -> Result:
    """Return the transfer function from command to thrust, of all series together and of each of several by itself.

    Runs are those of `cfid log sine`; use `read_sines` for files, and for channels other than the motor's own arm.
    The static gain is compared with the slope of `thrust_poly`, newtons over the command with the highest power first.
    Raises DataError and FitError with a run's name.
    """
    sines = runs if isinstance(runs, SineSet) else read_sines(runs)
    command = sines.runs[0].sine.middle
    slope_n = None if thrust_poly is None else float(np.polyval(np.polyder(np.array(thrust_poly)), command))
    beside = _Beside(slope_n, command)
    if method == "thesis":
        return _of_thesis(fit_all(sines.series, sign=sign), sines, beside)
    found = identify(sines.series, shape=shape, sign=sign)
    try:
        thesis: ThesisFit | str = fit_all(sines.series, sign=sign).joint
    except CfidError as error:
        thesis = str(error)
    result = _of_fit(found, thesis, sines, beside)
    scales = (force_scales if sines.channel == "Fz" else arm_scales)(sines.rigs)
    return with_common_causes(result, power_law(result.quantities, {"N": scales}, {"tf*.static_gain_n": {"N": 1}}))


class _Beside(NamedTuple):
    """What a result is compared with: the thrust map's slope in N at the middle command."""

    slope_n: float | None
    command: float

    def merits(self, gain_n: float) -> dict[str, Any]:
        off = {} if self.slope_n is None else {"static_gain_off_slope": Dependent(gain_n / self.slope_n - 1, _GAIN)}
        return {"thrust_map_slope_n": self.slope_n, **off}

    def findings(self, gain_n: float) -> tuple[Finding, ...]:
        off = 0.0 if self.slope_n is None else gain_n / self.slope_n - 1
        if abs(off) <= _LARGEST_OFF_SLOPE:
            return ()
        text = (
            f"the static gain is {100 * off:+.0f} % off the thrust map's slope (limit {100 * _LARGEST_OFF_SLOPE:.0f} "
            "%): are channel, arm and yaw those of the rig, and is the battery as full as for the map?"
        )
        return (warning("gain-off-map-slope", text, _GAIN),)

    def lines(self, ours: TransferFunction) -> list[Dependent]:
        if self.slope_n is None:
            return []
        off = 100 * (ours.static_gain_n / self.slope_n - 1)
        slope = f"slope of the thrust map at {self.command:.0f}: {self.slope_n:.4g} N"
        return [Dependent(f"{slope}; the static gain is {off:+.2f} % off", _GAIN)]


def compared(name: str, other: TransferFunction, ours: TransferFunction) -> Dependent:
    """Return a line with gain and time constant of another function, each with its difference from ours."""
    off = 100 * (other.static_gain_n / ours.static_gain_n - 1)
    line = f"{name}: static gain {other.static_gain_n:.4g} N ({off:+.1f} %)"
    if other.time_constant_s is None or ours.time_constant_s is None:
        line += ", no decay that makes a time constant"
    else:
        off = 100 * (other.time_constant_s / ours.time_constant_s - 1)
        line += f", time constant {1e3 * other.time_constant_s:.2f} ms ({off:+.1f} %)"
    return Dependent(line, _GAIN, _LAG)


def _of_fit(found: Identified, thesis: ThesisFit | str, sines: SineSet, beside: _Beside) -> Result:
    fit, gain_n = found.fit, found.fit.gain_n
    joint = _quantities("tf", fit)
    if fit.shape == "second":
        joint["tf.lags_s"] = Parameter(value=fit.lags_s.tolist(), std=fit.std[1:3].tolist())
    if fit.shape == "zero":
        joint["tf.lead_s"] = Parameter(value=float(fit.values[2]), std=float(fit.std[2]))
    each = {name: _quantities(f"tf.series.{name}", fit) for name, fit in found.each.items()}
    rows = [
        _row(series.name, response.periods, response.frequency_rad_s, response.value, response.std)
        for series in fit.measured
        for response in series.responses
    ]
    of_thesis = None if isinstance(thesis, str) else thesis
    values = {key: joint[key].value for key in (*_WANTED[:3], _LAG, _WANTED[4])}
    covariance = fit.joint.copy()
    covariance[-1, -1] = fit.mean_delay.std_s**2  # including that of the mean delay of stamps
    return Result(
        command="tf identify",
        section=SECTION,
        method="default",
        quantities={
            **joint,
            "tf.sample_time_s": Parameter(value=fit.function.sample_s),
            **{key: quantity for quantities in each.values() for key, quantity in quantities.items()},
            "tf.frequency_response": Parameter(value=rows),
        },
        wanted=_WANTED,
        beside=_BESIDE,
        facts=_facts(sines),
        covariances=covariance_between(values, covariance),
        merits={
            **_merits(found),
            "thesis": None if of_thesis is None else _thesis_merits(of_thesis, "tf"),
            **beside.merits(gain_n),
        },
        findings=(*sines.findings, *found.findings, *_findings(found, joint, each), *beside.findings(gain_n)),
        sources=sines.sources,
        lines=(
            *_lines(found),
            f"thesis method: no result: {thesis}"
            if isinstance(thesis, str)
            else compared("thesis method, latency left out", thesis.function, fit.function),
            *beside.lines(fit.function),
        ),
        drawings=lambda: _fit_figures(found, of_thesis),
    )


def _of_thesis(found: ThesisFits, sines: SineSet, beside: _Beside) -> Result:
    fit, function = found.joint, found.joint.function
    joint = _thesis_quantities("tf", fit)
    several = found.each if len(found.each) > 1 else {}
    each = {name: _thesis_quantities(f"tf.series.{name}", fit) for name, fit in several.items()}
    rows = [
        _row(name, response.periods, response.omega_rad / SAMPLE_S, response.value, None)
        for name, fit in found.each.items()
        for response in fit.responses
    ]
    return Result(
        command="tf identify",
        section=SECTION,
        method="thesis",
        quantities={
            **joint,
            "tf.sample_time_s": Parameter(value=SAMPLE_S),
            **{key: quantity for quantities in each.values() for key, quantity in quantities.items()},
            "tf.frequency_response": Parameter(value=rows),
        },
        wanted=_WANTED,
        beside=_BESIDE,
        facts=_facts(sines),
        merits={
            "form": "thesis",
            "frequencies": len(fit.responses),
            "series": {
                name: _thesis_merits(fit, f"tf.series.{name}" if several else "tf") for name, fit in found.each.items()
            },
            **beside.merits(function.static_gain_n),
        },
        findings=(
            *sines.findings,
            *fit.findings,
            *fit.rejections(tuple(joint)),
            *(rejected for name, fit in several.items() for rejected in fit.rejections(tuple(each[name]))),
            *beside.findings(function.static_gain_n),
        ),
        sources=sines.sources,
        lines=(
            *_convention(function),
            "latencies of radio and load cell are left out, as in the thesis: the time constant is biased by them",
            *beside.lines(function),
        ),
        drawings=lambda: _thesis_figures(found),
    )


def _facts(sines: SineSet) -> dict[str, float]:
    """Return the arm that converted torques to thrust, if all sines have the same."""
    arms = {rig.loadcell.arm_mm for rig in sines.rigs if rig.loadcell.arm_mm is not None}
    return {"loadcell.arm_mm": arms.pop()} if len(arms) == 1 and sines.channel != "Fz" else {}


def _findings(found: Identified, joint: Quantities, each: Mapping[str, Quantities]) -> list[Finding]:
    """Return findings against the joint function and that of each series."""
    findings = [
        *found.fit.findings(tuple(joint)),
        *(
            finding.at(f"{name} for itself")
            for name, fit in found.each.items()
            for finding in fit.findings(tuple(each[name]))
        ),
    ]
    if found.each and not found.fit.accepted and all(fit.accepted for fit in found.each.values()):
        text = "each series has a transfer function, but not the same: identify them one by one."
        findings.append(rejection("series-differ", text, *joint))
    if found.fit.gain_n <= 0:
        text = "the static gain is negative: thrust falls where the command rises. Is the sign that of the channel?"
        findings.append(warning("static-gain-negative", text, _GAIN))
    return findings


def _quantities(key: str, fit: TransferFit) -> Quantities:
    """Return a transfer function's quantities; for several series, the mean of their delays."""
    delay, function = fit.mean_delay, fit.function
    spread = np.sqrt(np.maximum(np.diag(fit.joint), 0.0))
    numerator, denominator = np.split(spread[:-3], [len(function.numerator)])
    return {
        f"{key}.numerator": Parameter(value=function.numerator.tolist(), std=numerator.tolist()),
        f"{key}.denominator": Parameter(value=function.denominator.tolist(), std=denominator.tolist()),
        f"{key}.time_constant_s": Parameter(value=fit.time_constant_s, std=fit.time_constant_std_s),
        f"{key}.static_gain_n": Parameter(value=fit.gain_n, std=float(fit.std[0])),
        f"{key}.delay_s": Parameter(value=delay.delay_s, std=delay.std_s),
        f"{key}.delay_after_quickest_s": Parameter(value=delay.after_quickest_s, std=delay.after_quickest_std_s),
    }


def _thesis_quantities(key: str, fit: ThesisFit) -> Quantities:
    """Return the quantities by the thesis method, which has no uncertainties and assumes a delay of zero."""
    values = {**_thesis_values(fit), "delay_s": 0.0}
    return {f"{key}.{name}": Parameter(value=value) for name, value in values.items()}


def _thesis_values(fit: ThesisFit) -> dict[str, Any]:
    return {
        "numerator": fit.function.numerator.tolist(),
        "denominator": fit.function.denominator.tolist(),
        "time_constant_s": fit.function.time_constant_s,
        "static_gain_n": fit.function.static_gain_n,
    }


def _thesis_merits(fit: ThesisFit, of: str) -> dict[str, Dependent]:
    """Return the thesis method's values to compare with the transfer function `of` a key, or as those of a series."""
    return {name: Dependent(value, f"{of}.{name}") for name, value in _thesis_values(fit).items()}


def _row(series: str, periods: int, frequency_rad_s: float, value: complex, std: float | None) -> dict[str, Any]:
    return {
        "series": series,
        "l": periods,
        "frequency_rad_s": frequency_rad_s,
        "magnitude": abs(value),
        "phase_rad": phase(value),
        "std": std,
    }


def _merits(found: Identified) -> dict[str, Any]:
    fit = found.fit
    return {
        "shape": fit.shape,
        "form": "hold",
        "frequencies": len(fit.model),
        "chi_squared": fit.chi_squared,
        "degrees_of_freedom": fit.degrees_of_freedom,
        "probability": fit.probability,
        "misfit": fit.misfit,
        "corrected_aic": found.aicc,
        "series": {
            measured.name: {
                "mean_lateness_s": measured.mean_lateness_s,
                "clock_skew": [line.skew for line in found.aligned[measured.name].lines],
                "clock_skew_std": [line.rate_std / line.rate**2 for line in found.aligned[measured.name].lines],
                "loadcell_clock_skew": measured.skew,
                "loadcell_clock_skew_std": measured.skew_std,
                "second_harmonic": [abs(response.second) for response in measured.responses],
                "runs": len(measured.responses),
            }
            for measured in fit.measured
        },
    }


def _lines(found: Identified) -> list[str | Dependent]:
    """Return lines on H(z), chi-squared and the shapes' scores, each of several series, and the delays."""
    fit = found.fit
    lines: list[str | Dependent] = [
        *_convention(fit.function),
        f"chi-squared {fit.chi_squared:.1f} for {fit.degrees_of_freedom} degrees of freedom (probability "
        f"{fit.probability:.2g}): the model {'describes' if fit.described else 'does not describe'} {len(fit.model)} "
        "frequencies",
    ]
    if found.aicc:
        scores = ", ".join(f"{shape} {score:+.1f}" for shape, score in found.aicc.items())
        lines.append(f"corrected AIC above the best: {scores}")
    for name, one in found.each.items():
        delay, keys = one.delays[name], ("static_gain_n", "time_constant_s", "delay_s")
        line = (
            f"{name} for itself: static gain {one.gain_n:.4g} +- {one.std[0]:.2g} N, time constant "
            f"{1e3 * one.time_constant_s:.2f} +- {1e3 * one.time_constant_std_s:.2g} ms, delay "
            f"{1e3 * delay.delay_s:.2f} +- {1e3 * delay.std_s:.2g} ms, chi-squared {one.chi_squared:.1f} of "
            f"{one.degrees_of_freedom}"
        )
        lines.append(Dependent(line, *(f"tf.series.{name}.{key}" for key in keys)))
    for name, delay in fit.delays.items():
        skews = ", ".join(f"{1e6 * line.skew:+.0f} ppm" for line in found.aligned[name].lines)
        clocks = f"; the vehicle's clock is off by {skews}" if skews else "; no stamps of the vehicle"
        # A force that seems to come before its command shows by how much the commands' time stamps are late.
        sign = -1 if delay.delay_s < 0 else 1
        begin = "time stamps of commands are late by" if sign < 0 else "delay after the time stamp of the command:"
        line = (
            f"{name}: {begin} {_milliseconds(sign * delay.delay_s, delay.std_s)} on average, "
            f"{_milliseconds(sign * delay.after_quickest_s, delay.after_quickest_std_s)} for the quickest{clocks}"
        )
        lines.append(Dependent(line, "tf.delay_s", "tf.delay_after_quickest_s"))
    return lines


def _milliseconds(delay_s: float, std_s: float) -> str:
    zero = " (consistent with zero)" if abs(delay_s) <= COVERAGE_95 * std_s else ""
    return f"{1e3 * delay_s:.2f} +- {1e3 * std_s:.2g} ms{zero}"


def _convention(function: TransferFunction) -> list[Dependent]:
    """Return H(z) in rising powers of z^-1, and its form; behind a hold also in that of eq. 3.15."""
    lines = [
        f"H(z) = {function.text}, N of thrust over units of the command",
        f"coefficients of z^0, z^-1, ... at {1e3 * function.sample_s:.5g} ms, leading 1",
    ]
    if function.numerator[0] == 0:
        lines[1] += "; each command is held for a sample and takes effect from then on, hence the numerator's z^-1"
        at_once = replace(function, numerator=function.numerator[1:])
        lines.append(f"as (3.15), with a sample more delay: H(z) = {at_once.text}")
    return [Dependent(line, "tf.numerator", "tf.denominator") for line in lines]


def verify(
    runs: SineSet | Sequence[Run | Path | str],
    function: TransferFunction | Result,
    *,
    used: Collection[str] = (),
    sign: Sign = "auto",
) -> Result:
    """Simulate a transfer function, or that of a result, and compare it with runs it was not identified from.

    `used` are the sha256 of the files that a function was identified from; a result knows its own. Raises DataError for
    a run without a frequency, or one that is too short.
    """
    sines = runs if isinstance(runs, SineSet) else read_sines(runs)
    if isinstance(function, Result):
        used = {source.sha256 for source in function.sources}
        function = TransferFunction.of_quantities(function.quantities)
    findings = list(sines.findings)
    checked: list[tuple[SineRun, Verification]] = []
    if not any(run.sine.periods for run in sines.runs):
        raise DataError(f"{sines.runs[0].name}: has no frequency, and nothing to compare: leave it out.")
    for recorded in sines.series.values():
        turning, lost = with_end([run for run in recorded if run.sine.periods])
        findings += lost
        if not turning:
            continue
        series = align(turning, sign=sign)
        delay_s, std_s = function.after_quickest_s, function.delay_std_s
        if delay_s is None:
            delay_s, std_s = function.delay_s + series.mean_lateness_s, hypot(std_s, series.mean_lateness_std_s)
        checked += [
            (run, verify_run(run, function, after_quickest_s=delay_s, delay_std_s=std_s)) for run in series.runs
        ]
    if again := [source.path for source in sines.sources if source.sha256 in used]:
        text = f"{again[0]}: the transfer function was identified from it: this verifies nothing."
        findings.append(warning("verification-reuses-run", text, "tf.verify.*"))
    quantities: Quantities = {}
    merits, lines = {}, []
    keys = _distinct(check.name.partition(" (")[2].removesuffix(")").removesuffix(".csv") for _, check in checked)
    names = _distinct(check.name for _, check in checked)
    for key, name, (_, check) in zip(keys, names, checked, strict=True):
        own = {
            f"tf.verify.{key}.fit_percent": Parameter(value=check.fit_percent),
            f"tf.verify.{key}.residual_rms_n": Parameter(value=check.residual_rms_n),
            f"tf.verify.{key}.late_s": Parameter(value=check.late_s, std=check.late_std_s),
            f"tf.verify.{key}.gain_ratio": Parameter(value=check.gain_ratio, std=check.gain_ratio_std),
        }
        quantities |= own
        merits[name] = {
            "off": check.off,
            "off_std": check.off_std,
        }
        findings += check.findings(tuple(own))
        lines.append(Dependent(check.text, *own))
    return Result(
        command="tf verify",
        prints_lines=True,
        section="tf verify",
        method="default",
        quantities=quantities,
        wanted=("tf.verify.*",),
        merits={"runs": merits},
        findings=tuple(findings),
        sources=sines.sources,
        lines=tuple(lines),
        drawings=lambda: _verification_figures(checked),
    )


def _distinct(names: Iterable[str]) -> list[str]:
    """Return the names, numbered where one is repeated: files in different folders may have the same name."""
    seen: Counter[str] = Counter()
    distinct = []
    for name in names:
        seen[name] += 1
        distinct.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return distinct


def _fit_figures(found: Identified, thesis: ThesisFit | None) -> Figures:
    from cfid.transfer.figures import fit_figures

    return fit_figures(found, thesis=thesis)


def _thesis_figures(found: ThesisFits) -> Figures:
    from cfid.transfer.figures import thesis_bode_figure

    return {"tf_bode_thesis": thesis_bode_figure(found.each, found.joint)}


def _verification_figures(checked: Sequence[tuple[SineRun, Verification]]) -> Figures:
    from cfid.transfer.figures import verification_figure

    names = _distinct(f"tf_verify_l{run.sine.periods}" for run, _ in checked)
    return {name: verification_figure(run, check) for name, (run, check) in zip(names, checked, strict=True)}
