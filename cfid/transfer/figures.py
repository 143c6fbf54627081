"""Figures of a transfer function: Bode (figures 3.14, 3.15), step response, and a run against it (figure 3.16)."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cfid.drawing.numbers import FIT_ALONE, MICRO, plus_minus
from cfid.drawing.style import (
    INK,
    KEY_IN,
    MODEL,
    MUTED,
    RECORDED,
    RECORDED_BELOW,
    SERIES,
    draw_line,
    figure,
    key_row,
    name_panel,
    styled,
    words,
)
from cfid.estimate.linear import propagated, std_of
from cfid.findings import SEVERITIES, texts
from cfid.records.result import Figures
from cfid.transfer.alignment import Reports, SineRun
from cfid.transfer.estimation import Identified, TransferFit
from cfid.transfer.frequency_response import SETTLE_S
from cfid.transfer.model import Complex, TransferFunction
from cfid.transfer.thesis import ThesisFit
from cfid.transfer.verification import Verification
from cfid.units import COVERAGE_95

Array = npt.NDArray[np.float64]

COMMAND = "command"
FREQUENCY = "frequency (Hz)"

_SHOWN_HARMONICS = 4.5
_CIRCLES: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4.5, "mfc": "none", "color": RECORDED}
_CURVE = 300
_LAGS = 6.0  # that a step is drawn for
_EXAMPLE_HZ = 1.5  # l = 12 of N = 4000, which the thesis shows


class SeriesPoints(NamedTuple):
    """A series' responses (n,), without and with their delay, and 95 % intervals (n, 2) of size and phase."""

    name: str
    omega_rad_s: Array
    value: Complex
    stamped: Complex
    interval: Array | None


def fit_figures(found: Identified, *, thesis: ThesisFit | None) -> Figures:
    """Return Bode and step figures, and one run of each series, by file name."""
    figures = {"tf_bode": bode_figure(found.fit, thesis=thesis), "tf_step": step_figure(found.fit, thesis=thesis)}
    for name, series in found.aligned.items():
        apart = [abs(math.log(run.frequency_rad_s / (2 * math.pi * _EXAMPLE_HZ))) for run in series.runs]
        place = apart.index(min(apart))
        run, recorded = series.runs[place], found.used[name][place]
        figures[f"tf_run_{name}"] = sine_run_figure(run, recorded.reports)
    return figures


@styled
def bode_figure(fit: TransferFit, *, thesis: ThesisFit | None = None) -> Figure:
    """Return responses with 95 % intervals, each series' delay taken out of its phase, the model, and what it leaves.

    Phases as stamped are grey; the thesis method's function of the same runs is dashed.
    """
    rejections = texts(fit.findings(()), "rejection")
    rows = _fit_rows(fit)
    heights_in = (KEY_IN, 2.3, 2.3, 1.5, 0.42 + 0.165 * len(rows))
    page, grid = figure(5, 2, heights_in=heights_in, title="Command to thrust of one motor", rejections=rejections)
    size, phase = page.add_subplot(grid[1, :]), page.add_subplot(grid[2, :])
    name_panel(size, "(a) magnitude", x="", y="thrust over command (µN)")
    name_panel(phase, "(b) phase, the delay taken out", x=FREQUENCY, y="phase (degrees)")
    left, turned = page.add_subplot(grid[3, 0]), page.add_subplot(grid[3, 1])
    name_panel(left, "(c) magnitude over the model", x=FREQUENCY, y="difference (%)")
    name_panel(turned, "(d) phase less the model", x=FREQUENCY, y="difference (degrees)")
    series = _points(fit)
    models = {"model": fit.response, **({} if thesis is None else {"thesis method": thesis.function.response})}
    _draw_bode(size, phase, series, models)
    for points, colour in zip(series, cycle(SERIES), strict=False):
        _draw_left(left, turned, points, fit, colour=colour)
    for axes in (left, turned):
        axes.set_xscale("log")
    key_row(page.add_subplot(grid[0, :]), *phase.get_legend_handles_labels()[0])
    words(page.add_subplot(grid[4, :]), "in numbers", rows, red=("chi-squared",) if rejections else ())
    page.align_ylabels()
    return page


