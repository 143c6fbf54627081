"""Draw the states of the vehicle's supervisor for docs/explanation/vehicle.md: `python docs/make_states.py`."""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

FILE = Path(__file__).parent / "explanation" / "figures" / "supervisor.png"

# Each state: its name, its place, and what motors do in it.
STATES = {
    "not ready": (0.0, 0.0, "off"),
    "disarmed": (3.3, 0.0, "off"),
    "arming": (7.0, 0.0, "idle"),
    "ready": (11.0, 0.0, "run"),
    "flying": (11.0, -2.0, "run"),
    "landed\n(reported as ready)": (7.0, -2.0, "run"),
    "level-out\n(reported as flying)": (14.6, -2.0, "run"),
    "crashed": (11.0, -4.0, "off"),
    "tumbled": (0.0, -2.0, "off"),
    "locked": (14.6, -4.0, "off"),
}
COLOURS = {"off": "#e4e4e4", "idle": "#f6dd9a", "run": "#bfe0b8"}
WIDTH, HEIGHT = 1.9, 0.8

# Each arrow: from which state, to which state, on which condition, and its bend.
ARROWS = [
    ("not ready", "disarmed", "upright", 0.0),
    ("disarmed", "arming", "armed by\na client;\nbrushed:\nby itself", 0.0),
    ("arming", "ready", "brushed:\nat once;\nBrushless:\nat 1000 to\n3500 rpm", 0.0),
    ("arming", "not ready", "2 s without that, or disarmed", 0.28),
    ("ready", "not ready", "30 s, or disarmed", 0.3),
    ("ready", "flying", "thrust", 0.0),
    ("flying", "landed\n(reported as ready)", "2 s without\nthrust", 0.0),
    ("landed\n(reported as ready)", "not ready", "3 s, or disarmed", 0.0),
    ("flying", "level-out\n(reported as flying)", "setpoint 0.5 s old", 0.3),
    ("level-out\n(reported as flying)", "flying", "fresh setpoint", 0.3),
    ("level-out\n(reported as flying)", "locked", "setpoint\n2 s old", 0.0),
    ("flying", "crashed", "tumbled", 0.0),
    ("flying", "locked", "emergency stop, or a rotor\nat 1 to 499 rpm for 0.2 s", 0.0),
    ("crashed", "not ready", "upright, and recovered by a client", -0.25),
    ("tumbled", "not ready", "upright", 0.6),
    ("not ready", "tumbled", "on its side", 0.6),
]


def main() -> None:
    """Write the figure."""
    figure = Figure(figsize=(12.5, 5.4), layout="constrained")
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.set_xlim(-1.3, 15.9)
    axes.set_ylim(-5.0, 1.9)
    boxes = {}
    for name, (x, y, motors) in STATES.items():
        corner = (x - WIDTH / 2, y - HEIGHT / 2)
        box = FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle="round,pad=0.05", fc=COLOURS[motors], ec="#444444")
        boxes[name] = axes.add_patch(box)
        axes.text(x, y, name, ha="center", va="center", fontsize=9)
    for start, end, text, bend in ARROWS:
        _arrow(axes, boxes[start], boxes[end], text, bend)
    for count, (motors, words) in enumerate(
        {"off": "motors off", "idle": "idle thrust", "run": "motors may run"}.items()
    ):
        axes.text(-1.2, -3.9 - 0.45 * count, f" {words} ", fontsize=9, bbox={"fc": COLOURS[motors], "ec": "#444444"})
    figure.savefig(FILE, dpi=110)


def _arrow(axes: Axes, start: FancyBboxPatch, end: FancyBboxPatch, text: str, bend: float) -> None:
    (x0, y0), (x1, y1) = _middle(start), _middle(end)
    style = {"arrowstyle": "->", "color": "#444444", "connectionstyle": f"arc3,rad={bend}"}
    axes.annotate("", (x1, y1), (x0, y0), arrowprops={**style, "patchA": start, "patchB": end})
    x, y = (x0 + x1) / 2 + bend * (y1 - y0) / 2, (y0 + y1) / 2 - bend * (x1 - x0) / 2
    axes.text(x, y, text, ha="center", va="center", fontsize=7.5, bbox={"fc": "white", "ec": "none", "pad": 1})


def _middle(box: FancyBboxPatch) -> tuple[float, float]:
    return box.get_x() + box.get_width() / 2, box.get_y() + box.get_height() / 2


if __name__ == "__main__":
    main()
