"""Draw a free swing and its fits: cfid's own, and those of the thesis."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.transforms import ScaledTranslation

from cfid.counted import counted
from cfid.drawing.numbers import plus_minus
from cfid.drawing.style import (
    INK,
    MODEL,
    MUTED,
    RECORDED,
    RECORDED_BELOW,
    WINDOW,
    Piece,
    draw_line,
    figure,
    legend,
    name_panel,
    pieces,
    styled,
    words,
)
from cfid.findings import texts
from cfid.swing.estimation import SwingFit
from cfid.swing.thesis import DampedCosine, FlexibleFunction
from cfid.swing.window import FreeSwing
from cfid.units import COVERAGE_95

Array = npt.NDArray[np.float64]

_LAG_PERIODS = 3
_ACCEPTED = "describes the record"
_TIME = "time (s)"
_DEGREES = "angle (°)"
_RADIANS = "angle (rad)"
_RATE = "rate (°/s)"


@styled
def swing_figure(swing: FreeSwing, fit: SwingFit, *, title: str) -> Figure:
    """Return the page of one swing: recording, fit, residual and its correlation, as in figures 2.10 to 2.12.

    Times count from the record's first sample; rejections are printed in red at the top.
    """
    rejected = [f"Rejected: {text}" for text in texts(fit.findings, "rejection")]
    heights_in = (2.1, 2.0, 1.5, 2.0)
    page, grid = figure(
        4, 2, heights_in=heights_in, title=title, rejections=rejected, notes=texts(fit.findings, "note", "warning")
    )
    _draw_recording(page.add_subplot(grid[0, :]), swing)
    _draw_fit(page, grid, 1, swing, fit, titles=("(b) fit in the window", "(c) record less fit"))
    _draw_autocorrelation(page.add_subplot(grid[3, 0]), swing, fit)
    words(page.add_subplot(grid[3, 1]), "what was found", _found(fit), red=() if fit.accepted else (_ACCEPTED,))
    page.align_ylabels()
    return page


@styled
def fit_figure(swing: FreeSwing, fit: SwingFit, *, title: str) -> Figure:
    """Return the recorded angle of one swing with its fit, and the residual."""
    page, grid = figure(2, 2, heights_in=(1.85, 1.1), title=title)
    _draw_fit(page, grid, 0, swing, fit, titles=("(a) fit", "(b) record less fit"))
    page.align_ylabels()
    return page


@styled
def thesis_swing_figure(swing: FreeSwing, cosine: DampedCosine, flexible: FlexibleFunction, *, title: str) -> Figure:
    """Return the thesis' own fits: figure 2.12 with its residual, and figure 2.13.

    Angles are in radians, as in the thesis, so that the figures can be compared side by side.
    """
    page, grid = figure(5, 2, heights_in=(2.1, 1.5, 2.1, 1.5, 1.5), title=title)
    fits = (0, cosine, "(a) damped cosine, eq. 2.11"), (2, flexible, "(c) flexible function, eq. 2.16")
    for row, fit, name in fits:
        shown = pieces(page, grid, row, fit.time_s, period_s=swing.period_s)
        _draw_overlay(shown, fit.time_s, fit.angle_rad, fit.model_rad, title=name, quantity=_RADIANS)
    residual = cosine.angle_rad - cosine.model_rad
    _draw_residual(page.add_subplot(grid[1, :]), cosine.time_s, residual, title="(b) record less cosine")
    derivatives = (
        ("(d) its first derivative", flexible.speed_rad_per_s, "speed (rad/s)"),
        ("(e) its second derivative", flexible.acceleration_rad_per_s2, "acceleration (rad/s²)"),
    )
    for row, (name, values, quantity) in enumerate(derivatives, start=3):
        axes = page.add_subplot(grid[row, :])
        name_panel(axes, name, x=_TIME, y=quantity)
        draw_line(axes, flexible.time_s, values, color=MODEL, lw=0.9)
    page.align_ylabels()
    return page


def _draw_recording(axes: Axes, swing: FreeSwing) -> None:
    def raw(about_rest_rad: Array) -> Array:
        return np.asarray(np.degrees(about_rest_rad + swing.rest_rad))

    time, used = swing.time_s, swing.peaks_used
    begin, end = time[swing.hand_gone], time[swing.end]
    name_panel(axes, "(a) recording", x=_TIME, y=_DEGREES)
    axes.axvspan(begin, end, color=WINDOW, alpha=0.13, lw=0, label="window", gid="window")
    axes.axhline(math.degrees(swing.rest_rad), color=MUTED, ls="--", lw=0.8, label="rest")
    draw_line(axes, time, raw(swing.angle_rad), color=RECORDED, lw=0.9)
    found: dict[str, Any] = {"ls": "", "marker": "o", "mfc": "white", "ms": 4.0, "mew": 1.0}
    axes.plot(
        swing.peak_time_s[:used],
        raw(swing.peak_angle_rad[:used]),
        color=MODEL,
        label=f"{counted(used, 'peak')} used",
        **found,
    )
    if used < len(swing.peak_time_s):
        unused = slice(used, None)
        axes.plot(
            swing.peak_time_s[unused],
            raw(swing.peak_angle_rad[unused]),
            color=MUTED,
            label="not used",
            **found,
        )
    held = swing.angle_rad[swing.release]
    # Drawn next to its sample, on the outer side: the release is the first peak, which has a mark of its own.
    outside = axes.transData + ScaledTranslation(0, math.copysign(6.5 / 72, held), axes.figure.dpi_scale_trans)
    how: dict[str, Any] = {"marker": "v" if held > 0 else "^", "ms": 5.5, "ls": "", "transform": outside}
    # A window with given limits has no release by hand.
    released = swing.hand_gone > swing.release
    axes.plot(swing.release_s, raw(held), color=INK, label="release" if released else "start", **how)
    if released:
        gone = raw(swing.angle_rad[swing.hand_gone])
        axes.plot(begin, gone, color=INK, marker="x", ms=5, mew=1.4, ls="", label="hand gone")
    axes.margins(y=0.13)
    legend(axes)


def _draw_fit(
    page: Figure, grid: GridSpec, row: int, swing: FreeSwing, fit: SwingFit, *, titles: tuple[str, str]
) -> None:
    """Draw a fit over its recording into one row of a grid with two columns, and the residual into the next."""
    time, residual = swing.hands_off[0], fit.output_error.residual_rad
    per_s = fit.output_error.setup.gyro_per_s or 1.0
    reading = per_s * (residual + fit.predicted_rad)
    quantity = _DEGREES if swing.rate_rad_per_s is None else _RATE
    shown = pieces(page, grid, row, time, period_s=swing.period_s)
    _draw_overlay(shown, time, reading, per_s * fit.predicted_rad, title=titles[0], quantity=quantity)
    _draw_residual(page.add_subplot(grid[row + 1, :]), time, residual, title=titles[1])


def _draw_overlay(
    shown: list[Piece], time_s: Array, recorded_rad: Array, fitted_rad: Array, *, title: str, quantity: str
) -> None:
    """Draw a fit over the recording: thin and dark over wide and pale, so that neither hides the other."""
    scale = 1.0 if quantity == _RADIANS else math.degrees(1.0)
    for axes, part in shown:
        draw_line(axes, time_s[part], scale * recorded_rad[part], color=RECORDED_BELOW, lw=3.2, label="recorded")
        draw_line(axes, time_s[part], scale * fitted_rad[part], color=MODEL, lw=1.0, label="fitted")
        axes.margins(y=0.08)
        axes.set_xlabel(_TIME)
    first, last = shown[0].axes, shown[-1].axes
    name_panel(first, title if first is last else f"{title}: its beginning, its end", x=_TIME, y=quantity)
    legend(last)


def _draw_residual(axes: Axes, time_s: Array, residual_rad: Array, *, title: str) -> None:
    rms = 1e3 * float(np.sqrt(np.mean(residual_rad**2)))
    name_panel(axes, f"{title}, {rms:.3g} mrad rms", x=_TIME, y="residual (mrad)")
    axes.axhline(0.0, color=MUTED, lw=0.8)
    draw_line(axes, time_s, 1e3 * residual_rad, color=INK, lw=0.6)


def _draw_autocorrelation(axes: Axes, swing: FreeSwing, fit: SwingFit) -> None:
    """Draw the autocorrelation of the residual: what a model leaves out oscillates with the period of the swing."""
    residual = fit.output_error.residual_rad
    time, count = swing.hands_off[0], len(residual)
    a_period = swing.period_s * (count - 1) / (time[-1] - time[0])
    lags = np.arange(min(count, int(_LAG_PERIODS * a_period) + 1))
    correlation = np.fft.irfft(np.abs(np.fft.rfft(residual, 2 * count)) ** 2)[: len(lags)]
    correlation /= correlation[0] or 1.0
    name_panel(axes, "(d) autocorrelation of (c)", x="lag (periods)", y="correlation (-)")
    white = COVERAGE_95 / math.sqrt(count)  # 95 % of the autocorrelations of white noise lie within
    axes.axhspan(-white, white, color=MUTED, alpha=0.3, lw=0, label="white noise, 95 %")
    draw_line(axes, lags / a_period, correlation, color=INK, lw=0.8)
    axes.set_ylim(min(-0.3, 1.1 * correlation.min()), 1.05)
    legend(axes)


def _found(fit: SwingFit) -> list[tuple[str, str]]:
    names = ("natural frequency²", "viscous damping", "Coulomb friction", "quadratic drag")
    units = ("s⁻²", "s⁻¹", "s⁻²", "rad⁻¹")
    constants = zip(names, units, fit.coefficients[:4], fit.std[:4], strict=True)
    return [
        *((name, plus_minus(value, std, unit=unit)) for name, unit, value, std in constants if value),
        ("zero", plus_minus(1e3 * fit.coefficients.zero_rad, 1e3 * fit.std.zero_rad, unit="mrad")),
        ("misfit", f"{100 * fit.misfit:.2g} %"),
        ("distortion", f"{100 * fit.distortion:.2g} %, limit {100 * fit.distortion_limit:.2g} %"),
        ("drift", plus_minus(100 * fit.drift, 100 * fit.drift_std, unit="%")),
        (_ACCEPTED, "yes" if fit.accepted else "NO"),
    ]