@styled
def thesis_bode_figure(each: Mapping[str, ThesisFit], joint: ThesisFit) -> Figure:
    """Return the estimates of eq. 3.9 and the least squares through them, as figures 3.14 and 3.15."""
    page, grid = figure(
        3,
        1,
        heights_in=(KEY_IN, 2.5, 2.5),
        title="Command to thrust of one motor, thesis method",
        notes=texts(joint.findings, *SEVERITIES),
    )
    size, phase = page.add_subplot(grid[1, 0]), page.add_subplot(grid[2, 0])
    name_panel(size, "(a) magnitude", x="", y="thrust over command (µN)")
    name_panel(phase, "(b) phase", x=FREQUENCY, y="phase (degrees)")
    series = []
    for name, fit in each.items():
        omega = np.array([response.omega_rad for response in fit.responses]) / fit.function.sample_s
        value = np.array([response.value for response in fit.responses])
        series.append(SeriesPoints(name, omega, value, value, None))
    _draw_bode(size, phase, series, {"weighted least squares": joint.function.response})
    key_row(page.add_subplot(grid[0, 0]), *phase.get_legend_handles_labels()[0])
    page.align_ylabels()
    return page


@styled
def step_figure(fit: TransferFit, *, thesis: ThesisFit | None = None) -> Figure:
    """Return the thrust after a step of one unit of the command, without delay, with its 95 % interval."""
    page, grid = figure(2, 1, heights_in=(KEY_IN, 2.7), title="Step of the command", rejections=())
    axes = page.add_subplot(grid[1, 0])
    name_panel(axes, "thrust after a step", x="time since the step (ms)", y="thrust over command (µN)")
    time_s = np.linspace(-0.3, _LAGS, _CURVE) * fit.time_constant_s

    def step(values: Array) -> Array:
        return _step(fit.function_at(values), time_s)

    force = step(fit.values)
    std = std_of(propagated(step, fit.values, fit.covariance))
    low, high = force - COVERAGE_95 * std, force + COVERAGE_95 * std
    axes.fill_between(1e3 * time_s, MICRO * low, MICRO * high, color=MODEL, alpha=0.3, lw=0, label="95 % interval")
    axes.plot(1e3 * time_s, MICRO * force, color=MODEL, label="model")
    axes.axvline(1e3 * fit.time_constant_s, color=MUTED, lw=0.8, ls=":", label="time constant")
    if thesis is not None and (lag_s := thesis.function.time_constant_s) is not None:
        other = TransferFunction.of_lags(thesis.function.static_gain_n, [lag_s])
        label = "the thesis' gain and time constant"
        axes.plot(1e3 * time_s, MICRO * _step(other, time_s), color=INK, ls="--", label=label)
    key_row(page.add_subplot(grid[0, 0]), *axes.get_legend_handles_labels()[0])
    return page


@styled
def verification_figure(run: SineRun, found: Verification) -> Figure:
    """Return commands, measured and simulated thrust about their means, and the residual (figure 3.16)."""
    rows = _verification_rows(found)
    rejections = () if found.accepted else ("the transfer function does not describe this run",)
    heights_in = (KEY_IN, 1.7, 2.5, 1.5, 0.42 + 0.165 * len(rows))
    page, grid = figure(5, 1, heights_in=heights_in, title=f"Verification: {found.name}", rejections=rejections)
    played, force, left = (page.add_subplot(grid[row, 0]) for row in (1, 2, 3))
    draw_played(played, run, end_s=run.duration_s)
    name_panel(played, "(a) commands", x="", y=COMMAND)
    name_panel(force, "(b) thrust about its mean, smoothed", x="", y="thrust (N)")
    draw_line(force, found.time_s, found.measured_n, color=RECORDED_BELOW, lw=2.4, label="measured")
    draw_line(force, found.time_s, found.simulated_n, color=MODEL, lw=1.1, label="simulated")
    name_panel(left, "(c) measured less simulated", x="time since the first sample (s)", y="residual (N)")
    draw_line(left, found.time_s, found.residual_n, color=RECORDED, lw=0.8)
    for axes in (played, force, left):
        axes.set_xlim(0, run.duration_s)
    for axes in (played, force):
        axes.tick_params(labelbottom=False)
    key_row(page.add_subplot(grid[0, 0]), *force.get_legend_handles_labels()[0])
    words(page.add_subplot(grid[4, 0]), "in numbers", rows, red=() if found.accepted else ("measured is late by",))
    page.align_ylabels()
    return page


