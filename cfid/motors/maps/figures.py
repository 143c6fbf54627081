"""Figures of motor maps: a thrust staircase, the maps (figures 3.7 to 3.11), thrust over voltage."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cfid.counted import counted
from cfid.drawing.numbers import FIT_ALONE
from cfid.drawing.style import (
    INK,
    KEY_IN,
    MODEL,
    MUTED,
    RECORDED,
    RECORDED_BELOW,
    figure,
    key_row,
    legend,
    name_panel,
    styled,
    words,
)
from cfid.estimate.polynomials import PolynomialFit
from cfid.findings import Finding, texts
from cfid.motors.maps.data import Reduced
from cfid.motors.maps.estimation import OUTLIER_WEIGHT, MotorMap, SpeedThrustMap, VoltageComparison, listed
from cfid.motors.maps.scales import ScalesCheck
from cfid.motors.panels import (
    COMMAND,
    coefficients,
    draw_means,
    draw_thrust,
    power,
    scientific,
    staircase_counts,
    staircase_key,
    staircase_levels,
    unused_steps,
)
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]

_AXES = {  # of each quantity: the axis' label, its unit, and how many of these make one SI unit
    "thrust": ("thrust (N)", "N", 1.0),
    "torque": ("torque (mN m)", "mN m", 1e3),
    "speed": ("speed (rad/s)", "rad/s", 1.0),
}
_TITLES = {
    "thrust": "Command to thrust of one motor",
    "torque": "Thrust to torque of one rotor",
    "speed": "Command to speed of one rotor",
}
_DESCRIBES = "describes the points"
_CURVE = 300  # points of a drawn curve
_EARS: dict[str, Any] = {"lw": 0.9, "capsize": 2.0}
_DOTS: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.5, "color": RECORDED, "zorder": 3}
_HOLLOW: dict[str, Any] = {**_DOTS, "mfc": "white", "zorder": 3.5}
_SQUARES: dict[str, Any] = {"ls": "", "marker": "s", "ms": 4.5, "color": INK, "mfc": "white", "zorder": 4}
_LEFT_OUT: dict[str, Any] = {"ls": "", "marker": "x", "ms": 5.0, "mew": 1.2, "color": MUTED}


@styled
def staircase_figure(record: Reduced) -> Figure:
    """Draw a record of the load cell with the mean of each of its steps.

    Thrust is that of all motors that ran, with the load cell's bias. Unused steps are named with the reason in red.
    """
    staircase, thrust = record.staircase, record.thrust
    steps = staircase.points
    unsettled = unused_steps(steps)
    counts, levels = staircase_counts(staircase), staircase_levels(staircase, thrust=thrust)
    heights_in = (KEY_IN, 2.9, 1.9, _table_in(counts, levels))
    notes = [one.text for one in staircase.findings if one.code == "no-baseline-after"]
    page, grid = figure(4, 2, heights_in=heights_in, title=record.name, rejections=unsettled, notes=notes)
    key_row(page.add_subplot(grid[0, :]), *staircase_key(steps))
    draw_thrust(page.add_subplot(grid[1, :]), record.time_s, record.thrust_n, staircase, thrust=thrust)
    draw_means(page.add_subplot(grid[2, 0]), page.add_subplot(grid[2, 1]), steps, thrust=thrust)
    words(page.add_subplot(grid[3, 0]), "in numbers", counts, red=("settled",) if unsettled else ())
    words(page.add_subplot(grid[3, 1]), "at rest", levels, red=() if staircase.tare_after else ("tare after", "drift"))
    page.align_ylabels()
    return page


@styled
def map_figure(mapped: MotorMap, *, verification: ScalesCheck | None = None) -> Figure:
    """Draw a map with its points and residuals, and a thrust map also with the readings of a second instrument.

    Bars are one standard uncertainty of a point about the curve. Bands are the 95 % bands of the curve and of a point.
    Commands that were left out are marked at the bottom of both panels.
    """
    unit, scale = _AXES[mapped.quantity][1:3]
    found, facts = _map_coefficients(mapped), _map_facts(mapped, verification, unit=unit, scale=scale)
    heights_in = (KEY_IN, KEY_IN, 2.9, 1.6, _table_in(found, facts))
    as_the_thesis = ", as in the thesis" if mapped.method == "thesis" else ""
    page, grid = _page(heights_in, _TITLES[mapped.quantity] + as_the_thesis, mapped.findings)
    curve, left = page.add_subplot(grid[2, :]), page.add_subplot(grid[3, :])
    _draw_map(curve, left, mapped)
    if verification is not None:
        for axes, value in ((curve, verification.thrust_n), (left, verification.difference_n)):
            axes.plot(verification.command, value, label="verification", **_SQUARES)
    _draw_keys(page, grid, curve)
    words(page.add_subplot(grid[4, 0]), "polynomial", found)
    words(
        page.add_subplot(grid[4, 1]), "points", facts, red=(_DESCRIBES,) if texts(mapped.findings, "rejection") else ()
    )
    page.align_ylabels()
    return page


@styled
def speed_thrust_figure(found: SpeedThrustMap) -> Figure:
    """Draw thrust over speed with k w^2 (eq. 3.1) and with the full quadratic, and the residuals of both."""
    form = _square_told(found)
    full = [*coefficients(found.quadratic, "w", ("N s²", "N s", "N")), FIT_ALONE, _norm(found.quadratic, "N")]
    page, grid = _page((2.9, 1.7, _table_in(form, full)), "Speed to thrust of one rotor", found.findings)
    _draw_speed_thrust(page.add_subplot(grid[0, :]), page.add_subplot(grid[1, :]), found)
    words(page.add_subplot(grid[2, 0]), "k w²", form)
    words(page.add_subplot(grid[2, 1]), "full quadratic", full)
    page.align_ylabels()
    return page


@styled
def voltage_figure(found: VoltageComparison) -> Figure:
    """Draw thrust over motor voltage and over the command alone, and how well each predicts.

    Dashed lines mark the error of prediction of points at commands that were left out of the fit.
    """
    heights_in = (KEY_IN, 2.5, 1.6, _table_in([*found.lowest_first.tolist(), FIT_ALONE]))
    page, grid = _page(heights_in, "Motor voltage to thrust", found.findings, notes=found.lines)
    axis, unit, _ = _AXES["thrust"]
    forms = (
        ("motor voltage", "motor voltage (V)", "U", found.motor_volts, found.by_voltage, found.voltage_rms),
        ("command alone", COMMAND, "cmd", found.command, found.by_command, found.command_rms),
    )
    shared: tuple[Axes | None, Axes | None] = (None, None)
    for column, (title, x, letter, place, fit, rms) in enumerate(forms):
        curve, left = (page.add_subplot(grid[1 + row, column], sharey=shared[row]) for row in (0, 1))
        name_panel(curve, f"({'ab'[column]}) over {title}", x="", y=axis)
        name_panel(left, f"({'cd'[column]}) predicts to {rms:.2g} {unit} rms", x=x, y=f"residual ({unit})")
        _draw_form(curve, left, place, found.value, fit, rms=rms)
        units = [f"{unit}{'/' + power('V', n) if letter == 'U' and n else ''}" for n in range(fit.order, -1, -1)]
        words(page.add_subplot(grid[3, column]), f"over {title}", [*coefficients(fit, letter, units), FIT_ALONE])
        shared = curve, left
    key_row(page.add_subplot(grid[0, :]), *curve.get_lines(), left.get_lines()[-1])
    page.align_ylabels()
    return page


def _page(
    heights_in: Sequence[float], title: str, findings: Sequence[Finding], *, notes: Sequence[str] = ()
) -> tuple[Figure, GridSpec]:
    rejected = [f"Rejected: {text}" for text in texts(findings, "rejection")]
    notes = (*notes, *texts(findings, "note", "warning"))
    return figure(len(heights_in), 2, heights_in=heights_in, title=title, rejections=rejected, notes=notes)


def _table_in(*tables: Sequence[Any]) -> float:
    """Return the height in inches of the longest of several tables."""
    return 0.42 + 0.165 * max(len(table) for table in tables)


def _norm(fit: PolynomialFit, unit: str, scale: float = 1.0) -> tuple[str, str]:
    return "norm of residuals", f"{scale * fit.residual_norm:.4g} {unit}"


def _map_coefficients(mapped: MotorMap) -> list[tuple[str, str]]:
    """Return the coefficients in SI units; the slope of torque over thrust is a length."""
    powers = range(mapped.fit.order, -1, -1)
    if mapped.quantity == "torque":
        units = [f"m/{power('N', n - 1)}" if n > 1 else ("N m", "m")[n] for n in powers]
        return [*coefficients(mapped.fit, "f", units), FIT_ALONE]
    return [*coefficients(mapped.fit, "cmd", [_AXES[mapped.quantity][1]] * len(powers)), FIT_ALONE]


def _map_facts(mapped: MotorMap, verification: ScalesCheck | None, *, unit: str, scale: float) -> list[tuple[str, str]]:
    fit = mapped.fit
    facts = [
        ("points", f"{len(mapped.x)} at {counted(len(np.unique(mapped.command)), 'command')}"),
        ("order", str(fit.order)),
        _norm(fit, unit, scale),
        ("scatter", "not stated" if fit.inflation is None else f"{fit.inflation:.3g} × as stated"),
        ("commands left out", listed(mapped.left_out) if mapped.left_out else "none"),
    ]
    if verification is not None:
        facts.append(("verification differs", f"{verification.rms_n:.2g} N, {verification.rms_percent:.2g} % rms"))
    return [*facts, (_DESCRIBES, "NO" if texts(mapped.findings, "rejection") else "yes")]


def _square_told(found: SpeedThrustMap) -> list[tuple[str, str]]:
    return [
        ("k of k w²", scientific(found.k_n_s2, found.k_std_n_s2, unit="N s²")),
        FIT_ALONE,
        _norm(found.square, "N"),
        ("largest difference", f"{found.difference_n:.2g} N"),
        ("k suffices", "yes" if found.square_suffices else "no"),
    ]


def _draw_map(curve: Axes, left: Axes, mapped: MotorMap) -> None:
    fit, over_thrust = mapped.fit, mapped.quantity == "torque"
    name, unit, scale = _AXES[mapped.quantity]
    name_panel(curve, "(a) points and polynomial", x="", y=name)
    over = _AXES["thrust"][0] if over_thrust else COMMAND
    name_panel(left, "(b) points less polynomial", x=over, y=f"residual ({unit})")
    at = np.linspace(mapped.x.min(), mapped.x.max(), _CURVE)
    for axes, level, value in ((curve, fit.at(at), mapped.y), (left, 0.0 * at, fit.residual)):
        _draw_bands(axes, at, scale * level, fit, scale=scale)
        axes.plot(at, scale * level, color=MODEL, lw=1.1, zorder=2, label="polynomial")
        _draw_points(axes, mapped.x, scale * value, scale * fit.point_std, apart=fit.weight < OUTLIER_WEIGHT)
        if not over_thrust:
            axes.margins(y=0.12)
            axes.set_xlim(-0.015 * FULL_COMMAND, 1.015 * FULL_COMMAND)
            _draw_left_out(axes, mapped.left_out)
    curve.tick_params(labelbottom=False)


def _draw_speed_thrust(curve: Axes, left: Axes, found: SpeedThrustMap) -> None:
    square, quadratic = found.square, found.quadratic
    name_panel(curve, "(a) points and curves", x="", y=_AXES["thrust"][0])
    name_panel(left, "(b) points less each curve", x=_AXES["speed"][0], y="residual (N)")
    speed = np.linspace(0.0, found.speed_rad_s.max(), _CURVE)
    _draw_points(curve, found.speed_rad_s, found.thrust_n, square.point_std, apart=square.weight < OUTLIER_WEIGHT)
    curve.plot(speed, square.at(speed), color=MODEL, lw=1.3, label="k w²")
    curve.plot(speed, quadratic.at(speed), color=INK, lw=1.1, ls="--", label="full quadratic")
    left.axhline(0.0, color=MUTED, lw=0.8)
    for fit, marks, label in (
        (square, {**_DOTS, "color": MODEL}, "left by k w²"),
        (quadratic, {**_SQUARES, "mfc": "none"}, "left by quadratic"),
    ):
        left.errorbar(found.speed_rad_s, fit.residual, fit.point_std, **_EARS, **{**marks, "marker": ""})
        left.plot(found.speed_rad_s, fit.residual, **marks, label=label)
    left.set_xlim(curve.get_xlim())
    curve.tick_params(labelbottom=False)
    legend(curve)
    legend(left)


def _draw_form(curve: Axes, left: Axes, x: Array, value: Array, fit: PolynomialFit, *, rms: float) -> None:
    at = np.linspace(x.min(), x.max(), _CURVE)
    curve.plot(at, fit.at(at), color=MODEL, lw=1.1, label="polynomial")
    curve.plot(x, value, **_DOTS, label="points")
    left.plot(x, fit.residual, **_DOTS, label="points")
    for error in (-rms, rms):
        left.axhline(error, color=INK, lw=0.9, ls="--", label="± error of prediction")
    for axes in (curve, left):
        axes.set_xlim(0.0, 1.03 * x.max())
    curve.tick_params(labelbottom=False)


def _draw_bands(axes: Axes, at: Array, level: Array, fit: PolynomialFit, *, scale: float) -> None:
    """Shade the 95 % bands of the curve and of a point; the wider one has an edge, for prints in grey."""
    if not np.isfinite(fit.quantile):
        return
    curve, point = scale * fit.confidence(at), scale * fit.prediction(at)
    axes.fill_between(at, level - point, level + point, fc=RECORDED_BELOW, ec=RECORDED, alpha=0.35, lw=0.6, gid="point")
    axes.fill_between(at, level - curve, level + curve, fc=MODEL, alpha=0.3, lw=0, gid="curve")


def _draw_points(axes: Axes, x: Array, y: Array, std: Array, *, apart: npt.NDArray[np.bool_]) -> None:
    axes.errorbar(x, y, std, **_EARS, **{**_DOTS, "marker": ""})
    axes.plot(x[~apart], y[~apart], **_DOTS, label="points ± standard uncertainty")
    if apart.any():
        axes.plot(x[apart], y[apart], **_HOLLOW, label="counts little")


def _draw_left_out(axes: Axes, commands: Sequence[float]) -> None:
    if commands:
        foot = axes.get_xaxis_transform()
        axes.plot(commands, [0.05] * len(commands), transform=foot, label="left out", **_LEFT_OUT)


def _draw_keys(page: Figure, grid: GridSpec, axes: Axes) -> None:
    """Put the keys of lines and bands above all panels, and those of marks below these."""
    lines: list[Artist] = [Line2D([], [], color=MODEL, label="polynomial")]
    if any(each.get_gid() == "curve" for each in axes.collections):
        lines += [
            Patch(fc=MODEL, alpha=0.3, lw=0, label="95 % band of the curve"),
            Patch(fc=RECORDED_BELOW, ec=RECORDED, alpha=0.35, lw=0.6, label="95 % band of a further point"),
        ]
    key_row(page.add_subplot(grid[0, :]), *lines)
    marks = [line for line in axes.get_lines() if line.get_marker() not in ("", "None", "_", "|")]
    key_row(page.add_subplot(grid[1, :]), *(line for line in marks if not str(line.get_label()).startswith("_")))
