"""Dropped weights drawn: each fall with the window its speed was taken from (figures 2.7 to 2.9)."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cfid.analysis.friction import Drop
from cfid.report.style import (
    DOUBT,
    INK,
    KEY_IN,
    MODEL,
    MUTED,
    RECORDED,
    RECORDED_BELOW,
    SERIES,
    WINDOW,
    draw_line,
    figure,
    key_row,
    name_panel,
    styled,
)
from cfid.report.wording import plus_minus, shortened

MOST_ROWS = 6  # runs that get a row of their own

_TIME = "time (s)"
_TURN_RAD = 2 * math.pi
_MEAN = "#E69F00"
_LABEL_CHARACTERS = 26
_LISTED_LINES = 9


class _Run(NamedTuple):
    drop: Drop
    label: str
    colour: str


@styled
def drops_figure(drops: Sequence[Drop], *, labels: Sequence[str], title: str = "Dropped weights") -> Figure:
    """Return one row a run, the turned angle at its left and the speed at its right.

    More than six runs share a row with those of the same weight. Times count from each record's first
    sample, as --from and --to do. A run whose speed never settled says so in red.
    """
    alone = len(drops) <= MOST_ROWS
    rows = (
        [[_Run(*run, RECORDED)] for run in zip(drops, labels, strict=True)]
        if alone
        else _by_weight(drops, labels)
    )
    heights_in = [KEY_IN, *[1.9 if len(rows) <= MOST_ROWS else 1.5] * len(rows)]
    columns = 2 if alone else 3
    page, grid = figure(
        len(heights_in), columns, heights_in=heights_in, widths=(1, 1, 0.95)[:columns], title=title
    )
    key_row(page.add_subplot(grid[0, :]), *_key(alone))
    for i, runs in enumerate(rows, start=1):
        turned, speed = page.add_subplot(grid[i, 0]), page.add_subplot(grid[i, 1])
        for run in runs:
            _draw_run(turned, speed, run, alone=alone)
        name_panel(turned, f"{1e3 * runs[0].drop.weight_kg:.4g} g: {_who(runs)}", x=_TIME, y="angle (turns)")
        red = not all(run.drop.settled for run in runs)
        name_panel(speed, _result(runs), x=_TIME, y="speed (rad/s)", colour=DOUBT if red else INK)
        speed.set_ylim(bottom=min(0.0, speed.get_ylim()[0]))
        if not alone:
            _list_runs(page.add_subplot(grid[i, 2]), runs)
    page.align_ylabels()
    return page


def _by_weight(drops: Sequence[Drop], labels: Sequence[str]) -> list[list[_Run]]:
    rows: dict[float, list[_Run]] = {}
    for drop, label in sorted(zip(drops, labels, strict=True), key=lambda run: run[0].weight_kg):
        row = rows.setdefault(drop.weight_kg, [])
        row.append(_Run(drop, label, SERIES[len(row) % len(SERIES)]))
    return list(rows.values())


def _key(alone: bool) -> list[Artist]:
    window = Patch(color=WINDOW, alpha=0.15, label="window")
    mean = Line2D([], [], color=_MEAN, lw=2.0, label="mean in it")
    if not alone:
        return [Line2D([], [], color=INK, lw=1.5, marker="|", ms=6, label="window and mean in it")]
    recorded = Line2D([], [], color=RECORDED_BELOW, lw=2.6, label="recorded")
    return [recorded, Line2D([], [], color=MODEL, label="fit of eq. 2.13 and its slope"), window, mean]


def _who(runs: Sequence[_Run]) -> str:
    return shortened(runs[0].label, _LABEL_CHARACTERS) if len(runs) == 1 else f"{len(runs)} runs"


def _result(runs: Sequence[_Run]) -> str:
    """Return the speed of the runs that settled, or the words that go above those that did not."""
    if len(runs) == 1:
        drop = runs[0].drop
        if drop.settled:
            return plus_minus(drop.speed_rad_per_s, drop.speed_std_rad_per_s, unit="rad/s")
        if not math.isfinite(drop.ripple):
            return "never settled: fell for less than two turns"
        return f"never settled: speed varies by {100 * drop.ripple:.0f} %"
    speeds = [run.drop.speed_rad_per_s for run in runs if run.drop.settled]
    lost = len(runs) - len(speeds)
    if not speeds:
        return f"{lost} of {lost} never settled"
    mean = f"mean {np.mean(speeds):.4g} rad/s"
    return f"{mean}; {lost} of {len(runs)} never settled" if lost else mean


def _draw_run(turned: Axes, speed: Axes, run: _Run, *, alone: bool) -> None:
    drop = run.drop
    angle, ended = drop.angle_rad / _TURN_RAD, drop.time_s[: len(drop.speed)]
    ls = "-" if drop.settled else ":"
    if not alone:
        draw_line(turned, drop.time_s, angle, color=run.colour, lw=1.0, ls=ls)
        draw_line(speed, ended, drop.speed, color=run.colour, lw=0.7, ls=ls)
        window = ([drop.from_s, drop.to_s], [drop.speed_rad_per_s] * 2)
        if drop.settled:
            speed.plot(*window, color=INK, lw=1.5, marker="|", ms=6)
        return
    for axes in (turned, speed):
        shade = WINDOW if drop.settled else DOUBT
        axes.axvspan(
            drop.from_s,
            drop.to_s,
            color=shade,
            alpha=0.13,
            lw=0,
            label="window",
            gid=f"window of {run.label}",
        )
    draw_line(turned, drop.time_s, angle, color=RECORDED_BELOW, lw=2.6)
    draw_line(speed, ended, drop.speed, color=RECORDED_BELOW, lw=1.6)
    draw_line(turned, drop.model_time_s, drop.model_rad / _TURN_RAD, color=MODEL, lw=0.9)
    draw_line(speed, drop.model_time_s, np.gradient(drop.model_rad, drop.model_time_s), color=MODEL, lw=0.9)
    speed.plot([drop.from_s, drop.to_s], [drop.speed_rad_per_s] * 2, color=_MEAN, lw=2.0, ls=ls)


def _list_runs(axes: Axes, runs: Sequence[_Run]) -> None:
    """Write the names of the runs that share a row, each in its colour, the unsettled ones in red."""
    axes.set_axis_off()
    lines: list[tuple[str, str]] = []
    for run in runs:
        name = shortened(run.label, _LABEL_CHARACTERS)
        lines += (
            [(name, run.colour)] if run.drop.settled else [(f"{name}:", DOUBT), ("   never settled", DOUBT)]
        )
    if len(lines) > _LISTED_LINES:
        lines = [*lines[: _LISTED_LINES - 1], ("and more", MUTED)]
    for i, (text, colour) in enumerate(lines):
        axes.annotate(
            text,
            (0, 1),
            xytext=(0, -11.0 * i),
            xycoords="axes fraction",
            textcoords="offset points",
            va="top",
            size=8,
            color=colour,
            parse_math=False,
            in_layout=False,
        )