@styled
def sine_run_figure(run: SineRun, reports: Reports) -> Figure:
    """Return one run: commands reconstructed from its reports, the thrust during that time, and the spectra of both.

    Reports are drawn at their stamps, which include the radio's latency; commands are drawn when they were played.
    """
    notes = [f"the first {SETTLE_S:g} s are left out of the spectra, which hold whole periods"]
    page, grid = figure(4, 2, heights_in=(KEY_IN, 2.0, 2.2, 2.0), title=f"Sine run: {run.name}", notes=notes)
    played, force = page.add_subplot(grid[1, :]), page.add_subplot(grid[2, :])
    end_s = float(run.time_s[-1])
    draw_played(played, run, end_s=end_s)
    played.plot(reports.host_s - run.start_s, reports.command, **_CIRCLES, label="reports as stamped")
    name_panel(played, "(a) commands", x="", y=COMMAND)
    name_panel(force, "(b) thrust by the load cell", x="time since the first sample (s)", y="thrust (N)")
    draw_line(force, run.time_s, run.force_n, color=RECORDED, lw=0.6, label="thrust")
    for axes in (played, force):
        axes.set_xlim(float(run.time_s[0]), end_s)
    played.tick_params(labelbottom=False)
    hertz, commands, thrust = _spectra(run)
    for place, (what, amplitude, unit) in enumerate((("commands", commands, ""), ("thrust", thrust, " (N)"))):
        axes = page.add_subplot(grid[3, place])
        name_panel(axes, f"({'cd'[place]}) spectrum of {what}", x=FREQUENCY, y=f"amplitude{unit}")
        shown = hertz <= _SHOWN_HARMONICS * run.frequency_rad_s / (2 * np.pi)
        axes.vlines(hertz[shown], 0, amplitude[shown], color=RECORDED, lw=1.0)
        axes.set_ylim(bottom=0)
        axes.axvline(run.frequency_rad_s / (2 * np.pi), color=MODEL, lw=0.8, ls=":")
    key_row(page.add_subplot(grid[0, :]), *played.get_legend_handles_labels()[0])
    page.align_ylabels()
    return page


def draw_played(axes: Axes, run: SineRun, *, end_s: float) -> None:
    """Draw the commands as they were played, up to the end."""
    time_s = run.sample_s * np.arange(run.sine.samples)
    shown = time_s <= end_s
    axes.plot(time_s[shown], run.sine.commands()[shown], color=MODEL, lw=1.0, label="reconstructed commands")


def draw_points(size: Axes, phase: Axes, points: SeriesPoints, *, colour: str) -> None:
    """Draw a series' responses with their intervals, and in grey its phases as stamped, if these differ."""
    hertz = points.omega_rad_s / (2 * np.pi)
    how: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.5, "color": colour, "elinewidth": 0.9, "zorder": 3}
    spread = (
        (None, None) if points.interval is None else (1e6 * points.interval[:, 0], np.degrees(points.interval[:, 1]))
    )
    size.errorbar(hertz, 1e6 * np.abs(points.value), spread[0], **how)
    phase.errorbar(hertz, np.degrees(np.angle(points.value)), spread[1], **how, label=points.name)
    if points.interval is not None:
        grey: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.0, "mfc": "none", "color": MUTED}
        phase.plot(hertz, np.degrees(np.angle(points.stamped)), **grey, label=f"{points.name}, as stamped")


def _spectra(run: SineRun) -> tuple[Array, Array, Array]:
    """Return frequencies (n,) in Hz and the amplitudes of commands and thrust, without constants (eq. 3.8)."""
    period_s = 2 * np.pi / run.frequency_rad_s
    periods = max(int((run.duration_s - SETTLE_S) / period_s), 1)
    count = min(round(periods * period_s / run.sample_s), run.sine.samples)
    first = run.sine.samples - count
    place = np.arange(first, first + count)
    force = np.interp(place * run.sample_s, run.time_s, run.force_n)
    amplitudes = [2 * np.abs(np.fft.rfft(own - own.mean())) / count for own in (run.sine.commands()[place], force)]
    return np.asarray(np.fft.rfftfreq(count, run.sample_s), dtype=np.float64), amplitudes[0], amplitudes[1]


