"""Draw the rig for the how-to pages: `python docs/make_drawings.py`."""

import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Rectangle

from cfid.drawing.rig import load_cell_figure, mounts_figure
from cfid.records.rig_file import RIG_FILE, load_rig, new_rig_text

mpl.rcParams.update({"svg.hashsalt": "cfid", "svg.fonttype": "none"})  # the same drawing is the same file
FOLDER = Path(__file__).parent / "how-to" / "figures"
INK, BODY, SIZE, PATH = "#222222", "#cfd8e3", "#b03a2e", "#1f6fb2"


def main() -> None:
    """Write both suspensions, and the mounts, the load cell and the wind of a new rig.toml."""
    FOLDER.mkdir(exist_ok=True)
    for name, draw in (("axis", _axis), ("threads", _threads)):
        figure = Figure(figsize=(6.4, 3.9), layout="constrained")
        axes = figure.add_subplot()
        axes.set_aspect("equal")
        axes.set_axis_off()
        draw(axes)
        figure.savefig(FOLDER / f"suspension_{name}.svg", metadata={"Date": None})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / RIG_FILE
        path.write_text(new_rig_text(), encoding="utf-8")
        rig = load_rig(path)
    drawn = {
        "mounts": mounts_figure(rig.mounts, rig.vehicle.body_frame),
        "load_cell": load_cell_figure(rig.loadcell.yaw_deg or 0.0),
        "wind": load_cell_figure(rig.wind.yaw_deg or 0.0, azimuth_deg=rig.wind.azimuth_deg, angles_deg=[48.4]),
    }
    for name, page in drawn.items():
        page.savefig(FOLDER / f"{name}.svg", metadata={"Date": None})


def _axis(axes: Axes) -> None:
    """Draw a vehicle below a horizontal axis, seen along the axis."""
    axes.plot([-2.2, 2.2], [0, 0], color=INK, lw=0.8, ls=":")
    axes.plot([0, 0], [0, -3.4], color=INK, lw=0.8, ls="--")
    axes.add_patch(Circle((0, 0), 0.12, fc="white", ec=INK, lw=1.6))
    axes.annotate("axis in a ball bearing,\nor a knife edge", (0.12, 0.1), (0.8, 0.45), arrowprops=_line())
    axes.plot([0, 0], [-0.12, -2.0], color=INK, lw=2.0)
    axes.add_patch(Rectangle((-1.6, -2.45), 3.2, 0.45, fc=BODY, ec=INK))
    _centre(axes, 0.0, -2.2)
    _size(axes, (-2.1, 0.0), (-2.1, -2.2), "r: distance of the\ncentre of mass", side=-0.12, align="right")
    axes.add_patch(Arc((0, 0), 6.2, 6.2, theta1=248, theta2=292, color=PATH, lw=1.6))
    axes.text(-1.35, -3.05, "swing, let go at\n20 to 70 degrees", color=PATH, ha="right")
    axes.set_xlim(-5.2, 4.6)
    axes.set_ylim(-3.6, 1.1)


def _threads(axes: Axes) -> None:
    """Draw a vehicle on two threads, seen from the side."""
    above, below, height = 1.5, 1.2, 3.6
    axes.plot([-2.4, 2.4], [height, height], color=INK, lw=3.0)
    for side in (-1, 1):
        axes.plot([side * above, side * below], [height, 0], color=INK, lw=1.2)
        axes.plot([side * below], [0], "o", color=INK, ms=3)
    axes.plot([0, 0], [-0.9, height + 0.25], color=INK, lw=0.8, ls="--")
    axes.text(0.08, height - 1.1, "vertical through\nthe centre of mass,\nin the middle", fontsize=8)
    axes.add_patch(Rectangle((-1.6, -0.45), 3.2, 0.45, fc=BODY, ec=INK))
    _centre(axes, 0.0, -0.22)
    _size(axes, (-above, height + 0.35), (above, height + 0.35), "above_mm", side=0.1)
    _size(axes, (-below, -0.85), (below, -0.85), "below_mm", side=-0.32)
    _size(axes, (2.3, 0.0), (2.3, height), "length_mm, along\na thread", side=0.14, align="left")
    arrow = {"arrowstyle": "->", "color": PATH, "lw": 1.6, "mutation_scale": 14}
    axes.add_patch(FancyArrowPatch((-0.55, 0.75), (0.55, 0.75), connectionstyle="arc3,rad=0.5", **arrow))
    axes.text(-3.1, 0.55, "turn about the vertical,\nlet go at 20 to 70 degrees", color=PATH, ha="center")
    axes.set_xlim(-5.2, 4.6)
    axes.set_ylim(-1.4, height + 0.9)


def _centre(axes: Axes, x: float, y: float) -> None:
    axes.plot([x], [y], "o", color=SIZE, ms=5)
    axes.annotate("centre of mass", (x, y), (x + 1.9, y - 0.45), color=SIZE, arrowprops=_line(SIZE))


def _size(
    axes: Axes, begin: tuple[float, float], end: tuple[float, float], name: str, *, side: float, align: str = "center"
) -> None:
    """Draw a length with its name, beside or above it."""
    axes.annotate("", begin, end, arrowprops={"arrowstyle": "<->", "color": SIZE, "lw": 1.0})
    upright = begin[0] == end[0]
    x, y = (begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2
    axes.text(
        x + side * upright, y + side * (not upright), name, color=SIZE, ha=align, va="center" if upright else "bottom"
    )


def _line(colour: str = INK) -> dict[str, object]:
    return {"arrowstyle": "-", "color": colour, "lw": 0.8}


if __name__ == "__main__":
    main()
