"""Values in another unit are recognised, and values that a vehicle can have pass."""

import math

import numpy as np
import pytest

from cfid.published import PublishedSet, published_sets
from cfid.quantities.plausible import centre_fault, implausible


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("mass_kg", 28.0, "28.0 kg: grams?"),
        ("arm_m", 46.0, "46.0 m: millimetres?"),
        ("tf.time_constant_s", 60.0, "60.0 s: milliseconds?"),
        ("motor.max_thrust_n", 150.0, "150.0 N: millinewtons?"),
        ("motor.thrust_per_speed_squared_n_s2", 2e-10, "N/rpm^2?"),
        ("inertia.matrix_kg_m2", [[16.6, 0.8, 0.7], [0.8, 16.7, 1.8], [0.7, 1.8, 29.3]], "16.6 kg m^2: kg mm^2?"),
        ("gravity_mps2", 1.0, "1.0 m/s^2: multiples of g?"),
        ("inertia.matrix_kg_m2", [[-1.6e-5, 0, 0], [0, 1.6e-5, 0], [0, 0, 2.9e-5]], "-1.6e-05 kg m^2."),
        ("motor.thrust_poly", [2.1e-8, 1e-3, 0.6], "at 65535 cmd, 156.3 N: millinewtons?"),
        ("motor.speed_poly", [0.3893, 3636.7], "at 65535 cmd, 2.91e+04 rad/s: rpm?"),
        ("motor.torque_poly", [5.96, 0.0156], "in its slope, 6.0 m: millimetres?"),
        ("motor.thrust_voltage_poly", [0.0, 1.0, 2.0, 0.0], "at 3 V, 21.0 N"),
        ("drag.simple_kg_per_rad", [-9e-7, 9e-7, -1e-6], "9e-07 kg/rad. Expected -0.0001 to 1e-07 kg/rad."),
        ("inertia.axis_kg_m2.roll", 16.6, "16.6 kg m^2: kg mm^2?"),
    ],
)
def test_a_value_of_another_unit_is_refused_with_a_guess(key: str, value: object, told: str) -> None:
    assert told in implausible(key, value)
    assert implausible(key, value).startswith(f"{key} is implausible")


@pytest.mark.parametrize(
    ("apart_m", "long_m", "inertia_kg_m2"), [(0.092, 1.0, 3.2e-5), (0.065, 0.4, 3.7e-5), (0.04, 1.5, 3e-5)]
)
def test_a_vehicle_may_hang_on_long_threads_that_are_close(apart_m: float, long_m: float, inertia_kg_m2: float) -> None:
    frequency = 0.028 * 9.81 * apart_m**2 / (4 * long_m * inertia_kg_m2)

    assert frequency < 20
    assert implausible("swing.natural_frequency_squared_s2", frequency) == ""
    assert implausible("swing.natural_frequency_squared_s2", 1e-4 * frequency) != ""


def test_vehicles_that_are_flown_pass() -> None:
    flown = {
        "mass_kg": (0.027, 0.028, 0.0393, 0.8),
        "arm_m": (0.046, 0.05, 0.17),
        "rotor_radius_m": (0.0231, 0.0275),
        "rotor_inertia_kg_m2": (3e-8, 1.1e-8),
        "motor.max_thrust_n": (0.15, 0.2, 5.0),
        "motor.thrust_per_speed_squared_n_s2": (1.9e-8, 2.9e-8, 1.4e-6),
        "tf.time_constant_s": (0.065, 0.02),
        "gravity_mps2": (9.764, 9.81, 9.834),
        "motor.thrust_poly": ([2.130295e-11, 1.032633e-6, 5.484560e-4],),
        "motor.speed_poly": ([0.04076521, 380.8359],),
        "motor.torque_poly": ([0.005964552, 1.563383e-5],),
        "drag.simple_kg_per_rad": ([-9.1785e-7, -9.1785e-7, -10.311e-7],),
        "inertia.matrix_kg_m2": (
            [[16.6e-6, 0, 0], [0, 16.7e-6, 0], [0, 0, 29.3e-6]],
            [[3e-3, 0, 0], [0, 3e-3, 0], [0, 0, 5e-3]],
        ),
    }
    assert [implausible(key, value) for key, values in flown.items() for value in values] == [""] * 28


@pytest.mark.parametrize(
    "matrix",
    [
        [[16.6e-6, 0, 0], [0, 16.7e-6, 0], [0, 0, 33.4e-6]],
        [[16.6e-6, 15e-6, 0], [15e-6, 16.7e-6, 0], [0, 0, 29.3e-6]],
        [[16.6e-6, 1e-6, 0], [2e-6, 16.7e-6, 0], [0, 0, 29.3e-6]],
    ],
    ids=["flat beyond a plate", "large xy", "not symmetric"],
)
def test_an_inertia_matrix_that_no_body_has_is_refused(matrix: list[list[float]]) -> None:
    assert implausible("inertia.matrix_kg_m2", matrix).startswith("inertia.matrix_kg_m2 is not that of a body")


def test_a_centre_of_mass_beyond_the_rotors_is_refused() -> None:
    assert centre_fault([0.032, -0.032, 0.1], 0.046) == ""
    assert "x = 70.0 mm and y = 0.0 mm: beyond the rotors. Expected within 32.5 mm" in centre_fault([0.07, 0, 0], 0.046)
    assert "x = 0.0 mm and y = -70.0 mm: beyond the rotors" in centre_fault([0, -0.07, 0], 0.046)


MOMENTS = np.diag([16.6e-6, 16.7e-6, 29.3e-6])  # moments of a vehicle of 28 g


def product_is_refused(matrix: np.ndarray) -> bool:
    return "geometric mean of the moments" in implausible("inertia.matrix_kg_m2", matrix.tolist())


@pytest.mark.parametrize("published", published_sets().values(), ids=lambda published: published.name)
def test_the_products_of_published_vehicles_are_half_of_what_is_allowed(published: PublishedSet) -> None:
    for value in (value for value in published.values if value.key == "inertia.matrix_kg_m2"):
        matrix = np.array(value.value)
        doubled = 1.8 * matrix - 0.8 * np.diag(np.diag(matrix))

        assert not product_is_refused(doubled)


@pytest.mark.parametrize(("degrees", "refused"), [(12, False), (15, False), (17, True), (30, True)])
def test_axes_may_be_tilted_by_sixteen_degrees(degrees: float, refused: bool) -> None:
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    turn = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])

    assert product_is_refused(turn @ MOMENTS @ turn.T) == refused