def _points(fit: TransferFit) -> list[SeriesPoints]:
    """Return the responses of each series, the phase also without its delay."""
    found = []
    for series in fit.measured:
        omega = np.array([own.frequency_rad_s for own in series.responses])
        value = np.array([own.value for own in series.responses])
        turned = value * np.exp(1j * omega * fit.delays[series.name].after_quickest_s)
        std = np.array([own.polar_std for own in series.responses])
        found.append(SeriesPoints(series.name, omega, turned, value, COVERAGE_95 * std))
    return found


def _draw_bode(
    size: Axes, phase: Axes, series: Sequence[SeriesPoints], models: Mapping[str, Callable[[Array], Complex]]
) -> None:
    """Draw each series and the responses of models by name, of which the first is the fit to these series."""
    for points, colour in zip(series, cycle(SERIES), strict=False):
        draw_points(size, phase, points, colour=colour)
    measured = np.concatenate([points.omega_rad_s for points in series])
    omega = np.geomspace(0.8 * measured.min(), 1.2 * measured.max(), _CURVE)
    hertz = omega / (2 * np.pi)
    for (label, response), colour, dashes in zip(models.items(), (MODEL, INK), ("-", "--"), strict=False):
        value = response(omega)
        size.plot(hertz, MICRO * np.abs(value), color=colour, ls=dashes, lw=1.1)
        phase.plot(hertz, np.degrees(np.unwrap(np.angle(value))), color=colour, ls=dashes, lw=1.1, label=label)
    for axes in (size, phase):
        axes.set_xscale("log")
    size.set_yscale("log")
    size.tick_params(labelbottom=False)


def _draw_left(left: Axes, turned: Axes, points: SeriesPoints, fit: TransferFit, *, colour: str) -> None:
    ratio = points.value / fit.response(points.omega_rad_s)
    hertz = points.omega_rad_s / (2 * np.pi)
    assert points.interval is not None
    percent = 100 * points.interval[:, 0] / np.abs(points.value)
    how = {"ls": "", "marker": "o", "ms": 3.0, "color": colour, "lw": 0.9, "elinewidth": 0.9}
    left.errorbar(hertz, 100 * (np.abs(ratio) - 1), percent, **how)  # type: ignore[arg-type]
    turned.errorbar(hertz, np.degrees(np.angle(ratio)), np.degrees(points.interval[:, 1]), **how)  # type: ignore[arg-type]
    for axes in (left, turned):
        axes.axhline(0.0, color=MODEL, lw=1.0, zorder=1)


def _step(function: TransferFunction, time_s: Array) -> Array:
    """Return the force (n,) at times (n,) since a command of 1 began."""
    last = math.ceil(float(time_s.max()) / function.sample_s) + 1
    return function.simulate(np.ones(last + 1), time_s)


def _fit_rows(fit: TransferFit) -> list[tuple[str, str]]:
    gain, lag = fit.gain_n, fit.time_constant_s
    delays = []
    for name, own in fit.delays.items():
        late = own.delay_s < 0  # the force cannot come before its command, so that the command's stamp is late
        what, unit = (f"time stamps of {name}", "ms late on average") if late else (f"delay of {name}", "ms")
        delays.append((what, plus_minus(1e3 * abs(own.delay_s), 1e3 * own.std_s, unit=unit)))
    return [
        (
            "static gain",
            f"{plus_minus(MICRO * gain, MICRO * fit.std[0], unit='µN')} ({' '.join(FIT_ALONE)})",
        ),
        ("time constant", plus_minus(1e3 * lag, 1e3 * fit.time_constant_std_s, unit="ms")),
        *delays,
        ("chi-squared", f"{fit.chi_squared:.1f} for {fit.degrees_of_freedom} degrees of freedom"),
    ]


def _verification_rows(found: Verification) -> list[tuple[str, str]]:
    return [
        ("fit", f"{found.fit_percent:.1f} %"),
        ("residual", f"{1e3 * found.residual_rms_n:.2g} mN rms"),
        ("measured is late by", plus_minus(1e3 * found.late_s, 1e3 * found.late_std_s, unit="ms")),
        ("and as large as simulated", plus_minus(found.gain_ratio, found.gain_ratio_std, unit="times")),
    ]
