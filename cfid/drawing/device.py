"""Draw any device's file of a run over time: commands as steps, events as marks, the rest as lines."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from cfid.drawing.style import SERIES, draw_line, figure, legend, name_panel, styled

Array = npt.NDArray[np.float64]

_PANEL_IN = 1.9
_MOST_PANELS = 8
_HELD = re.compile(r"m[1-4]")  # a command holds until the next
_COUNTERS = ("vehicle_us", "vehicle_ms", "report", "sample")  # straight lines, of use to programs only
_FEW = 400  # rows, up to which each is marked


@styled
def device_figure(
    time_s: Array, columns: Mapping[str, Array], *, title: str, notes: Sequence[str], along: str = "time (s)"
) -> Figure:
    """Return a panel for each group of columns (n,) that differ by a number only, over times (n,) in seconds.

    `along` names the axis where they are not times.
    """
    panels = groups(list(columns))[:_MOST_PANELS]
    page, grid = figure(len(panels), 1, heights_in=[_PANEL_IN] * len(panels), title=title, notes=notes)
    since_s = time_s - time_s[0]
    for row, names in enumerate(panels):
        axes = page.add_subplot(grid[row, 0])
        for colour, name in zip(SERIES, names, strict=False):
            how: dict[str, Any] = {"drawstyle": "steps-post"} if _HELD.fullmatch(name) else {}
            mark = "." if len(since_s) < _FEW and not how else ""
            draw_line(axes, since_s, columns[name], color=colour, label=name, marker=mark, **how)
        name_panel(axes, ", ".join(names), x=along if row == len(panels) - 1 else "", y="")
        if len(names) > 1:
            legend(axes)
    page.align_ylabels()
    return page


def groups(names: Sequence[str]) -> list[list[str]]:
    """Return columns in groups that differ by digits only, such as m1 to m4; counters only where they are alone."""
    shown = [name for name in names if name not in _COUNTERS] or list(names)
    found: dict[str, list[str]] = {}
    for name in shown:
        found.setdefault(re.sub(r"\d", "", name), []).append(name)
    return list(found.values())
