"""Parameters that can describe a vehicle pass; otherwise the parameter that makes it impossible is named."""

from typing import Any

import pytest

from cfid.estimate.voltage_cubic import cubic_fault
from cfid.export.possible import impossible

THESIS: dict[str, Any] = {
    "mass_kg": 0.028,
    "inertia.matrix_kg_m2": [[16.57e-6, 0.83e-6, 0.72e-6], [0.83e-6, 16.66e-6, 1.8e-6], [0.72e-6, 1.8e-6, 29.26e-6]],
    "motor.thrust_poly": [2.130295e-11, 1.032633e-6, 5.484560e-4],
    "motor.speed_poly": [0.04076521, 380.8359],
    "motor.torque_poly": [0.005964552, 1.563383e-5],
    "motor.max_thrust_n": 0.16,
    "motor.thrust_per_speed_squared_n_s2": 1.9e-8,
    "motor.thrust_speed_poly": [1.9e-8, 0.0, 0.0],
    "motor.thrust_voltage_poly": [-0.0148, 0.0472, -0.0185, 0.00596],
    "dynamics.rising": [7.0, 0.002],
    "dynamics.falling": [3.0, 0.001],
    "tf.time_constant_s": 0.06,
}


def test_the_thesis_vehicle_is_possible() -> None:
    assert impossible(THESIS) == ""


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mass_kg", -0.001),
        ("tf.time_constant_s", 0.0),
        ("motor.max_thrust_n", -0.1),
        ("inertia.matrix_kg_m2", [[16e-6, 0, 0], [0, -1e-6, 0], [0, 0, 16e-6]]),  # not positive
        ("inertia.matrix_kg_m2", [[16e-6, 0, 0], [0, 16e-6, 0], [0, 0, 33e-6]]),  # triangle inequality
        ("motor.thrust_poly", [-2.1e-11, 1.0e-6, 0.0]),  # falls from command 24000 on
        ("motor.speed_poly", [-0.04, 3000.0]),
        ("motor.torque_poly", [-0.006, 0.001]),
        ("motor.thrust_speed_poly", [-1e-8, 2e-5, 0.0]),
        ("motor.thrust_voltage_poly", [0.0, 0.0, 0.02, -0.0035]),  # falls from 3.8 V on
        ("motor.thrust_voltage_poly", [0.0, 0.01, 0.012, 0.002]),  # is flat at -2 V alone: c2^2 > 3 c1 c3
        ("dynamics.rising", [-20.0, 0.002]),
        ("dynamics.falling", [1.0, -0.001]),
    ],
)
def test_each_way_of_being_no_vehicle_is_named(key: str, value: Any) -> None:
    assert impossible({**THESIS, key: value}).startswith(key)


def test_a_map_is_judged_over_the_commands_that_were_measured() -> None:
    falls_early = {**THESIS, "motor.thrust_poly": [2.1e-11, -2e-7, 0.001]}  # falls up to command 4762

    assert impossible(falls_early, commands=(1000, 65535)) == "motor.thrust_poly does not rise"
    assert impossible(falls_early, commands=(6000, 65535)) == ""


def test_a_motor_command_that_only_rounding_lets_fall_is_no_fault_of_the_vehicle() -> None:
    """The cubic is near the firmware's limit, with c2^2 = 0.993 * 3 c1 c3, as are half of the draws about the limit."""
    cubic = [9.1322e-4, 0.0157323, 0.00557237, 0.000662268]

    assert "falls by" in cubic_fault(cubic, max_thrust_n=0.16)
    assert impossible({**THESIS, "motor.thrust_voltage_poly": cubic}) == ""
