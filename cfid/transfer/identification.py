"""Sine runs to transfer functions: on one time base, responses, one fit for all series and one for each."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cfid.errors import FitError
from cfid.transfer.sines.data import SineSet
from cfid.wire.app import SAMPLES_PER_S

if TYPE_CHECKING:
    from cfid.transfer.estimation import Measured, TransferFit
    from cfid.transfer.likelihood import Shape
    from cfid.transfer.sines.alignment import RecordedSine, SineSeries

_FIT = "Model"
_NOMINAL = 1e-3  # by which a frequency may exceed the cut-off: rounding
_CLEARLY = 10.0  # of corrected AIC

FitForm = Annotated[
    Literal["hold", "thesis"],
    typer.Option(help="hold: H(z) has a z^-1; thesis: it has none, as (3.15).", rich_help_panel=_FIT),
]


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What is identified, and from which part of the runs."""

    shape: Annotated[
        Literal["first", "first+delay", "second", "zero", "auto"],
        typer.Option(
            help="A lag, with delay, with a second lag, with a zero; auto: by corrected AIC.", rich_help_panel=_FIT
        ),
    ] = "first+delay"
    form: FitForm = "hold"
    settle_s: Annotated[float, typer.Option(min=0, help="Of each run's beginning left out.", rich_help_panel=_FIT)] = (
        1.0
    )
    cutoff_hz: Annotated[
        float, typer.Option(min=0, help="Runs with faster sines are left out.", rich_help_panel=_FIT)
    ] = 12.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """One transfer function for all series, one for each of them, and the shapes' corrected AIC above the least."""

    fit: "TransferFit"
    each: "dict[str, TransferFit]"
    aicc: "dict[Shape, float]"
    aligned: "dict[str, SineSeries]"
    used: "dict[str, list[RecordedSine]]"
    warnings: tuple[str, ...]


def identify_all(sines: SineSet, options: FitOptions, *, sign: Literal["auto", "+", "-"]) -> Identified:
    """Identify all series together and each for itself. Raises DataError and FitError with a run's name."""
    from cfid.transfer.estimation import corrected_aic, fit_orders, fit_transfer, measure
    from cfid.transfer.sines.alignment import align

    used, warnings = {}, []
    for name, runs in sines.series.items():
        used[name], said = _within(name, runs, options.cutoff_hz)
        warnings += said
    used = {name: runs for name, runs in used.items() if runs}
    if not used:
        raise FitError(f"no sine run is left up to {options.cutoff_hz:g} Hz: record slower ones, or say --cutoff-hz.")
    aligned = {name: align(runs, sign=sign) for name, runs in used.items()}
    measured: list[Measured] = []
    for name, series in aligned.items():
        # What is above the cut-off by the vehicle's own clock is left out already.
        measured.append(measure(name, series, form=options.form, settle_s=options.settle_s, cutoff_hz=float("inf"))[0])
        warnings += series.notes
    fits = fit_orders(measured)
    aicc = corrected_aic(fits) if fits else {}
    usual: Shape = "first+delay" if options.shape == "auto" else options.shape
    chosen = min(aicc, key=lambda own: aicc[own]) if options.shape == "auto" and aicc else usual
    fit = fits.get(chosen) or fit_transfer(measured, shape=chosen)
    each = {measured[0].name: fit} if len(measured) == 1 else _each(measured, chosen, warnings)
    return Identified(
        fit=fit,
        each=each,
        aicc=aicc,
        aligned=aligned,
        used=used,
        warnings=(*warnings, *_downward(fit), *_preferred(chosen, aicc)),
    )


def _within(name: str, runs: "list[RecordedSine]", cutoff_hz: float) -> "tuple[list[RecordedSine], list[str]]":
    """Return the runs that have a frequency up to the cut-off, and a sentence on the others."""

    def hertz(run: "RecordedSine") -> float:
        return SAMPLES_PER_S * run.plan.periods / run.plan.samples

    said = [f"{name}: l = 0 has no frequency and is left out." for run in runs if run.plan.periods == 0][:1]
    above = [str(run.plan.periods) for run in runs if hertz(run) > cutoff_hz * (1 + _NOMINAL)]
    if above:
        said.append(f"{name}: l = {', '.join(above)} above {cutoff_hz:g} Hz left out (--cutoff-hz).")
    return [run for run in runs if 0 < hertz(run) <= cutoff_hz * (1 + _NOMINAL)], said


def _each(measured: "list[Measured]", shape: "Shape", warnings: list[str]) -> "dict[str, TransferFit]":
    from cfid.transfer.estimation import fit_transfer

    each = {}
    for series in measured:
        try:
            each[series.name] = fit_transfer([series], shape=shape)
            warnings += [f"{series.name} for itself: {doubt}" for doubt in each[series.name].doubts]
        except FitError as error:
            warnings.append(f"{series.name} for itself: {error}")
    return each


def _downward(fit: "TransferFit") -> list[str]:
    if fit.dynamics.static_gain_n > 0:
        return []
    return ["the static gain is negative: thrust falls where the command rises. Is --sign that of the channel?"]


def _preferred(shape: "Shape", aicc: "dict[Shape, float]") -> list[str]:
    if aicc.get(shape, 0.0) < _CLEARLY:
        return []
    best = min(aicc, key=lambda own: aicc[own])
    return [f"'{best}' describes the responses clearly better than '{shape}' (corrected AIC {aicc[shape]:.0f} less)."]
