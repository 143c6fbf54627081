"""Panels of dropped weights: one run with its fit, or several runs of one weight on top of each other."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cfid.drawing.numbers import plus_minus, shortened
from cfid.drawing.style import ALERT, INK, MODEL, MUTED, RECORDED_BELOW, WINDOW, draw_line
from cfid.friction.drops import Drop

LABEL_CHARACTERS = 40

_TURN_RAD = 2 * np.pi
_MEAN = "#E69F00"
_LISTED_CHARACTERS = 26
_LISTED_LINES = 9
_LINE_PT = 11.0


class DrawnDrop(NamedTuple):
    """A dropped weight with the name and the colour in which it is drawn."""

    drop: Drop
    label: str
    colour: str


def key_alone() -> list[Artist]:
    """Return the legend of panels that show one run each."""
    return [
        Line2D([], [], color=RECORDED_BELOW, lw=2.6, label="recorded"),
        Line2D([], [], color=MODEL, label="fit of eq. 2.13 and its slope"),
        Patch(color=WINDOW, alpha=0.15, label="window"),
        Line2D([], [], color=_MEAN, lw=2.0, label="mean in it"),
    ]


def key_together() -> list[Artist]:
    """Return the legend of panels that show several runs."""
    return [Line2D([], [], color=INK, lw=1.5, marker="|", ms=6, label="window and mean in it")]


def draw_alone(turned: Axes, speed: Axes, run: DrawnDrop) -> None:
    """Draw a run's angle and speed with the window, its mean and the fit of eq. 2.13 with its slope."""
    drop = run.drop
    for axes in (turned, speed):
        axes.axvspan(drop.from_s, drop.to_s, color=WINDOW if drop.settled else ALERT, alpha=0.13, lw=0, label="window")
    draw_line(turned, drop.time_s, drop.angle_rad / _TURN_RAD, color=RECORDED_BELOW, lw=2.6)
    draw_line(speed, drop.time_s[:-1], drop.trace_rad_per_s, color=RECORDED_BELOW, lw=1.6)
    draw_line(turned, drop.model_time_s, drop.model_rad / _TURN_RAD, color=MODEL, lw=0.9)
    draw_line(speed, drop.model_time_s, np.gradient(drop.model_rad, drop.model_time_s), color=MODEL, lw=0.9)
    window = [drop.from_s, drop.to_s], [drop.speed_rad_per_s] * 2
    speed.plot(*window, color=_MEAN, lw=2.0, ls="-" if drop.settled else ":", label="mean")


def draw_together(turned: Axes, speed: Axes, run: DrawnDrop) -> None:
    """Draw one of several runs in its colour, dotted and without a mean if its speed never settled."""
    drop = run.drop
    ls = "-" if drop.settled else ":"
    draw_line(turned, drop.time_s, drop.angle_rad / _TURN_RAD, color=run.colour, lw=1.0, ls=ls)
    draw_line(speed, drop.time_s[:-1], drop.trace_rad_per_s, color=run.colour, lw=0.7, ls=ls)
    if drop.settled:
        window = [drop.from_s, drop.to_s], [drop.speed_rad_per_s] * 2
        speed.plot(*window, color=INK, lw=1.5, marker="|", ms=6, label="mean")


def speed_title(runs: Sequence[DrawnDrop]) -> str:
    """Return the speed of the runs that settled, or the title of those that did not."""
    settled = [run.drop for run in runs if run.drop.settled]
    if len(runs) > 1:
        mean = [f"{np.mean([drop.speed_rad_per_s for drop in settled]):.4g} rad/s"] if settled else []
        lost = len(runs) - len(settled)
        return "; ".join([*mean, *([f"{lost} of {len(runs)} never settled"] if lost else [])])
    drop = runs[0].drop
    if settled:
        speed = plus_minus(drop.speed_rad_per_s, drop.speed_std_rad_per_s)
        return f"{speed}, tends to {drop.terminal_rad_per_s:.4g} rad/s"
    if not np.isfinite(drop.ripple):
        return "never settled: less than two turns"
    return f"never settled: speed varies by {100 * drop.ripple:.0f} %"


def list_runs(axes: Axes, runs: Sequence[DrawnDrop]) -> None:
    """Write the names of the runs that share a row, each in its colour, the unsettled ones in red."""
    axes.set_axis_off()
    lines: list[tuple[str, str]] = []
    for run in runs:
        # The row names the weight already.
        name = shortened(run.label.removeprefix(f"{grams(run.drop)}, "), _LISTED_CHARACTERS)
        lines += [(name, run.colour)] if run.drop.settled else [(f"{name}:", ALERT), ("   never settled", ALERT)]
    if len(lines) > _LISTED_LINES:
        lines = [*lines[: _LISTED_LINES - 1], ("and more", MUTED)]
    for i, (text, colour) in enumerate(lines):
        axes.annotate(
            text, (0, 1), xytext=(0, -_LINE_PT * i), xycoords="axes fraction", textcoords="offset points",
            va="top", size=8, color=colour, parse_math=False, in_layout=False,
        )  # fmt: skip


def grams(drop: Drop) -> str:
    """Return the weight as scales show it."""
    return f"{1e3 * drop.weight_kg:.4g} g"
