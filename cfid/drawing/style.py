"""The style of every figure: one palette, one page, one place for titles, legends, rejections and notes.

Figures are made without pyplot, so that they share no state, and with cfid's own settings, so that they look the same
with any matplotlibrc of the user.
"""

import functools
import textwrap
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, ParamSpec, TypeVar

import matplotlib.style
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine

from cfid.large import parts

Array = npt.NDArray[np.float64]
P = ParamSpec("P")
T = TypeVar("T")

# After Okabe and Ito, whose colours the colour-blind can distinguish. Recorded data is wide and pale, and computed
# curves above it are thin and dark, so that the two also differ in a grey print.
RECORDED = "#0072B2"
RECORDED_BELOW = "#8CC8EE"
MODEL = "#A33F00"
WINDOW = "#009E73"
INK = "#222222"
MUTED = "#777777"
ALERT = "#C1121F"
SERIES = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#8C8C00")
DASHES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")

PAGE_WIDTH_IN = 7.2  # at 90 % it fills an A4 page between its margins
KEY_IN = 0.12  # height of a row with only a legend

_GRID = "#DDDDDD"
_LINE_IN = 0.165
_CHARACTERS = 112  # in a line of text across the page
_MANY_PERIODS, _SHOWN_PERIODS = 25, 5  # of a record: more than the former are one dark bar
_MOST_POINTS = 4000  # of a drawn line: two extremes for every dot across a printed page

STYLE = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "axes.titlepad": 5.0,
    "axes.xmargin": 0.015,
    "font.family": "DejaVu Sans",  # comes with matplotlib, so it is the same on every computer
    "font.size": 9,
    "grid.color": _GRID,
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.5,
    "legend.borderaxespad": 0.0,
    "legend.borderpad": 0.0,
    "legend.columnspacing": 1.2,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.handletextpad": 0.5,
    "lines.linewidth": 1.0,
    "svg.fonttype": "path",
    "svg.hashsalt": "cfid",  # makes identifiers in the file depend only on its content
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8.5,
}


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Run a function that draws or saves with cfid's settings of matplotlib."""

    @functools.wraps(draw)
    def inside(*args: P.args, **kwargs: P.kwargs) -> T:
        with matplotlib.style.context(STYLE, after_reset=True):
            return draw(*args, **kwargs)

    return inside


def figure(
    rows: int,
    columns: int,
    *,
    heights_in: Sequence[float],
    widths: Sequence[float] | None = None,
    title: str = "",
    rejections: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> tuple[Figure, GridSpec]:
    """Return a page of the common width, and its grid of `rows` with the given heights and `columns`.

    Above the grid are the title, then wrapped `rejections` in red and `notes` in grey; the page grows with them. Texts
    are printed literally, so that a dollar sign in a file's name starts no formula.
    """
    head = [(line, INK, "bold") for line in textwrap.wrap(title, 84)]
    head += [(line, ALERT, "normal") for text in rejections for line in textwrap.wrap(text, _CHARACTERS)]
    head += [(line, MUTED, "normal") for note in notes for line in textwrap.wrap(f"Note: {note}", _CHARACTERS)]
    head_in = _LINE_IN * len(head) + (0.15 if head else 0.0)
    height_in = sum(heights_in) + head_in
    page = Figure(figsize=(PAGE_WIDTH_IN, height_in))
    FigureCanvasAgg(page)
    page.set_layout_engine(
        ConstrainedLayoutEngine(rect=(0, 0, 1, 1 - head_in / height_in), w_pad=0.06, h_pad=0.06, hspace=0.02)
    )
    for i, (line, colour, weight) in enumerate(head):
        size, down_in = (10.5, 0.0) if weight == "bold" else (8.5, 0.05)
        top = 1 - (0.08 + down_in + _LINE_IN * i) / height_in
        page.text(0.012, top, line, color=colour, weight=weight, size=size, va="top", parse_math=False)
    return page, page.add_gridspec(rows, columns, height_ratios=list(heights_in), width_ratios=widths)


def name_panel(axes: Axes, title: str, *, x: str, y: str, colour: str = INK) -> None:
    """Write a panel's title at its left, and the quantities of both axes with their units."""
    axes.set_title(title, parse_math=False, color=colour)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def legend(axes: Axes) -> None:
    """Put the legend above the axes on the right, where it cannot cover data."""
    handles, _ = axes.get_legend_handles_labels()
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1, 1), ncols=len(handles), borderaxespad=0.35)


