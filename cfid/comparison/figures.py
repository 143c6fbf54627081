"""Draw claims over the reference, each with its 95 % interval, on a logarithmic axis."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from cfid.comparison.claims import Comparison
from cfid.drawing.style import ALERT, MODEL, MUTED, RECORDED, figure, styled
from cfid.units import COVERAGE_95

_ROW_IN, _HEAD_IN = 0.16, 0.8
_LEAST, _MOST = 0.2, 5.0  # ratios beyond are drawn at the edge


@styled
def comparison_figure(comparisons: Sequence[Comparison], *, name: str) -> Figure:
    """Return one row a claim, by quantity: its ratio to the campaign's value, or to the median of the claims.

    `name` is the campaign's vehicle, "" without a campaign.
    """
    title = f"{name}: published values over measured ones" if name else "Published values over their median"
    notes = ["a band is the measured value with its 95 % interval; red values are excluded by it."] if name else []
    shown = [each for each in comparisons if each.reference and each.claims]
    rows = sum(1 + len(each.claims) for each in shown)
    page, grid = figure(1, 1, heights_in=[_HEAD_IN + _ROW_IN * rows], title=title, notes=notes)
    axes, names, place = page.add_subplot(grid[0, 0]), dict[int, str](), 0
    for comparison in shown:
        own, names[place] = comparison.own, comparison.quantity
        if own is not None and own.std:
            half = COVERAGE_95 * own.std / abs(own.value)
            axes.barh(
                place + len(comparison.claims) / 2, 2 * half, len(comparison.claims) + 1, 1 - half, color="#CCE5F5"
            )
        for row, claim in enumerate(comparison.claims, start=place + 1):
            names[row] = f"{claim.who}, {claim.vehicle}"
            ratio = min(max(comparison.ratio(claim) or _LEAST, _LEAST), _MOST)
            half = COVERAGE_95 * (claim.std or 0.0) / abs(comparison.reference)
            colour = ALERT if comparison.excluded(claim) else RECORDED if claim.std else MODEL
            axes.errorbar(ratio, row, xerr=half or None, fmt="o", ms=3, capsize=2, color=colour)
        place += 1 + len(comparison.claims)
    axes.axvline(1.0, color=MUTED, lw=0.8)
    axes.set_xscale("log")
    axes.set_xlim(_LEAST, _MOST)
    axes.set_ylim(rows - 0.4, -0.6)
    axes.set_yticks(list(names), list(names.values()), fontsize=6.5)
    for place, label in zip(names, axes.get_yticklabels(), strict=True):
        if names[place] in {each.quantity for each in shown}:
            label.set_fontweight("bold")
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("ratio")
    return page
