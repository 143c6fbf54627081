"""Draw how a body hangs on the swing: on an axis through its cube, or on two threads."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Rectangle

from cfid.drawing.style import INK, figure, styled

_BODY, _SIZE, _PATH = "#cfd8e3", "#b03a2e", "#1f6fb2"
_HEIGHT_IN = 3.9


@styled
def axis_figure(*, title: str = "") -> Figure:
    """Return a vehicle below a horizontal axis, seen along the axis."""
    page, axes = _page(title)
    _axis(axes)
    return page


@styled
def threads_figure(*, title: str = "") -> Figure:
    """Return a vehicle on two threads, seen from the side, with the names of their lengths in rig.toml."""
    page, axes = _page(title)
    _threads(axes)
    return page


def _page(title: str) -> tuple[Figure, Axes]:
    page, grid = figure(1, 1, heights_in=[_HEIGHT_IN], title=title)
    axes = page.add_subplot(grid[0, 0])
    axes.set_aspect("equal")
    axes.set_axis_off()
    return page, axes


def _axis(axes: Axes) -> None:
    axes.plot([-2.2, 2.2], [0, 0], color=INK, lw=0.8, ls=":")
    axes.plot([0, 0], [0, -3.4], color=INK, lw=0.8, ls="--")
    axes.add_patch(Circle((0, 0), 0.12, fc="white", ec=INK, lw=1.6))
    axes.annotate("axis in a ball bearing,\nor a knife edge", (0.12, 0.1), (0.8, 0.45), arrowprops=_line())
    axes.plot([0, 0], [-0.12, -2.0], color=INK, lw=2.0)
    axes.add_patch(Rectangle((-1.6, -2.45), 3.2, 0.45, fc=_BODY, ec=INK))
    _centre(axes, 0.0, -2.2)
    _size(axes, (-2.1, 0.0), (-2.1, -2.2), "r: distance of the\ncentre of mass", side=-0.12, align="right")
    axes.add_patch(Arc((0, 0), 6.2, 6.2, theta1=248, theta2=292, color=_PATH, lw=1.6))
    axes.text(-1.35, -3.05, "swing, let go at\n20 to 70 degrees", color=_PATH, ha="right")
    axes.set_xlim(-5.2, 4.6)
    axes.set_ylim(-3.6, 1.1)


def _threads(axes: Axes) -> None:
    above, below, height = 1.5, 1.2, 3.6
    axes.plot([-2.4, 2.4], [height, height], color=INK, lw=3.0)
    for side in (-1, 1):
        axes.plot([side * above, side * below], [height, 0], color=INK, lw=1.2)
        axes.plot([side * below], [0], "o", color=INK, ms=3)
    axes.plot([0, 0], [-0.9, height + 0.25], color=INK, lw=0.8, ls="--")
    axes.text(0.08, height - 1.1, "vertical through\nthe centre of mass,\nin the middle", fontsize=8)
    axes.add_patch(Rectangle((-1.6, -0.45), 3.2, 0.45, fc=_BODY, ec=INK))
    _centre(axes, 0.0, -0.22)
    _size(axes, (-above, height + 0.35), (above, height + 0.35), "above_mm", side=0.1)
    _size(axes, (-below, -0.85), (below, -0.85), "below_mm", side=-0.32)
    _size(axes, (2.3, 0.0), (2.3, height), "length_mm, along\na thread", side=0.14, align="left")
    arrow: dict[str, Any] = {"arrowstyle": "->", "color": _PATH, "lw": 1.6, "mutation_scale": 14}
    axes.add_patch(FancyArrowPatch((-0.55, 0.75), (0.55, 0.75), connectionstyle="arc3,rad=0.5", **arrow))
    axes.text(-3.1, 0.55, "turn about the vertical,\nlet go at 20 to 70 degrees", color=_PATH, ha="center")
    axes.set_xlim(-5.2, 4.6)
    axes.set_ylim(-1.4, height + 0.9)


def _centre(axes: Axes, x: float, y: float) -> None:
    axes.plot([x], [y], "o", color=_SIZE, ms=5)
    axes.annotate("centre of mass", (x, y), (x + 1.9, y - 0.45), color=_SIZE, arrowprops=_line(_SIZE))


def _size(
    axes: Axes, begin: tuple[float, float], end: tuple[float, float], name: str, *, side: float, align: str = "center"
) -> None:
    """Draw a length with its name next to it or above it."""
    axes.annotate("", begin, end, arrowprops={"arrowstyle": "<->", "color": _SIZE, "lw": 1.0})
    upright = begin[0] == end[0]
    x, y = (begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2
    axes.text(
        x + side * upright, y + side * (not upright), name, color=_SIZE, ha=align, va="center" if upright else "bottom"
    )


def _line(colour: str = INK) -> dict[str, Any]:
    return {"arrowstyle": "-", "color": colour, "lw": 0.8}
