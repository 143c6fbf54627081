"""Draw the rig as rig.toml states it, so that a wrong sign or a wrong arm shows: mounts, load cell, wind."""

import math
from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.text import Annotation

from cfid.drawing.style import INK, MODEL, MUTED, SERIES, WINDOW, figure, styled
from cfid.records.rig_file import BodyFrame, Mount, Vector

Point = tuple[float, float]

_ARM_MM, _ROTOR_MM = 46.0, 23.0  # of a Crazyflie
_PANEL_IN = 3.0
_SHORTEST_MM, _LONGER_MM = 24.0, 7.0  # half an axis, and how much longer each next one is, to separate the names
_ARROW_MM = 40.0
_NAME_MM = 9.0  # least distance between two names
_BODY_AXES = {"x": (_ARROW_MM, 0, 0), "y": (0, _ARROW_MM, 0), "z": (0, 0, _ARROW_MM)}
_WIND_MM = 95.0


@styled
def mounts_figure(mounts: Mapping[str, Mount], frame: BodyFrame, *, title: str = "") -> Figure:
    """Return the swings' axes through the vehicle, from above and from its right, with points and directions to scale.

    The nose points up in the first view and to the right in the second, whichever body axis of `frame` is forward.
    """
    page, grid = figure(1, 2, heights_in=[_PANEL_IN], title=title)
    above, side = (
        _plan(page.add_subplot(grid[0, place]), name) for place, name in enumerate(("from above", "from the right"))
    )
    _vehicle_above(above)
    side.add_patch(Rectangle((-_ARM_MM, -3), 2 * _ARM_MM, 6, fc="none", ec=MUTED))
    side.annotate("nose", (_ARM_MM, -11), color=MUTED, ha="center", size=8.5)
    for axes, seen in ((above, _from_above), (side, _from_the_right)):
        for name, axis in _BODY_AXES.items():
            end = seen(frame.turned(axis))
            if any(end):
                _arrow(axes, (0, 0), end, f"body {name}", MUTED)
        for place, (name, mount) in enumerate(mounts.items()):
            half = (_SHORTEST_MM + _LONGER_MM * place) / math.hypot(*mount.direction)
            middle = seen(frame.turned([1e3 * length for length in mount.point_m]))
            along = seen(frame.turned([half * part for part in mount.direction]))
            _axis(axes, middle, along, name, SERIES[place % len(SERIES)])
    return page


@styled
def load_cell_figure(
    yaw_deg: float, *, azimuth_deg: float | None = None, angles_deg: Sequence[float] = (), title: str = ""
) -> Figure:
    """Return the load cell under the vehicle, from above and from the side, with the direction of the wind, if any.

    `yaw_deg` is the angle of the cell's x axis to the left of the nose, `azimuth_deg` the angle of the wind generator
    to the right of the nose, and `angles_deg` the angle of the wind from the vertical for each wind setting.
    """
    page, grid = figure(1, 2, heights_in=[_PANEL_IN], title=title)
    above, side = (
        _plan(page.add_subplot(grid[0, place]), name) for place, name in enumerate(("from above", "from the side"))
    )
    _vehicle_above(above)
    left = math.radians(yaw_deg)
    for name, turned in (("x", left), ("y", left + math.pi / 2)):
        _arrow(
            above, (0, 0), (-_ARROW_MM * math.sin(turned), _ARROW_MM * math.cos(turned)), f"{name} of the cell", MODEL
        )
    if azimuth_deg is not None:
        right = math.radians(azimuth_deg)
        _wind(above, (_WIND_MM * math.sin(right), _WIND_MM * math.cos(right)), (0.0, 0.0), "wind")
    _load_cell_side(side)
    for angle_deg in angles_deg:
        down = math.radians(angle_deg)
        begin = _WIND_MM * math.sin(down), 20 + _WIND_MM * math.cos(down)
        _wind(side, begin, (0.0, 20.0), f"wind {angle_deg:.3g}°")
    if angles_deg:
        side.plot([0, 0], [20, 20 + _WIND_MM], color=MUTED, lw=0.8, ls=":")
    return page


