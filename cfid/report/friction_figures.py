"""Friction of the axis against speed: all dropped weights together, and the thesis' single coefficients."""

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cfid.analysis.friction import Drop, Friction, thesis_friction
from cfid.report.style import (
    DOUBT,
    KEY_IN,
    MODEL,
    MUTED,
    RECORDED,
    figure,
    key_row,
    name_panel,
    styled,
    words,
)
from cfid.report.wording import plus_minus

_SPEED = "speed (rad/s)"
_MICRO = 1e6
_NANO = 1e9
_THESIS = "thesis: mean M_fr"


@styled
def friction_figure(
    drops: Sequence[Drop],
    friction: Friction,
    *,
    radius_m: float,
    gravity_mps2: float,
    title: str = "Friction of the axis",
) -> Figure:
    """Return the torque of the weights against the speed they settled at, and the thesis' coefficients.

    The line is Coulomb plus viscous friction. The thesis' M_fr = m g r / speed is the slope from the origin
    to a run, so that with dry friction it depends on the speed: table 2.1's first five runs.
    """
    page, grid = figure(3, 2, heights_in=(KEY_IN, 2.9, 0.95), title=title, notes=friction.warnings)
    thesis = thesis_friction(drops)
    key_row(page.add_subplot(grid[0, :]), *_key(friction, all(drop.settled for drop in drops)))
    torque_axes, coefficient_axes = page.add_subplot(grid[1, 0]), page.add_subplot(grid[1, 1])
    name_panel(torque_axes, "(a) torque of the weight", x=_SPEED, y="torque (µN m)")
    name_panel(
        coefficient_axes, "(b) torque over speed: M_fr of eq. 2.14", x=_SPEED, y="coefficient (µN m s/rad)"
    )
    for drop in drops:
        torque = _MICRO * drop.weight_kg * gravity_mps2 * radius_m
        _draw_point(torque_axes, drop, torque)
        _draw_point(coefficient_axes, drop, torque / drop.speed_rad_per_s)
    speed = np.linspace(0.0, 1.06 * max(drop.speed_rad_per_s for drop in drops), 300)[1:]
    for found, colour, ls in ((friction, MODEL, "-"), (thesis, MUTED, "--")):
        line = _MICRO * ((found.coulomb_nm or 0.0) + found.viscous_nms_per_rad * speed)
        torque_axes.plot(speed, line, color=colour, ls=ls)
        coefficient_axes.plot(speed, line / speed, color=colour, ls=ls)
    highest = max(drop.weight_kg * gravity_mps2 * radius_m / drop.speed_rad_per_s for drop in drops)
    coefficient_axes.set_ylim(0.0, 1.15 * _MICRO * highest)
    torque_axes.set_ylim(bottom=0.0)
    for axes in (torque_axes, coefficient_axes):
        axes.set_xlim(0.0, speed[-1])
    words(page.add_subplot(grid[2, 0]), _line_name(friction), _numbers(friction))
    words(page.add_subplot(grid[2, 1]), _THESIS, _numbers(thesis))
    page.align_ylabels()
    return page


def _key(friction: Friction, all_settled: bool) -> list[Artist]:
    key: list[Artist] = [
        Line2D([], [], color=RECORDED, marker="o", ls="", ms=4.5, label="settled run"),
        Line2D([], [], color=MODEL, label=_line_name(friction)),
        Line2D([], [], color=MUTED, ls="--", label=_THESIS),
    ]
    unsettled = Line2D(
        [], [], color=DOUBT, mfc="white", marker="o", ls="", ms=4.5, label="never settled, not used"
    )
    return key if all_settled else [*key, unsettled]


def _draw_point(axes: Axes, drop: Drop, value: float) -> None:
    colour, face = (RECORDED, RECORDED) if drop.settled else (DOUBT, "white")
    axes.errorbar(
        drop.speed_rad_per_s,
        value,
        xerr=drop.speed_std_rad_per_s,
        fmt="o",
        ms=4.5,
        color=colour,
        mfc=face,
        elinewidth=1.0,
    )


def _line_name(friction: Friction) -> str:
    return "viscous alone" if friction.coulomb_nm is None else "Coulomb and viscous"


def _numbers(found: Friction) -> list[tuple[str, str]]:
    coulomb = found.coulomb_nm
    return [
        (
            "viscous",
            plus_minus(
                _MICRO * found.viscous_nms_per_rad, _MICRO * (found.viscous_std or 0.0), unit="µN m s/rad"
            ),
        ),
        (
            "Coulomb",
            "-"
            if coulomb is None
            else plus_minus(_MICRO * coulomb, _MICRO * (found.coulomb_std or 0.0), unit="µN m"),
        ),
        (
            "inertia of the set-up",
            plus_minus(
                _NANO * found.setup_inertia_kg_m2, _NANO * (found.setup_inertia_std or 0.0), unit="10⁻⁹ kg m²"
            ),
        ),
    ]
