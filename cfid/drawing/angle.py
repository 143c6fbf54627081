"""Draw an angle record: angle, speed and sampling intervals."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import savgol_filter

from cfid.drawing.intervals import GAP, draw_intervals
from cfid.drawing.style import ALERT, INK, MUTED, RECORDED, draw_line, figure, name_panel, styled, thinned, words
from cfid.estimate.signals import GRID_S, resample
from cfid.large import differences, longest_step, parts, some_steps, usual_step
from cfid.recordings.angle import AngleRecord

Array = npt.NDArray[np.float64]

TURNS_FROM = 2  # a record that spans more turns than this is drawn in turns

_TIME = "time (s)"
_SMOOTHED = 9  # samples of the grid in each parabola of the speed


@styled
def recording_figure(record: AngleRecord, *, title: str) -> Figure:
    """Return angle, speed and sampling intervals of a record, with the reader's notes above."""
    page, grid = figure(3, 2, heights_in=(2.3, 1.8, 1.9), title=title, notes=record.notes)
    _draw_angle(page.add_subplot(grid[0, :]), record)
    _draw_speed(page.add_subplot(grid[1, :]), record)
    usual_s = float(np.median(some_steps(record.time_s)))
    draw_intervals(page.add_subplot(grid[2, 0]), record.time_s, usual_s=usual_s, letter="c")
    red = ("gaps",) if len(_gaps(record.time_s)) else ()
    words(page.add_subplot(grid[2, 1]), "in numbers", _facts(record), red=red)
    page.align_ylabels()
    return page


def _draw_angle(axes: Axes, record: AngleRecord) -> None:
    in_turns = _in_turns(record)
    name_panel(axes, "(a) recording", x=_TIME, y="angle (turns)" if in_turns else "angle (°)")
    time = record.time_s
    pauses = [(time[after], time[after + 1] - time[after]) for after in _gaps(time)]
    axes.broken_barh(pauses, (0.0, 1.0), transform=axes.get_xaxis_transform(), color=ALERT, alpha=0.25, lw=0.8)
    factor = 1 / (2 * np.pi) if in_turns else 180 / np.pi
    draw_line(axes, time, record.angle_rad, factor=factor, color=RECORDED, lw=0.9)
    axes.margins(y=0.08)


def _draw_speed(axes: Axes, record: AngleRecord) -> None:
    """Draw the speed as the slope of a parabola through neighbouring samples; plain differences are mostly noise."""
    step = max(GRID_S, float(np.median(some_steps(record.time_s))))
    name_panel(axes, f"(b) speed, smoothed over {1e3 * step * _SMOOTHED:.0f} ms", x=_TIME, y="speed (rad/s)")
    pieces = []
    for part in parts(len(record.time_s)):
        grid, angle = resample(record.time_s[part], record.angle_rad[part], step_s=step)
        if len(grid) >= _SMOOTHED:
            pieces.append(thinned(grid, savgol_filter(angle, _SMOOTHED, 2, deriv=1, delta=step)))
    if pieces:
        axes.axhline(0.0, color=MUTED, lw=0.8)
        axes.plot(*(np.concatenate(each) for each in zip(*pieces, strict=True)), color=INK, lw=0.7)
        axes.margins(y=0.08)


def _facts(record: AngleRecord) -> list[tuple[str, str]]:
    time, gaps = record.time_s, _gaps(record.time_s)
    duration, median = float(time[-1]), float(np.median(some_steps(time)))
    span = float(np.ptp(record.angle_rad))
    longest = longest_step(time)
    return [
        ("samples", f"{len(time)}"),
        ("duration", f"{duration:.2f} s"),
        ("mean rate", f"{(len(time) - 1) / duration:.5g} Hz" if duration > 0 else "-"),
        ("median interval", f"{1e3 * median:.4g} ms"),
        ("longest interval", f"{1e3 * (time[longest + 1] - time[longest]):.4g} ms after {time[longest]:.3f} s"),
        ("gaps", f"{len(gaps)} over {GAP} median intervals" if len(gaps) else "none"),
        ("repeated times", f"{sum(int(np.count_nonzero(step == 0)) for _, step in differences(time))}"),
        ("angle's range", f"{span / (2 * np.pi):.4g} turns" if _in_turns(record) else f"{np.degrees(span):.4g}°"),
    ]


def _in_turns(record: AngleRecord) -> bool:
    return bool(np.ptp(record.angle_rad) > 2 * np.pi * TURNS_FROM)


def _gaps(time_s: Array) -> npt.NDArray[np.intp]:
    """Return the samples after which the recording paused."""
    least = GAP * usual_step(time_s)  # NaN if time never advances
    return np.concatenate([begin + np.flatnonzero(step > least) for begin, step in differences(time_s)])
