"""Values turn exactly from the campaign's body frame to x forward, y left, z up, with the thesis' x and y swapped."""

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import numpy.typing as npt
import pytest

from cfid.export.frame import is_turned, turned_matrix, turned_spread
from cfid.export.hover import drag_kg_per_rad, inertia_kg_m2, inertia_std_kg_m2, rotor_places_m
from cfid.records.rig_file import BodyFrame
from tests.export.thesis_vehicle import INERTIA_KG_M2, INERTIA_STD_KG_M2, vehicle

THESIS = BodyFrame(forward="y", left="-x", up="z")


def unit(axis: str) -> npt.NDArray[np.float64]:
    rows: npt.NDArray[np.float64] = np.eye(3) * (-1.0 if axis.startswith("-") else 1.0)
    return np.array(rows["xyz".index(axis[-1])])


def right_handed() -> list[BodyFrame]:
    frames = []
    for names in permutations("xyz"):
        for signs in product(("", "-"), repeat=3):
            forward, left, up = (sign + name for sign, name in zip(signs, names, strict=True))
            if np.array_equal(np.cross(unit(forward), unit(left)), unit(up)):
                frames.append(BodyFrame.model_validate({"forward": forward, "left": left, "up": up}))
    return frames


def test_there_are_twenty_four_right_handed_frames() -> None:
    assert len(right_handed()) == 24


@pytest.mark.parametrize("frame", right_handed(), ids=lambda f: f"{f.forward},{f.left},{f.up}")
def test_vectors_and_tensors_turn_by_the_matrix_of_the_three_axes(frame: BodyFrame) -> None:
    rotation = np.array([unit(frame.forward), unit(frame.left), unit(frame.up)])
    matrix = np.array(INERTIA_KG_M2)

    assert frame.turned((1.0, 2.0, 3.0)) == tuple(rotation @ [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(turned_matrix(INERTIA_KG_M2, frame), rotation @ matrix @ rotation.T)
    np.testing.assert_allclose(
        turned_spread(INERTIA_STD_KG_M2, frame), abs(rotation) @ INERTIA_STD_KG_M2 @ abs(rotation).T, rtol=1e-15
    )
    assert is_turned(frame) == (not np.array_equal(rotation, np.eye(3)))


def test_the_thesis_forward_is_its_y_and_its_left_is_minus_its_x() -> None:
    assert THESIS.turned((0, 1, 0)) == (1, 0, 0)
    assert THESIS.turned((-1, 0, 0)) == (0, 1, 0)


def test_the_thesis_inertia_about_the_roll_axis_is_the_larger_of_the_two() -> None:
    matrix = inertia_kg_m2(vehicle())

    assert matrix[0] == (16.655602e-6, -0.830806e-6, 1.800197e-6)
    assert matrix[1] == (-0.830806e-6, 16.571710e-6, -0.718277e-6)
    assert matrix[2] == (1.800197e-6, -0.718277e-6, 29.261652e-6)


def test_deviations_go_with_their_entries_and_have_no_sign() -> None:
    assert inertia_std_kg_m2(vehicle()) == ((4e-8, 2e-8, 5e-8), (2e-8, 1e-8, 3e-8), (5e-8, 3e-8, 6e-8))


def test_drag_turns_too_and_is_positive_where_it_brakes() -> None:
    straight = vehicle()
    drag = replace(straight.quantities["drag"], value=[-1e-7, -2e-7, -3e-7])
    lame = replace(straight, quantities={**straight.quantities, "drag": drag})

    assert drag_kg_per_rad(lame) == (2e-7, 1e-7, 3e-7)


def test_rotors_stand_around_the_centre_of_mass_not_around_the_middle() -> None:
    straight = vehicle()
    moved = replace(straight, centre=replace(straight.centre, value=[0.002, 0.001, 0.017]))
    side = 0.046 / np.sqrt(2)

    assert rotor_places_m(straight)[0] == pytest.approx((side, -side, 0))
    # The campaign's y points forward and its x to the right, so the centre moved 1 mm forward and 2 mm right.
    assert rotor_places_m(moved)[0] == pytest.approx((side - 0.001, -side + 0.002, 0))
