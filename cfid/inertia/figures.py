"""Figures of the inertia matrix: where its uncertainty comes from, what each swing gives, where to mount better."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from uncertainties import nominal_value, std_dev

from cfid.drawing.numbers import MICRO, plus_minus
from cfid.drawing.rig import mounts_figure
from cfid.drawing.style import (
    ALERT,
    DASHES,
    INK,
    MUTED,
    RECORDED,
    SERIES,
    figure,
    key_column,
    legend,
    name_panel,
    styled,
)
from cfid.findings import texts
from cfid.inertia.comparison import BodyComparison
from cfid.inertia.matrix import InertiaFit
from cfid.quantities.values import ENTRIES
from cfid.records.result import Figures
from cfid.records.rig_file import BodyFrame
from cfid.swing.body import SwungBody, numbers
from cfid.swing.estimation import SwingFit
from cfid.swing.figures import fit_figure
from cfid.swing.window import FreeSwing
from cfid.units import MM

Array = npt.NDArray[np.float64]

_WRITTEN = 8  # places across a page that leave room for a number each
# One colour and one hatch for each group of inputs, so that two budgets can be laid side by side.
_GROUPS = {
    "mass": ("#0072B2", ""),
    "gravity": ("#8C8C00", "xx"),
    "centre of mass": ("#56B4E9", "//"),
    "mount distances": ("#E69F00", ""),
    "axis directions": ("#009E73", "\\\\"),
    "swing fits": ("#D55E00", ".."),
    "fixture": ("#CC79A7", ""),
}


@styled
def budget_figure(fit: InertiaFit, *, axes: Sequence[str]) -> Figure:
    """Return the budget of the six entries, the swings' inertias, and what a millimetre of distance costs.

    `axes` names each swing's mount. The parts of a bar are each group's share of the variance, since standard
    uncertainties do not add up. The last panel shows dI_G/dr for a swing's I_G at other distances.
    """
    rejected = [f"Rejected: {text}" for text in texts(fit.findings, "rejection")]
    heights_in = (2.4, 2.1, 2.6) if fit.residual is None else (2.4, 2.1, 1.5, 2.6)
    rows, notes = len(heights_in), texts(fit.findings, "note", "warning")
    page, grid = figure(
        rows,
        2,
        heights_in=heights_in,
        widths=(1, 0.27),
        title="Inertia about the centre of mass",
        rejections=rejected,
        notes=notes,
    )
    last = rows - 1
    budget, sensitivity = page.add_subplot(grid[0, 0]), page.add_subplot(grid[last, 0])
    key_column(page.add_subplot(grid[0, 1]), _draw_budget(budget, fit))
    _draw_swings(page.add_subplot(grid[1, :]), fit, axes)
    if fit.residual is not None:
        _draw_residuals(page.add_subplot(grid[2, :]), fit.residual, fit, axes)
    key_column(page.add_subplot(grid[last, 1]), _draw_sensitivity(sensitivity, fit, axes, letter="abcd"[last]))
    page.align_ylabels()
    return page


@styled
def testbody_figure(comparisons: Sequence[BodyComparison]) -> Figure:
    """Return a figure of calculated against measured inertias (table 2.5), and of their differences."""
    page, grid = figure(2, 1, heights_in=(2.6, 2.0), title="Test body")
    panels = page.add_subplot(grid[0, 0]), page.add_subplot(grid[1, 0])
    _draw_pairs(panels[0], comparisons)
    _draw_differences(panels[1], comparisons)
    for panel in panels:
        panel.set_xticks(np.arange(len(comparisons)), [comparison.axis for comparison in comparisons])
        panel.set_xlim(-0.6, len(comparisons) - 0.4)
        panel.grid(visible=False, axis="x")
    page.align_ylabels()
    return page


def example_figures(example: tuple[str, FreeSwing, SwingFit] | None) -> Figures:
    """Return the figure of the first swing and its fit by its file name; empty without a recorded swing."""
    if example is None:
        return {}
    name, swing, fit = example
    return {"inertia_swing": fit_figure(swing, fit, title=f"Swing and its fit: {name}")}


def rig_figures(body: SwungBody, axes: Sequence[str], frame: BodyFrame) -> Figures:
    """Draw the axes about which the body swung; a pair of threads has no axis."""
    mounts = {axis: body.mounts[axis] for axis in axes if axis in body.mounts}
    hung = {axis: mount for axis, mount in mounts.items() if mount.threads is None}
    title = "Axes of the swings, as rig.toml states them"
    return {"inertia_mounts": mounts_figure(hung, frame, title=title)} if hung else {}


def _draw_pairs(panel: Axes, comparisons: Sequence[BodyComparison]) -> None:
    calculated, measured = [c.calculated_kg_m2 for c in comparisons], [c.measured_kg_m2 for c in comparisons]
    name_panel(panel, "(a) inertia about the centre of mass", x="mount", y="inertia (10⁻⁶ kg m²)")
    for aside, inertias, colour, hatch, name in (
        (-0.24, calculated, MUTED, "//", "from the drawing"),
        (0.24, measured, RECORDED, "", "from swings"),
    ):
        place = np.arange(len(comparisons)) + aside
        value, spread = (MICRO * np.array([of(one) for one in inertias]) for of in (nominal_value, std_dev))
        panel.bar(place, value, 0.46, color=colour, hatch=hatch, ec="white", lw=0.6, label=name)
        panel.errorbar(place, value, yerr=spread, fmt="none", ecolor=INK, elinewidth=1.2, capsize=3)
        if len(comparisons) <= _WRITTEN // 2:
            for x, number, deviation in zip(place, value, spread, strict=True):
                _write_above(panel, x, number + deviation, plus_minus(number, deviation))
    panel.margins(y=0.12)
    legend(panel)


def _draw_differences(panel: Axes, comparisons: Sequence[BodyComparison]) -> None:
    name_panel(panel, "(b) from swings less from the drawing, one standard uncertainty", x="mount", y="difference (%)")
    panel.axhline(0.0, color=MUTED, lw=0.8)
    for x, comparison in enumerate(comparisons):
        value, spread = (100 * of(comparison.error) for of in (nominal_value, std_dev))
        panel.errorbar(x, value, yerr=spread, fmt="o", ms=5, color=RECORDED, ecolor=INK, elinewidth=1.2, capsize=4)
        if len(comparisons) <= _WRITTEN // 2:
            text = f"{value:+.2f} %, {comparison.deviations:.1f} std"
            _write_above(panel, x, value + spread, text.replace("-", "−"))
    panel.margins(y=0.2)


def _draw_budget(panel: Axes, fit: InertiaFit) -> list[Artist]:
    """Draw one bar for each entry, as high as its standard uncertainty, and return the legend's entries."""
    place = np.arange(len(ENTRIES))
    deviation = MICRO * np.array([fit.std_kg_m2[i, j] for i, j in ENTRIES.values()])
    bottom = np.zeros(len(ENTRIES))
    key: list[Artist] = []  # from the top of the bars downwards
    for group, contribution in fit.budget.items():
        squares = np.array([(MICRO * contribution[i, j]) ** 2 for i, j in ENTRIES.values()])
        part = np.divide(squares, deviation, out=np.zeros_like(squares), where=deviation > 0)
        colour, hatch = _GROUPS.get(group, (MUTED, ""))
        how: dict[str, Any] = {"fc": colour, "hatch": hatch, "ec": "white", "lw": 0.6}
        panel.bar(place, part, 0.62, bottom=bottom, **how)
        key.insert(0, Patch(label=group, **how))
        bottom += part
    for x, ((i, j), height) in enumerate(zip(ENTRIES.values(), deviation, strict=True)):
        share = 100 * height / (MICRO * abs(fit.matrix_kg_m2[i, j]))
        _write_above(panel, x, height, f"{height:#.2g}" if i != j else f"{height:#.2g} ({share:#.2g} %)")
    panel.set_xticks(place, [f"I$_\\mathrm{{{name}}}$" for name in ENTRIES])
    panel.set_xlim(-0.65, len(ENTRIES) - 0.35)
    panel.grid(visible=False, axis="x")
    # A margin alone would have no effect: a part of zero height sticks to the top.
    panel.set_ylim(0, 1.18 * max(deviation.max(), 1e-9))
    name_panel(
        panel, "(a) standard uncertainty of each entry, split by share of the variance",
        x="entry of the matrix", y="std (10⁻⁶ kg m²)",
    )  # fmt: skip
    return key


