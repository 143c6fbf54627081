"""Provide `cfid compare`: what others published beside this campaign, or beside each other."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cfid.console.inputs import open_workplace
from cfid.console.options import Figures, Force, Out
from cfid.console.outcome import Delivery, deliver
from cfid.console.program import program
from cfid.console.tables import columned

if TYPE_CHECKING:
    from cfid.comparison.claims import Claim, Comparison
    from cfid.quantities.registry import Platform
    from cfid.records.result import Figures as Drawings

_MOST_ROWS = 15


def compare(
    *,
    vehicle: Annotated[
        Literal["cf2", "cf21bl", "all"] | None,
        typer.Option(help="Vehicle whose published sets are compared; default: rig.toml's platform, else all."),
    ] = None,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Compare your vehicle with what others published, worst first.

    Outside a campaign, published sets are compared with each other: look before you copy one.

    Example: cfid compare --vehicle cf21bl
    """
    from cfid.comparison.claims import comparisons_of, comparisons_with, rows_of
    from cfid.records.result import Result

    platform: Platform | None = "other" if vehicle == "all" else vehicle
    workplace = open_workplace()
    campaign = workplace.campaign
    if campaign is None:
        comparisons = comparisons_of(None, platform or "other")
        lines, name = _between_sets(comparisons), ""
    else:
        comparisons = comparisons_with(campaign, campaign.values(), platform)
        lines, name = _beside(comparisons), campaign.rig.vehicle.name

    def drawings() -> "Drawings":
        from cfid.comparison.figures import comparison_figure

        return {"compare": comparison_figure(comparisons, name=name)}

    result = Result(
        command="compare",
        prints_lines=True,
        method="default",
        quantities={},
        merits={"claims": rows_of(comparisons)},
        lines=tuple(lines),
        drawings=drawings,
    )
    deliver(result, Delivery(force, figures, out), workplace, keep=False)


def _beside(comparisons: "Sequence[Comparison]") -> list[str]:
    """Return published values beside the campaign's, worst first."""
    from cfid.comparison.claims import worst_first

    pairs = [(each, claim) for each, claim in worst_first(comparisons) if each.own is not None]
    excluded = sum(each.excluded(claim) for each, claim in pairs)
    rows = [("quantity", "this campaign", "theirs", "ratio", "apart", "who")]
    rows += [
        (
            f"{each.quantity}, {each.unit}",
            _value(each.own),
            _value(claim),
            _ratio(each.ratio(claim)),
            "" if (far := each.deviations(claim)) is None else f"{far:.3g} std",
            f"{claim.who}, {claim.vehicle}",
        )
        for each, claim in (pairs if program().verbose else pairs[:_MOST_ROWS])
    ]
    unknown = [each.quantity for each in comparisons if each.own is None]
    return [
        f"{excluded} of {len(pairs)} published values are excluded by this campaign, worst first:",
        *columned(rows),
        *([f"not measured here: {', '.join(unknown)}"] if unknown else []),
        *_more(len(pairs) + 1 - len(rows)),
    ]


def _between_sets(comparisons: "Sequence[Comparison]") -> list[str]:
    """Return the least and the largest claim of each quantity, with all claims where asked, the widest first."""
    rows: list[Sequence[str]] = [("quantity", "sets", "least", "who", "largest", "who", "ratio")]
    for each in sorted(comparisons, key=lambda comparison: comparison.spread, reverse=True):
        ordered = sorted(each.claims, key=lambda claim: claim.value)
        ends = (ordered[0], ordered[-1])
        cells = [cell for claim in ends for cell in (_value(claim), f"{claim.who}, {claim.vehicle}")]
        rows.append((f"{each.quantity}, {each.unit}", str(len(ordered)), *cells, _ratio(each.spread)))
        if program().verbose:
            rows += [("", "", _value(claim), f"{claim.who}, {claim.vehicle}", "", "", "") for claim in ordered]
    return columned(rows)


def _value(claim: "Claim | None") -> str:
    return "" if claim is None else f"{claim.value:.4g}{f' ± {claim.std:.2g}' if claim.std else ''}"


def _ratio(ratio: float | None) -> str:
    return "" if ratio is None else "signs differ" if ratio == float("inf") else f"{ratio:.3g}"


def _more(count: int) -> list[str]:
    return [f"{count} more: `verbose` shows all."] if count > 0 else []
