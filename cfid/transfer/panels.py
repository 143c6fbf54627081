"""Draw a sine run (figures 3.12 and 3.13), and panels that figures of transfer functions share."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cfid.drawing.style import KEY_IN, MODEL, MUTED, RECORDED, draw_line, figure, key_row, name_panel, styled
from cfid.transfer.sines.alignment import SineRun
from cfid.transfer.sines.reports import Reports

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

COMMAND = "command"
FREQUENCY = "frequency (Hz)"

_SHOWN_HARMONICS = 4.5
_CIRCLES: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4.5, "mfc": "none", "color": RECORDED}


class SeriesPoints(NamedTuple):
    """A series' responses (n,), without and with their delay, and 95 % intervals (n, 2) of size and phase."""

    name: str
    omega_rad_s: Array
    value: Complex
    stamped: Complex
    interval: Array | None


@styled
def sine_run_figure(run: SineRun, reports: Reports, *, settle_s: float) -> Figure:
    """Return one run: commands reconstructed from its reports, the thrust during that time, and the spectra of both.

    Reports are drawn at their stamps, which include the radio's latency; commands are drawn when they were played.
    """
    notes = [f"the first {settle_s:g} s are left out of the spectra, which hold whole periods"]
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
    hertz, commands, thrust = _spectra(run, settle_s)
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


def _spectra(run: SineRun, settle_s: float) -> tuple[Array, Array, Array]:
    """Return frequencies (n,) in Hz and the amplitudes of commands and thrust, without constants (eq. 3.8)."""
    period_s = 2 * np.pi / run.frequency_rad_s
    periods = max(int((run.duration_s - settle_s) / period_s), 1)
    count = min(round(periods * period_s / run.sample_s), run.sine.samples)
    first = run.sine.samples - count
    place = np.arange(first, first + count)
    force = np.interp(place * run.sample_s, run.time_s, run.force_n)
    amplitudes = [2 * np.abs(np.fft.rfft(own - own.mean())) / count for own in (run.sine.commands()[place], force)]
    return np.asarray(np.fft.rfftfreq(count, run.sample_s), dtype=np.float64), amplitudes[0], amplitudes[1]
