"""Figures of the axis' friction: the dropped weights (figures 2.7 to 2.9), and torque against speed."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cfid.drawing.numbers import MICRO, plus_minus, shortened
from cfid.drawing.style import (
    ALERT,
    INK,
    KEY_IN,
    MODEL,
    MUTED,
    RECORDED,
    RECORDED_BELOW,
    WINDOW,
    draw_line,
    figure,
    key_row,
    name_panel,
    styled,
    words,
)
from cfid.findings import texts
from cfid.friction.drops import Drop
from cfid.friction.estimation import FrictionEstimate, thesis_friction

_LABEL_CHARACTERS = 40

_TURN_RAD = 2 * np.pi
_MEAN = "#E69F00"
_FEW_ROWS = 6  # more of them are lower

_TIME = "time (s)"
_SPEED = "speed (rad/s)"
_NANO = 1e9
_THESIS = "thesis: mean M_fr"


@styled
def drops_figure(drops: Sequence[Drop], *, labels: Sequence[str]) -> Figure:
    """Return one row per run, with the turned angle on the left and the speed on the right.

    Times count from each record's first sample, as for a window set by hand. A run whose speed never settled is marked
    in red.
    """
    height_in = 1.9 if len(drops) <= _FEW_ROWS else 1.5
    page, grid = figure(len(drops) + 1, 2, heights_in=[KEY_IN, *[height_in] * len(drops)], title="Dropped weights")
    key_row(
        page.add_subplot(grid[0, :]),
        Line2D([], [], color=RECORDED_BELOW, lw=2.6, label="recorded"),
        Line2D([], [], color=MODEL, label="fit of eq. 2.13 and its slope"),
        Patch(color=WINDOW, alpha=0.15, label="window"),
        Line2D([], [], color=_MEAN, lw=2.0, label="mean in it"),
    )
    for i, (drop, label) in enumerate(zip(drops, labels, strict=True), start=1):
        turned, speed = page.add_subplot(grid[i, 0]), page.add_subplot(grid[i, 1])
        _draw_run(turned, speed, drop)
        name_panel(turned, shortened(label, _LABEL_CHARACTERS), x=_TIME, y="angle (turns)")
        name_panel(speed, _speed_title(drop), x=_TIME, y=_SPEED, colour=INK if drop.settled else ALERT)
        speed.set_ylim(bottom=min(0.0, speed.get_ylim()[0]))
    page.align_ylabels()
    return page


@styled
def friction_figure(
    drops: Sequence[Drop],
    friction: FrictionEstimate,
    *,
    radius_m: float,
    gravity_mps2: float,
) -> Figure:
    """Return a figure of the weights' torque against the speed of their fall, and of the thesis' coefficients.

    The line is Coulomb plus viscous friction, through the speeds that the falls tend to. Bars are standard
    uncertainties of weights and mean speeds; that of the speed that a fall tends to is not known from one fall. The
    thesis' M_fr = m g r / speed is the slope from the origin to the mean speed in a run's window, so with dry friction
    it depends on the speed, as in the first five runs of table 2.1.
    """
    notes = texts(friction.findings, "note", "warning", "rejection")
    page, grid = figure(3, 2, heights_in=(KEY_IN, 2.9, 0.95), title="Friction of the axis", notes=notes)
    thesis = thesis_friction(drops)
    key_row(page.add_subplot(grid[0, :]), *_key(friction, all(drop.settled for drop in drops)))
    torque_axes, coefficient_axes = page.add_subplot(grid[1, 0]), page.add_subplot(grid[1, 1])
    name_panel(torque_axes, "(a) torque of the weight", x=_SPEED, y="torque (µN m)")
    name_panel(coefficient_axes, "(b) torque over speed: M_fr of eq. 2.14", x=_SPEED, y="coefficient (µN m s/rad)")
    for drop in drops:
        _draw_drop(torque_axes, coefficient_axes, drop, MICRO * drop.weight_kg * gravity_mps2 * radius_m)
    speed = np.linspace(0.0, 1.03 * torque_axes.get_xlim()[1], 300)[1:]
    highest = coefficient_axes.get_ylim()[1]
    for found, colour, ls in ((friction, MODEL, "-"), (thesis, MUTED, "--")):
        if found.viscous_nms_per_rad is None:
            continue
        line = MICRO * ((found.coulomb_nm or 0.0) + found.viscous_nms_per_rad * speed)
        torque_axes.plot(speed, line, color=colour, ls=ls, zorder=1.5)
        coefficient_axes.plot(speed, line / speed, color=colour, ls=ls, zorder=1.5)
    for axes in (torque_axes, coefficient_axes):
        axes.set_xlim(0.0, speed[-1])
        axes.set_ylim(bottom=0.0)
    coefficient_axes.set_ylim(top=1.1 * highest)
    words(page.add_subplot(grid[2, 0]), _name(friction), _numbers(friction))
    words(page.add_subplot(grid[2, 1]), _THESIS, _numbers(thesis))
    page.align_ylabels()
    return page


def _draw_drop(torque_axes: Axes, coefficient_axes: Axes, drop: Drop, torque: float) -> None:
    mean, mean_std = drop.speed_rad_per_s, drop.speed_std_rad_per_s
    points: list[tuple[float, float, dict[str, Any]]] = [
        (mean, mean_std, {"marker": "o", "color": ALERT, "mfc": "white"})
    ]
    if drop.settled:
        points = [
            (drop.terminal_rad_per_s, 0.0, {"marker": "o", "color": RECORDED}),
            (mean, mean_std, {"marker": "x", "color": MUTED}),
        ]
    of_weight = drop.weight_std_kg / drop.weight_kg
    for speed, speed_std, how in points:
        relative = np.hypot(of_weight, speed_std / speed)
        for axes, value, std in (
            (torque_axes, torque, torque * of_weight),
            (coefficient_axes, torque / speed, torque / speed * relative),
        ):
            axes.plot(speed, value, ms=5, ls="", **how)
            axes.errorbar(speed, value, std, speed_std or None, fmt="none", ecolor=how["color"], elinewidth=0.9)


def _key(friction: FrictionEstimate, all_settled: bool) -> list[Artist]:
    unsettled = Line2D([], [], color=ALERT, mfc="white", marker="o", ls="", ms=5, label="never settled, not used")
    return [
        Line2D([], [], color=MODEL, mfc=RECORDED, mec=RECORDED, marker="o", ms=5, label=_name(friction)),
        Line2D([], [], color=MUTED, ls="--", marker="x", ms=5, label=_THESIS),
        *([] if all_settled else [unsettled]),
    ]


def _name(friction: FrictionEstimate) -> str:
    if friction.viscous_nms_per_rad is None:
        return "not determined"
    return "viscous alone" if friction.coulomb_nm is None else "Coulomb and viscous"


def _numbers(found: FrictionEstimate) -> list[tuple[str, str]]:
    def row(name: str, value: float | None, std: float | None, scale: float, unit: str) -> tuple[str, str]:
        if value is None:
            return name, "not determined"
        return name, plus_minus(scale * value, scale * (std or 0.0), unit=unit)

    return [
        row("viscous", found.viscous_nms_per_rad, found.viscous_std, MICRO, "µN m s/rad"),
        row("Coulomb", found.coulomb_nm, found.coulomb_std, MICRO, "µN m"),
        row("set-up's inertia", found.setup_inertia_kg_m2, found.setup_inertia_std, _NANO, "10⁻⁹ kg m²"),
    ]


def _draw_run(turned: Axes, speed: Axes, drop: Drop) -> None:
    """Draw a run's angle and speed with the window, its mean and the fit of eq. 2.13 with its slope."""
    for axes in (turned, speed):
        axes.axvspan(drop.from_s, drop.to_s, color=WINDOW if drop.settled else ALERT, alpha=0.13, lw=0, label="window")
    draw_line(turned, drop.time_s, drop.angle_rad / _TURN_RAD, color=RECORDED_BELOW, lw=2.6)
    draw_line(speed, drop.time_s[:-1], drop.trace_rad_per_s, color=RECORDED_BELOW, lw=1.6)
    draw_line(turned, drop.model_time_s, drop.model_rad / _TURN_RAD, color=MODEL, lw=0.9)
    draw_line(speed, drop.model_time_s, np.gradient(drop.model_rad, drop.model_time_s), color=MODEL, lw=0.9)
    window = [drop.from_s, drop.to_s], [drop.speed_rad_per_s] * 2
    speed.plot(*window, color=_MEAN, lw=2.0, ls="-" if drop.settled else ":", label="mean")


def _speed_title(drop: Drop) -> str:
    if drop.settled:
        speed = plus_minus(drop.speed_rad_per_s, drop.speed_std_rad_per_s)
        return f"{speed}, tends to {drop.terminal_rad_per_s:.4g} rad/s"
    if not np.isfinite(drop.ripple):
        return "never settled: less than two turns"
    return f"never settled: speed varies by {100 * drop.ripple:.0f} %"