def _draw_swings(panel: Axes, fit: InertiaFit, axes: Sequence[str]) -> None:
    place = _name_mounts(panel, axes)
    value = MICRO * numbers(fit.axes.about_centre_kg_m2)
    spread = MICRO * np.array([std_dev(inertia) for inertia in fit.axes.about_centre_kg_m2])
    name_panel(panel, "(b) each swing", x="mount", y="I$_\\mathrm{G}$ (10⁻⁶ kg m²)")
    panel.errorbar(place, value, yerr=spread, fmt="o", ms=4, color=RECORDED, ecolor=INK, elinewidth=1.2, capsize=3)
    panel.margins(y=0.2)
    mounts = list(dict.fromkeys(axes))
    if len(mounts) > _WRITTEN:
        return
    for x, mount in enumerate(mounts):
        own = np.array([axis == mount for axis in axes])
        # Swings of one mount share the error of its distance: the uncertainty of their mean is not a simple one.
        several = f"mean {value[own].mean():.4g}"
        text = several if own.sum() > 1 else plus_minus(float(value[own][0]), float(spread[own][0]))
        _write_above(panel, x, float(np.max((value + spread)[own])), text)


def _draw_residuals(panel: Axes, residual: Array, fit: InertiaFit, axes: Sequence[str]) -> None:
    """Draw by how many standard uncertainties each swing misses the matrix; within two is as expected."""
    title = f"(c) swing less matrix: χ² = {fit.chi_squared:.1f} for {fit.degrees_of_freedom} degrees of freedom"
    name_panel(panel, title, x="mount", y="residual (std)")
    panel.axhspan(-2, 2, color=MUTED, alpha=0.18, lw=0)
    panel.axhline(0.0, color=MUTED, lw=0.8)
    colours = [RECORDED if abs(each) <= 2 else ALERT for each in residual]
    panel.vlines(_name_mounts(panel, axes), 0.0, residual, colors=colours, lw=5)
    furthest = max(2.5, 1.15 * float(np.max(np.abs(residual))))
    panel.set_ylim(-furthest, furthest)


