"""Drawings of the rig show each item of rig.toml where a person would look for it."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from cfid.drawing.rig import load_cell_figure, mounts_figure
from cfid.records.rig_file import BodyFrame, Mount

Array = npt.NDArray[np.float64]
AHEAD = BodyFrame()
FRAMES = {
    "x forward": (AHEAD, np.eye(3)),
    "y forward": (BodyFrame(forward="y", left="-x", up="z"), np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])),
    "x forward, z down": (BodyFrame(forward="x", left="-y", up="-z"), np.diag([1, -1, -1])),
    "z forward": (BodyFrame(forward="z", left="y", up="-x"), np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])),
}  # rows of the matrix: forward, left and up


def panels(figure: Figure) -> tuple[Axes, Axes]:
    above, side = figure.axes
    return above, side


def place(axes: Axes, name: str) -> tuple[float, float]:
    """Return the position of a name in a drawing."""
    (found,) = (one.xy for one in axes.texts if isinstance(one, Annotation) and one.get_text() == name)
    return found


def ends(axes: Axes, name: str) -> tuple[Array, Array]:
    """Return both ends of the axis whose name is at its second end."""
    lines = [np.asarray(line.get_xydata()) for line in axes.lines]
    (own,) = (line for line in lines if len(line) == 2 and np.allclose(line[1], place(axes, name)))
    return own[0], own[1]


def test_an_axis_is_drawn_where_its_mount_states_it_with_the_nose_up_and_left_on_the_left() -> None:
    above, side = panels(mounts_figure({"a": Mount(point_mm=(10, 20, 30), direction=(0, 1, 0))}, AHEAD))
    begin, end = ends(above, "a")

    assert (begin + end) / 2 == pytest.approx([-20, 10])
    assert (end - begin)[0] < 0
    assert (end - begin)[1] == pytest.approx(0)
    assert any(np.allclose(drawn.get_xydata(), [[10, 30]]) for drawn in side.lines)  # the axis seen from its end


@pytest.mark.parametrize(("frame", "rows"), FRAMES.values(), ids=FRAMES)
def test_a_mount_on_an_arm_is_drawn_at_the_motor_that_flies_there_whatever_the_frame(
    frame: BodyFrame, rows: Array
) -> None:
    ways = {"m1": (1, -1), "m2": (-1, -1), "m3": (-1, 1), "m4": (1, 1)}  # forward and left, in the Crazyflie's order
    for motor, (ahead, left) in ways.items():
        point, up = rows.T @ (30.0 * ahead, 30.0 * left, 20.0), rows.T @ (0.0, 0.0, 1.0)
        above, side = panels(mounts_figure({"a": Mount(point_mm=tuple(point), direction=tuple(up))}, frame))
        label, ring = np.array(place(above, motor)), np.array(place(above, "a"))

        assert ring == pytest.approx([-30 * left, 30 * ahead])
        assert ring @ label > 0.99 * np.linalg.norm(ring) * np.linalg.norm(label)
        assert np.mean(ends(side, "a"), axis=0) == pytest.approx([30 * ahead, 20])
        assert np.array_equal(np.sign(place(above, "nose")), [0, 1])


@pytest.mark.parametrize(("yaw_deg", "left"), [(90, (-1, 0)), (0, (0, 1)), (-45, (math.sqrt(0.5), math.sqrt(0.5)))])
def test_the_cells_x_axis_lies_left_of_the_nose_by_its_yaw(yaw_deg: float, left: tuple[float, float]) -> None:
    above, _ = panels(load_cell_figure(yaw_deg))
    name = place(above, "x of the cell")

    assert np.array(name) / np.hypot(*name) == pytest.approx(left)


def test_the_wind_comes_from_the_right_of_the_nose_by_its_azimuth_and_from_above_by_its_angle() -> None:
    above, side = panels(load_cell_figure(0, azimuth_deg=90, angles_deg=[30]))
    from_right, from_above = place(above, "wind"), place(side, "wind 30°")

    assert from_right[0] > 50
    assert from_right[1] == pytest.approx(0)
    assert math.degrees(math.atan2(from_above[0], from_above[1] - 20)) == pytest.approx(30)
