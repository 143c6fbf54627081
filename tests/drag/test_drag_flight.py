"""Equations 4.1 to 4.4: from velocity to the accelerometer, and back."""

import math

import numpy as np
import pytest

from cfid.drag.flight import acceleration_mps2, drag_force_n, drag_from_acceleration_n, velocity_from_acceleration_mps
from tests.drag.test_drag_campaigns import EQ_4_8, EQ_4_11, Array

MASS_KG, GRAVITY = 0.028, 9.81


def turned(rng: np.random.Generator, count: int) -> Array:
    """Return random rotations (count, 3, 3)."""
    q, r = np.linalg.qr(rng.standard_normal((count, 3, 3)))
    q = q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, np.newaxis, :]
    return np.asarray(q * np.linalg.det(q)[:, np.newaxis, np.newaxis])


def test_a_vehicle_that_hovers_stays_where_it_is() -> None:
    still = acceleration_mps2(
        rotation=np.eye(3), thrust_n=MASS_KG * GRAVITY, drag_n=np.zeros(3), mass_kg=MASS_KG, gravity_mps2=GRAVITY
    )

    np.testing.assert_allclose(still, 0, atol=1e-12)


def test_drag_brakes_along_each_axis_and_grows_with_the_rotors_speed() -> None:
    drag = drag_force_n(coefficients_kg_per_rad=EQ_4_8, velocity_mps=[2.0, 0.0, -1.0], speed_sum_rad_s=[4000, 8000])

    np.testing.assert_allclose(drag[0], [-9.1785e-7 * 2 * 4000, 0, 10.311e-7 * 4000])
    np.testing.assert_allclose(drag[1], 2 * drag[0])


def test_a_vehicle_that_leans_to_the_right_accelerates_to_the_right() -> None:
    lean = math.radians(10)
    rotation = np.array([[1, 0, 0], [0, math.cos(lean), -math.sin(lean)], [0, math.sin(lean), math.cos(lean)]])
    acceleration = acceleration_mps2(
        rotation=rotation, thrust_n=0.3, drag_n=np.zeros(3), mass_kg=MASS_KG, gravity_mps2=GRAVITY
    )

    np.testing.assert_allclose(
        acceleration, [0, -0.3 / MASS_KG * math.sin(lean), 0.3 / MASS_KG * math.cos(lean) - GRAVITY]
    )


@pytest.mark.parametrize("coefficients", [EQ_4_8, EQ_4_11], ids=["diagonal", "matrix"])
def test_the_velocity_comes_back_from_what_the_accelerometer_feels(coefficients: Array) -> None:
    rng = np.random.default_rng(2)
    velocity, rotation = rng.normal(0, 2, (50, 3)), turned(rng, 50)
    thrust, speed_sum = rng.uniform(0.1, 0.5, 50), rng.uniform(4000, 9000, 50)
    drag = drag_force_n(coefficients_kg_per_rad=coefficients, velocity_mps=velocity, speed_sum_rad_s=speed_sum)
    moved = acceleration_mps2(rotation=rotation, thrust_n=thrust, drag_n=drag, mass_kg=MASS_KG, gravity_mps2=GRAVITY)
    felt = np.einsum("nij,ni->nj", rotation, moved + np.array([0, 0, GRAVITY]))  # R^-1 (x'' - g)

    np.testing.assert_allclose(drag_from_acceleration_n(felt_mps2=felt, thrust_n=thrust, mass_kg=MASS_KG), drag)
    found = velocity_from_acceleration_mps(
        felt_mps2=felt,
        thrust_n=thrust,
        speed_sum_rad_s=speed_sum,
        mass_kg=MASS_KG,
        coefficients_kg_per_rad=coefficients,
    )
    np.testing.assert_allclose(found, velocity, rtol=1e-8, atol=1e-9)