def _draw_sensitivity(panel: Axes, fit: InertiaFit, axes: Sequence[str], *, letter: str) -> list[Artist]:
    """Draw dI_G/dr = I_G / r - m r against the distance r for each mount, and return the legend's entries.

    A mount on two threads has no such distance.
    """
    current, mass = numbers(fit.axes.distance_m) / MM, fit.axes.body.mass_kg
    hung, inertias = current > 0, numbers(fit.axes.about_centre_kg_m2)
    if not hung.any():
        panel.set_axis_off()
        return []
    best = np.sqrt(np.maximum(inertias, 0.0) / mass) / MM
    reach = np.concatenate([current[hung], best[hung & (best > 0)]])
    distance = np.linspace(0.8 * reach.min(), 1.12 * reach.max(), 200)
    per_mm = MICRO * MM
    name_panel(
        panel, f"({letter}) what a millimetre of mounting distance costs",
        x="distance from axis to centre of mass (mm)", y="dI$_\\mathrm{G}$/dr (10⁻⁶ kg m² per mm)",
    )  # fmt: skip
    panel.axhline(0.0, color=MUTED, lw=0.8)
    key: list[Artist] = []
    for i, axis in enumerate(dict.fromkeys(itertools.compress(axes, hung))):
        own = np.array([name == axis for name in axes])
        how: dict[str, Any] = {"color": SERIES[i % len(SERIES)], "ls": DASHES[i % len(DASHES)]}
        inertia = float(inertias[own].mean())
        panel.plot(distance, per_mm * (inertia / (MM * distance) - mass * MM * distance), lw=1.1, **how)
        slopes = inertias[own] / (MM * current[own]) - mass * MM * current[own]
        panel.plot(current[own], per_mm * slopes, "o", ms=5.5, color=how["color"])
        panel.plot(best[own].mean(), 0.0, "D", ms=5, mfc="white", color=how["color"])
        label = f"{axis}: {current[own].mean():.1f} → {best[own].mean():.1f} mm"
        key.append(Line2D([], [], marker="o", ms=5, label=label, **how))
    return [*key, Line2D([], [], marker="D", ms=5, mfc="white", color=INK, ls="", label="best distance")]


def _name_mounts(panel: Axes, axes: Sequence[str]) -> Array:
    """Name the mounts below a panel and return each swing's place, those of one mount side by side."""
    mounts = list(dict.fromkeys(axes))
    panel.set_xticks(np.arange(len(mounts)), mounts)
    panel.set_xlim(-0.6, len(mounts) - 0.4)
    panel.grid(visible=False, axis="x")
    places = []
    for i, axis in enumerate(axes):
        before, count = axes[:i].count(axis), axes.count(axis)
        places.append(mounts.index(axis) + 0.5 * ((before + 0.5) / count - 0.5))
    return np.array(places)


def _write_above(panel: Axes, x: float, y: float, text: str) -> None:
    panel.annotate(text, (x, y), xytext=(0, 2.5), textcoords="offset points", ha="center", va="bottom", size=8)
