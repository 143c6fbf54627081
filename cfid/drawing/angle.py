"""Draw an angle record: angle, speed and sampling intervals."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import savgol_filter

from cfid.drawing.intervals import GAP, draw_intervals
from cfid.drawing.style import ALERT, INK, MUTED, RECORDED, draw_line, figure, name_panel, styled, words
from cfid.estimate.signals import GRID_S, resample
from cfid.records.tables.angle import AngleRecord

Array = npt.NDArray[np.float64]

TURNS_FROM = 2  # a record that spans more turns than this is drawn in turns

_TIME = "time (s)"
_SMOOTHED = 9  # samples of the grid, over which the speed's parabola lies


@styled
def recording_figure(record: AngleRecord, *, title: str) -> Figure:
    """Return angle, speed and sampling intervals of a record, with the reader's notes above."""
    page, grid = figure(3, 2, heights_in=(2.3, 1.8, 1.9), title=title, notes=record.notes)
    intervals = np.diff(record.time_s)
    _draw_angle(page.add_subplot(grid[0, :]), record)
    _draw_speed(page.add_subplot(grid[1, :]), record)
    draw_intervals(page.add_subplot(grid[2, 0]), intervals, usual_s=float(np.median(intervals)), letter="c")
    gaps = _gaps(intervals)
    words(
        page.add_subplot(grid[2, 1]),
        "in numbers",
        _facts(record, intervals),
        red=("gaps",) if len(gaps) else (),
    )
    page.align_ylabels()
    return page


def _draw_angle(axes: Axes, record: AngleRecord) -> None:
    in_turns = _in_turns(record)
    angle = record.angle_rad / (2 * np.pi) if in_turns else np.degrees(record.angle_rad)
    name_panel(axes, "(a) recording", x=_TIME, y="angle (turns)" if in_turns else "angle (°)")
    intervals = np.diff(record.time_s)
    pauses = [(record.time_s[after], intervals[after]) for after in _gaps(intervals)]
    axes.broken_barh(pauses, (0.0, 1.0), transform=axes.get_xaxis_transform(), color=ALERT, alpha=0.25, lw=0.8)
    draw_line(axes, record.time_s, angle, color=RECORDED, lw=0.9)
    axes.margins(y=0.08)


def _draw_speed(axes: Axes, record: AngleRecord) -> None:
    """Draw the slope of a parabola through neighbouring samples; plain differences are mostly noise."""
    step = max(GRID_S, float(np.median(np.diff(record.time_s))))
    name_panel(axes, f"(b) speed, smoothed over {1e3 * step * _SMOOTHED:.0f} ms", x=_TIME, y="speed (rad/s)")
    grid, angle = resample(record.time_s, record.angle_rad, step_s=step)
    if len(grid) < _SMOOTHED:
        return
    speed = savgol_filter(angle, _SMOOTHED, 2, deriv=1, delta=step)
    axes.axhline(0.0, color=MUTED, lw=0.8)
    draw_line(axes, grid, speed, color=INK, lw=0.7)
    axes.margins(y=0.08)


def _facts(record: AngleRecord, intervals_s: Array) -> list[tuple[str, str]]:
    gaps = _gaps(intervals_s)
    duration, median = float(record.time_s[-1]), float(np.median(intervals_s))
    span = float(np.ptp(record.angle_rad))
    longest = f"{1e3 * float(intervals_s.max()):.4g} ms after {record.time_s[int(np.argmax(intervals_s))]:.3f} s"
    return [
        ("samples", f"{len(record.time_s)}"),
        ("duration", f"{duration:.2f} s"),
        ("mean rate", f"{len(intervals_s) / duration:.5g} Hz" if duration > 0 else "-"),
        ("median interval", f"{1e3 * median:.4g} ms"),
        ("longest interval", longest),
        ("gaps", f"{len(gaps)} over {GAP} median intervals" if len(gaps) else "none"),
        ("repeated times", f"{np.count_nonzero(intervals_s == 0)}"),
        ("angle's range", f"{span / (2 * np.pi):.4g} turns" if _in_turns(record) else f"{np.degrees(span):.4g}°"),
    ]


def _in_turns(record: AngleRecord) -> bool:
    return bool(np.ptp(record.angle_rad) > 2 * np.pi * TURNS_FROM)


def _gaps(intervals_s: Array) -> npt.NDArray[np.intp]:
    """Return the samples after which the recording paused."""
    # Time stamps of a block repeat: the median of all intervals may be zero.
    passing = intervals_s[intervals_s > 0]
    return np.flatnonzero(intervals_s > GAP * np.median(passing)) if len(passing) else np.empty(0, dtype=np.intp)