def _from_above(parts: Vector) -> Point:
    ahead, left, _ = parts
    return -left, ahead


def _from_the_right(parts: Vector) -> Point:
    ahead, _, up = parts
    return ahead, up


def _plan(axes: Axes, name: str) -> Axes:
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(name)
    return axes


def _vehicle_above(axes: Axes) -> None:
    """Draw arms and rotors, motor 1 at the front right, and the nose upwards."""
    reach = _ARM_MM / math.sqrt(2)
    axes.annotate("nose", (0, 1.25 * _ARM_MM), color=MUTED, ha="center", size=8.5)
    for motor, (right, ahead) in enumerate(((1, 1), (1, -1), (-1, -1), (-1, 1)), start=1):
        end = right * reach, ahead * reach
        axes.plot([0, end[0]], [0, end[1]], color=MUTED, lw=2.5, alpha=0.5)
        axes.add_patch(Circle(end, _ROTOR_MM, fc="none", ec=MUTED, lw=0.8))
        axes.annotate(
            f"m{motor}", (end[0] + 0.75 * right * _ROTOR_MM, end[1] + 0.75 * ahead * _ROTOR_MM), color=MUTED, size=8
        )
    axes.autoscale_view()


def _load_cell_side(axes: Axes) -> None:
    axes.plot([-70, 70], [-35, -35], color=INK, lw=2)
    axes.add_patch(Rectangle((-16, -35), 32, 22, fc="none", ec=INK))
    axes.annotate("load cell", (20, -27), color=INK, size=8.5)
    axes.plot([0, 0], [-13, 12], color=INK, lw=2)
    axes.add_patch(Rectangle((-_ARM_MM, 12), 2 * _ARM_MM, 6, fc="none", ec=MUTED))
    for end in (-_ARM_MM, _ARM_MM):
        axes.plot([end - _ROTOR_MM, end + _ROTOR_MM], [24, 24], color=MUTED, lw=1.5)
    _arrow(axes, (-12, 18), (-12, 18 + _ARROW_MM), "Fz", MODEL)  # leaves space for a wind from above


def _axis(axes: Axes, middle: Point, along: Point, name: str, colour: str) -> None:
    """Draw an axis through a point; an axis seen end-on is a ring."""
    axes.plot(*middle, "o", color=colour, ms=3)
    if math.hypot(*along) < 1:
        axes.plot(*middle, "o", color=colour, ms=9, mfc="none")
        axes.annotate(name, middle, xytext=(5, -11), textcoords="offset points", color=colour, parse_math=False)
        return
    begin, end = ((middle[0] + way * along[0], middle[1] + way * along[1]) for way in (-1, 1))
    if not _is_free(axes, end):
        begin, end = end, begin
    axes.plot(*zip(begin, end, strict=True), color=colour, lw=1.6)
    axes.annotate(name, end, xytext=(2, 2), textcoords="offset points", color=colour, parse_math=False)


def _is_free(axes: Axes, spot: Point) -> bool:
    """Return whether a name at a spot would cover no other name."""
    return all(math.dist(spot, one.xy) > _NAME_MM for one in axes.texts if isinstance(one, Annotation))


def _arrow(axes: Axes, begin: Point, end: Point, name: str, colour: str) -> None:
    axes.annotate("", end, begin, arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.2})
    beyond = end[0] + 0.2 * (end[0] - begin[0]), end[1] + 0.2 * (end[1] - begin[1])
    axes.annotate(name, beyond, color=colour, size=8.5, ha="center", va="center")
    axes.plot(*beyond, alpha=0)  # extends the panel, which clips what is outside


def _wind(axes: Axes, begin: Point, end: Point, name: str) -> None:
    axes.annotate("", end, begin, arrowprops={"arrowstyle": "->", "color": WINDOW, "lw": 2.5, "shrinkB": 6})
    axes.annotate(name, begin, xytext=(4, 2), textcoords="offset points", color=WINDOW)
    axes.plot(*begin, alpha=0)