def key_row(axes: Axes, *entries: Artist) -> None:
    """Turn axes into a common legend for all panels below them."""
    axes.set_axis_off()
    axes.legend(handles=entries, loc="center right", ncols=len(entries))


def key_column(axes: Axes, handles: Sequence[Artist]) -> None:
    """Turn the axes next to a panel into its legend."""
    axes.set_axis_off()
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(0, 1), labelspacing=0.6)


def words(axes: Axes, title: str, lines: Sequence[tuple[str, str]], *, red: Sequence[str] = ()) -> None:
    """Turn axes into a small table of names and texts, with the rows named in `red` in red."""
    axes.set_axis_off()
    axes.set_title(title, parse_math=False)
    for i, (name, value) in enumerate(lines):
        down = -72 * _LINE_IN * i - 2
        for left, text, colour in ((0.0, name, MUTED), (0.45, value, ALERT if name in red else INK)):
            axes.annotate(
                text,
                (left, 1.0),
                xytext=(0, down),
                xycoords="axes fraction",
                textcoords="offset points",
                va="top",
                size=8.5,
                color=colour,
                parse_math=False,
                in_layout=False,
            )


def thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """Return a line that looks the same with a bounded number of points, so that a figure of a long record stays small.

    The lowest and the highest sample of every short segment are kept, in their order.
    """
    if len(x) <= _MOST_POINTS:
        return x, y
    edges = np.linspace(0, len(x), _MOST_POINTS // 2 + 1).astype(int)[:-1]
    lows, highs = (_extremes(y, edges, pick) for pick in (np.minimum, np.maximum))
    kept = np.unique(np.concatenate([[0], lows, highs, [len(x) - 1]]))
    return x[kept], y[kept]


def draw_line(axes: Axes, x: Array, y: Array, *, factor: float = 1.0, **how: Any) -> None:
    """Draw a line with any number of samples, whose values (n,) are multiplied by a factor."""
    pieces = [thinned(x[part], factor * y[part]) for part in parts(len(x))]
    axes.plot(*(np.concatenate(each) for each in zip(*pieces, strict=True)), **how)


class Piece(NamedTuple):
    """A panel's axes and the samples that they show."""

    axes: Axes
    samples: slice


def pieces(page: Figure, grid: GridSpec, row: int, time_s: Array, *, period_s: float) -> list[Piece]:
    """Return axes for a whole record (n,), or a pair of axes for its first and its last periods.

    They fill one row of a grid with two columns. The pair shares a vertical axis; the second has no labels of its own.
    """
    if time_s[-1] - time_s[0] <= _MANY_PERIODS * period_s:
        return [Piece(page.add_subplot(grid[row, :]), slice(None))]
    left = page.add_subplot(grid[row, 0])
    right = page.add_subplot(grid[row, 1], sharey=left)
    right.tick_params(labelleft=False, left=False)
    right.spines.left.set_linestyle((0, (2, 3)))
    shown = _SHOWN_PERIODS * period_s
    early = int(np.searchsorted(time_s, time_s[0] + shown, side="right"))
    late = int(np.searchsorted(time_s, time_s[-1] - shown))
    return [Piece(left, slice(None, early)), Piece(right, slice(late, None))]


def _extremes(y: Array, edges: npt.NDArray[np.intp], pick: np.ufunc) -> npt.NDArray[np.intp]:
    """Return the first extreme sample of each segment between edges."""
    extreme = np.repeat(pick.reduceat(y, edges), np.diff(np.append(edges, len(y))))
    at = np.flatnonzero(y == extreme)
    _, first = np.unique(np.searchsorted(edges, at, side="right"), return_index=True)
    return at[first]
