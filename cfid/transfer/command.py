"""`cfid tf identify`: sine runs to the transfer function of motor and rotor."""

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cfid.console.inputs import Workplace, open_workplace
from cfid.console.options import Delivery, LoadCellOptions, Method, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.findings import rejection, warning
from cfid.records.result import Result
from cfid.transfer.identification import FitOptions, identify_all
from cfid.transfer.sines.data import SineInputs, SineSet, Words, read_sines
from cfid.transfer.thesis_options import ThesisOptions, beside_thesis, fit_as_thesis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.transfer.identification import Identified
    from cfid.transfer.thesis_options import AsThesis

SECTION = "tf"

Compare = Annotated[Literal["eq3.15", "eq3.16"] | None, typer.Option(help="A result of the thesis to compare with.")]


@flat
def identify(
    *,
    runs: Words = None,
    inputs: SineInputs,
    fit: FitOptions,
    thesis: ThesisOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
    compare: Compare = None,
    method: Method = "default",
) -> None:
    """Identify thrust over command: gain, time constant and delay, from sines of many frequencies (section 3.4).

    H(z) is given in z^-1 with the denominator's leading 1. The delay counts from the stamps of the reports.

    Example: [bold]cfid tf identify 2026-11-21_083012_sine_l1 2026-11-21_083030_sine_l2 ...[/bold]
    """
    workplace = open_workplace(rig)
    sines = read_sines(runs or [], inputs, reading, scale, workplace)
    if method == "thesis":
        calculated = fit_as_thesis(sines, thesis, sign=inputs.sign)
        outcome = _of_thesis(calculated, sines, workplace, compare)
    else:
        found = identify_all(sines, fit, sign=inputs.sign)
        beside = beside_thesis(sines, thesis, sign=inputs.sign)
        outcome = _of_fit(found, beside, sines, workplace, compare, settle_s=fit.settle_s)
    deliver(outcome, delivery, workplace.campaign)


def _of_fit(
    found: "Identified",
    thesis: "AsThesis | str",
    sines: SineSet,
    workplace: Workplace,
    compare: str | None,
    *,
    settle_s: float,
) -> Result:
    from cfid.transfer import result as told
    from cfid.transfer.comparison import compared, map_slope, thesis_beside
    from cfid.transfer.thesis_options import as_json

    gain_n, lag_s = found.fit.dynamics.static_gain_n, found.fit.time_constant_s
    published = compared(compare, gain_n, lag_s)
    slope = map_slope(workplace, gain_n, command=sines.runs[0].plan.middle)
    joint = thesis if isinstance(thesis, str) else thesis.joint

    def drawings() -> "dict[str, Figure]":
        from cfid.transfer.drawings import fit_drawings

        return fit_drawings(found, thesis=None if isinstance(joint, str) else joint, settle_s=settle_s)

    return Result(
        command="tf identify",
        section=SECTION,
        method="default",
        quantities=told.fit_parameters(found),
        covariances=told.fit_covariances(found),
        quality={
            **told.fit_quality(found),
            **slope.quality,
            "thesis": None if isinstance(joint, str) else as_json(joint),
            "compared": published.quality,
        },
        findings=(
            *(
                warning("tf-warning", text)
                for text in (
                    *sines.warnings,
                    *found.warnings,
                    *slope.warnings,
                    *(found.fit.doubts if found.fit.believed else ()),
                )
            ),
            *(
                rejection("tf-rejected", text, "tf.*")
                for text in (() if found.fit.believed else (*found.fit.doubts, *_apart(found)))
            ),
        ),
        sources=sines.sources,
        lines=(*told.fit_lines(found), thesis_beside(joint, gain_n, lag_s), *slope.lines, *published.lines),
        drawings=drawings,
        folder=workplace.figures_beside(sines.paths),
    )


def _of_thesis(found: "AsThesis", sines: SineSet, workplace: Workplace, compare: str | None) -> Result:
    from cfid.transfer import result as told
    from cfid.transfer.comparison import compared, map_slope
    from cfid.transfer.sines.reports import SAMPLE_S
    from cfid.transfer.thesis_options import as_json

    fit = found.joint
    published = compared(compare, fit.static_gain_n, fit.time_constant_s)
    slope = map_slope(workplace, fit.static_gain_n, command=sines.runs[0].plan.middle)

    def drawings() -> "dict[str, Figure]":
        from cfid.transfer.drawings import thesis_drawings

        return thesis_drawings(found)

    return Result(
        command="tf identify",
        section=SECTION,
        method="thesis",
        quantities=told.thesis_parameters(found),
        quality={
            "form": "thesis",
            "frequencies": len(fit.responses),
            **slope.quality,
            "series": {name: as_json(own) for name, own in found.each.items()},
            "compared": published.quality,
        },
        findings=(
            *(warning("tf-warning", text) for text in (*sines.warnings, *fit.notes, *slope.warnings)),
            *(rejection("tf-rejected", text, "tf.*") for text in fit.doubts),
        ),
        sources=sines.sources,
        lines=(
            *told.convention_lines(fit.numerator, fit.denominator, form="thesis", sample_s=SAMPLE_S),
            "latencies of radio and load cell are left out, as in the thesis: the time constant is biased by them",
            *slope.lines,
            *published.lines,
        ),
        drawings=drawings,
        folder=workplace.figures_beside(sines.paths),
    )


def _apart(found: "Identified") -> tuple[str, ...]:
    """Return a word on series that are believed one by one and not together."""
    if len(found.each) < 2 or not all(fit.believed for fit in found.each.values()):
        return ()
    return ("each series has a transfer function, but not the same: identify them one by one.",)
