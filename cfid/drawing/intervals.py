"""The sampling intervals of a recording: which of them are gaps, and how they scatter."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from cfid.drawing.style import RECORDED, name_panel
from cfid.large import differences

GAP = 10  # median intervals without a sample that count as a gap

_BINS = 60


def draw_intervals(axes: Axes, time_s: npt.NDArray[np.float64], *, usual_s: float, letter: str) -> None:
    """Draw the histogram of the intervals between times (n,) in s, of which `usual_s` is the usual one."""
    name_panel(axes, f"({letter}) sampling intervals", x="interval (ms)", y="count (-)")
    low = 1e3 * min(float(step.min()) for _, step in differences(time_s))
    high = 1e3 * max(float(step.max()) for _, step in differences(time_s))
    # With an even clock, the intervals differ only by rounding, and bins as narrow as that would show nothing.
    room = max(0.0, 0.1 * 1e3 * usual_s - (high - low)) / 2
    edges = np.histogram_bin_edges([], bins=_BINS, range=(low - room, high + room))
    counts = sum(np.histogram(1e3 * step, bins=edges)[0] for _, step in differences(time_s))
    axes.hist(edges[:-1], bins=edges.tolist(), weights=counts, color=RECORDED, lw=0)
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.7)
