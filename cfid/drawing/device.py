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
_HELD = re.compile(r"m[1-4]")  # a command holds until the next one
_COUNTERS = ("vehicle_us", "vehicle_ms", "report", "sample")  # straight lines, useful only to programs
_WIDE = 40  # characters of names up to which title and legend fit next to each other
_FEW = 400  # rows: below this number, each row is marked


@styled
def device_figure(
    time_s: Array, columns: Mapping[str, Array], *, title: str, notes: Sequence[str], along: str = "time (s)"
) -> Figure:
    """Return a figure with a panel for each group of columns (n,) that differ only by a number, over times (n,) in s.

    `along` names the horizontal axis if it shows no times. A group with more columns than colours shows the first ones.
    """
    panels = groups(list(columns))[:_MOST_PANELS]
    page, grid = figure(len(panels), 1, heights_in=[_PANEL_IN] * len(panels), title=title, notes=notes)
    since_s = time_s - time_s[0]
    for row, names in enumerate(panels):
        axes = page.add_subplot(grid[row, 0])
        drawn = names[: len(SERIES)]
        for colour, name, label in zip(SERIES, drawn, _labels(drawn), strict=False):
            how: dict[str, Any] = {"drawstyle": "steps-post"} if _HELD.fullmatch(name) else {}
            mark = "." if len(since_s) < _FEW and not how else ""
            draw_line(axes, since_s, columns[name], color=colour, label=label, marker=mark, **how)
        name_panel(axes, _title(drawn, len(names)), x=along if row == len(panels) - 1 else "", y="")
        if len(names) > 1:
            legend(axes)
    page.align_ylabels()
    return page


def _title(drawn: Sequence[str], count: int) -> str:
    """Return the title of a panel that draws some of `count` columns."""
    whole = ", ".join(drawn)
    title = whole if len(whole) <= _WIDE else f"{drawn[0]} to {_labels(drawn)[-1]}"
    return title if len(drawn) == count else f"{title}, of {count}"


def _labels(drawn: Sequence[str]) -> list[str]:
    """Return the labels of columns: their names, or if these are long only the numbers in which they differ."""
    if len(drawn) < 2 or len(", ".join(drawn)) <= _WIDE:
        return list(drawn)
    return [" ".join(re.findall(r"\d+", name)) or name for name in drawn]


def groups(names: Sequence[str]) -> list[list[str]]:
    """Return columns in groups that differ only by digits, such as m1 to m4; counters only if no others exist."""
    shown = [name for name in names if name not in _COUNTERS] or list(names)
    found: dict[str, list[str]] = {}
    for name in shown:
        found.setdefault(re.sub(r"\d", "", name), []).append(name)
    return list(found.values())
