"""The sampling intervals of a recording: which of them are gaps, and how they scatter."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from cfid.drawing.style import RECORDED, name_panel

GAP = 10  # median intervals without a sample that count as a gap

_BINS = 60


def draw_intervals(axes: Axes, intervals_s: npt.NDArray[np.float64], *, usual_s: float, letter: str) -> None:
    """Draw the histogram of intervals (n,) in s, of which `usual_s` is the usual one."""
    name_panel(axes, f"({letter}) sampling intervals", x="interval (ms)", y="count (-)")
    low, high = 1e3 * intervals_s.min(), 1e3 * intervals_s.max()
    # With an even clock only rounding lies between the two: bins that narrow would show nothing.
    room = max(0.0, 0.1 * 1e3 * usual_s - (high - low)) / 2
    axes.hist(1e3 * intervals_s, bins=_BINS, range=(low - room, high + room), color=RECORDED, lw=0)
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.7)
