"""Draw a flight: what rotors explain of the vertical force and the rates, and drag over velocity."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cfid.drawing.style import MODEL, RECORDED, draw_line, figure, legend, name_panel, styled
from cfid.findings import Finding, texts
from cfid.flight.braking import AxisDrag
from cfid.flight.estimation import Fitted
from cfid.flight.model import FlightEquation
from cfid.flight.rows import AXES

Array = npt.NDArray[np.float64]

_SHOWN_S = 4.0  # with the largest effect of the rotors
_MEAN_S = 0.05


@styled
def flight_figure(
    blocks: Fitted, drags: Mapping[str, AxisDrag | None], findings: Sequence[Finding], *, title: str, row_s: float
) -> Figure:
    """Return the four most dynamic seconds of each equation with the rotors' contribution, and drag where known."""
    known = {axis: drag for axis, drag in drags.items() if drag is not None}
    heights = [1.7] * 4 + [2.4] * bool(known)
    rejections = [f"Rejected: {text}" for text in texts(findings, "rejection")]
    page, grid = figure(len(heights), 2, heights_in=heights, title=title, rejections=rejections)
    for place, axis in enumerate((None, 0, 1, 2)):
        same = [each for each in blocks if each[0].axis == axis]
        _draw(
            page.add_subplot(grid[place, :]), "abcd"[place], *max(same, key=lambda each: float(np.std(each[1]))), row_s
        )
    for place, (axis_name, drag) in enumerate(known.items()):
        _draw_drag(page.add_subplot(grid[4, place]), f"({'ef'[place]}) {axis_name}", drag)
    return page


def _draw(axes: Axes, letter: str, block: FlightEquation, rotors: Array, row_s: float) -> None:
    what, unit = ("vertical", "m/s²") if block.axis is None else (AXES[block.axis], "rad/s²")
    name_panel(axes, f"({letter}) {what}", x="time (s)", y=f"acceleration ({unit})")
    count, length = round(_SHOWN_S / row_s), max(round(_MEAN_S / row_s), 1)
    begins = range(0, max(len(rotors) - count, 0) + 1, count // 4)
    begin = max(begins, key=lambda at: float(np.std(rotors[at : at + count])))
    seen = slice(begin, begin + count)
    time_s = np.asarray(row_s * np.arange(len(rotors[seen])), dtype=np.float64)
    shown, explained = (np.convolve(each, np.full(length, 1 / length), "same")[seen] for each in (block.shown, rotors))
    offset = float(np.mean(shown) - np.mean(explained))
    draw_line(axes, time_s, shown, color=RECORDED, lw=0.9, label="measured")
    draw_line(axes, time_s, explained + offset, color=MODEL, lw=1.1, label="rotors")
    legend(axes)


def _draw_drag(axes: Axes, name: str, drag: AxisDrag) -> None:
    name_panel(axes, name, x="velocity (m/s)", y="specific force (m/s²)")
    step = max(len(drag.velocity) // 800, 1)
    axes.plot(drag.velocity[::step], drag.force[::step], ".", color=RECORDED, ms=2.5, label="measured")
    ends = np.array([drag.velocity.min(), drag.velocity.max()])
    axes.plot(ends, -drag.rate * ends, color=MODEL, label=f"{drag.rate:.3f} ± {drag.std:.3f} 1/s")
    legend(axes)
