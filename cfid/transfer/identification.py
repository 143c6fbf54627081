"""Identify transfer functions from sine runs: on one time base, responses, one fit for all series and one for each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from cfid.errors import FitError
from cfid.findings import Finding, note, rejection, warning
from cfid.transfer.estimation import MeasuredSeries, TransferFit, fit_transfer, measure
from cfid.transfer.frequency_response import SETTLE_S
from cfid.transfer.likelihood import SHAPES, Shape, unknowns
from cfid.transfer.model import Form
from cfid.transfer.sines.alignment import RecordedSine, Sign, SineSeries, align, with_end
from cfid.transfer.sines.plan import CUTOFF_HZ, above_cutoff

_CLEARLY = 10.0  # of corrected AIC


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """One transfer function for all series, one for each of them, and the shapes' corrected AIC above the least.

    `used` are the runs of the `aligned` series, in the same order. `findings` are those about runs, series and shapes;
    each fit has its own.
    """

    fit: TransferFit
    each: dict[str, TransferFit]
    aicc: dict[Shape, float]
    aligned: dict[str, SineSeries]
    used: dict[str, list[RecordedSine]]
    findings: tuple[Finding, ...]


def identify_all(
    series: Mapping[str, Sequence[RecordedSine]],
    *,
    shape: Shape | Literal["auto"] = "first+delay",
    form: Form = "hold",
    settle_s: float = SETTLE_S,
    cutoff_hz: float = CUTOFF_HZ,
    sign: Sign = "auto",
) -> Identified:
    """Identify all series together and each by itself, from sines up to a frequency.

    `settle_s` at the start of each run is left out; shape "auto" selects the one with the least corrected AIC. Raises
    DataError and FitError with a run's name.
    """
    findings = []
    used = {}
    for name, runs in series.items():
        slow, too_fast = _within(name, runs, cutoff_hz)
        kept, without_end = with_end(slow)
        findings += [*too_fast, *without_end]
        if kept:
            used[name] = kept
    if not used:
        raise FitError(f"no sine run is left up to {cutoff_hz:g} Hz: record slower ones, or raise the cut-off.")
    aligned = {name: align(runs, sign=sign) for name, runs in used.items()}
    measured = [measure(name, own, form=form, settle_s=settle_s) for name, own in aligned.items()]
    for own, responses in zip(aligned.values(), measured, strict=True):
        findings += [*own.findings, *responses.findings]
    fits = fit_shapes(measured)
    aicc = corrected_aic(fits) if fits else {}
    usual: Shape = "first+delay" if shape == "auto" else shape
    chosen = min(aicc, key=lambda own: aicc[own]) if shape == "auto" and aicc else usual
    fit = fits.get(chosen) or fit_transfer(measured, shape=chosen)
    each, unfitted = ({measured[0].name: fit}, []) if len(measured) == 1 else _fit_each(measured, chosen)
    return Identified(
        fit=fit,
        each=each,
        aicc=aicc,
        aligned=aligned,
        used=used,
        findings=(*findings, *unfitted, *_better(chosen, aicc)),
    )


def fit_shapes(measured: Sequence[MeasuredSeries]) -> dict[Shape, TransferFit]:
    """Fit each shape that has fewer parameters than the responses have real and imaginary parts."""
    count = sum(len(series.responses) for series in measured)
    fitting = [shape for shape in SHAPES if 2 * count > unknowns(shape, len(measured)) + 1]
    return {shape: fit_transfer(measured, shape=shape) for shape in fitting}


def corrected_aic(fits: dict[Shape, TransferFit]) -> dict[Shape, float]:
    """Return the corrected AIC of each shape, less the least: the shape with the smallest value is preferred.

    Chi-squared is divided by that of the best-fitting shape per degree of freedom, where this is above 1: what no shape
    describes is scatter (K. P. Burnham, D. R. Anderson, Model selection and multimodel inference, 2002, QAICc).
    """
    scale = max(1.0, min(fit.chi_squared / max(fit.degrees_of_freedom, 1) for fit in fits.values()))
    scores = {}
    for shape, fit in fits.items():
        taken = len(fit.covariance)
        correction = 1 + (taken + 1) / max(fit.degrees_of_freedom - 1, 1)
        scores[shape] = fit.chi_squared / scale + 2 * taken * correction
    least = min(scores.values())
    return {shape: score - least for shape, score in scores.items()}


def _within(name: str, runs: Sequence[RecordedSine], cutoff_hz: float) -> tuple[list[RecordedSine], list[Finding]]:
    """Return the runs with a frequency up to the cut-off, and notes on the others."""
    findings = []
    if any(run.sine.periods == 0 for run in runs):
        findings.append(note("sine-without-frequency", "l = 0 has no frequency and is left out.", "tf.*").at(name))
    if above := above_cutoff([run.sine for run in runs], cutoff_hz):
        findings.append(note("sine-too-fast", f"{above} left out.", "tf.*").at(name))
    return [run for run in runs if run.sine.periods and not run.sine.is_above(cutoff_hz)], findings


def _fit_each(measured: Sequence[MeasuredSeries], shape: Shape) -> tuple[dict[str, TransferFit], list[Finding]]:
    each, findings = {}, []
    for series in measured:
        try:
            each[series.name] = fit_transfer([series], shape=shape)
        except FitError as error:
            against = rejection("series-not-fitted", str(error), f"tf.series.{series.name}.*")
            findings.append(against.at(f"{series.name} for itself"))
    return each, findings


def _better(shape: Shape, aicc: Mapping[Shape, float]) -> list[Finding]:
    if aicc.get(shape, 0.0) < _CLEARLY:
        return []
    best = min(aicc, key=lambda own: aicc[own])
    text = f"'{best}' describes the responses clearly better than '{shape}' (corrected AIC {aicc[shape]:.0f} less)."
    return [warning("transfer-better-shape", text, "tf.*")]
