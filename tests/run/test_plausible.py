"""Values in another unit are recognised, and what a vehicle can have passes."""

import pytest

from cfid.plausible import RANGES, implausible


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("mass_kg", 28.0, "28.0 kg: grams?"),
        ("arm_m", 46.0, "46.0 m: millimetres?"),
        ("arm_m", 4.6, "4.6 m: centimetres?"),
        ("tf.time_constant_s", 60.0, "60.0 s: milliseconds?"),
        ("motor.max_thrust_n", 150.0, "150.0 N: millinewtons?"),
        ("motor.thrust_per_speed_squared_n_s2", 2e-10, "N/rpm^2?"),
        ("inertia.matrix_kg_m2", [[16.6, 0.8, 0.7], [0.8, 16.7, 1.8], [0.7, 1.8, 29.3]], "16.6 kg m^2: kg mm^2?"),
        ("mass_kg", -0.028, "-0.028 kg. Expected 0.005 to 1 kg."),
    ],
)
def test_a_value_of_another_unit_is_refused_with_a_guess(key: str, value: object, told: str) -> None:
    assert told in implausible(key, value)
    assert implausible(key, value).startswith(f"{key} is implausible")


def test_vehicles_that_are_flown_pass() -> None:
    flown = {
        "mass_kg": (0.027, 0.028, 0.0393, 0.8),
        "arm_m": (0.046, 0.05, 0.17),
        "rotor_radius_m": (0.0231, 0.0275),
        "rotor_inertia_kg_m2": (3e-8, 1.1e-8),
        "motor.max_thrust_n": (0.15, 0.2, 5.0),
        "motor.thrust_per_speed_squared_n_s2": (1.9e-8, 2.9e-8, 1.4e-6),
        "tf.time_constant_s": (0.065, 0.02),
        "inertia.matrix_kg_m2": (
            [[16.6e-6, 0, 0], [0, 16.7e-6, 0], [0, 0, 29.3e-6]],
            [[3e-3, 0, 0], [0, 3e-3, 0], [0, 0, 5e-3]],
        ),
    }
    assert set(flown) == set(RANGES)
    assert [implausible(key, value) for key, values in flown.items() for value in values] == [""] * 21


def test_what_has_no_range_passes() -> None:
    assert implausible("weight_m", 1e9) == ""
