"""Every target has its numbers in its own units, and all targets give the same physics."""

import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cfid.export.hover import hover_command
from tests.export import thesis_vehicle as thesis
from tests.export.reading import attributes, export, python, toml, xml, yaml
from tests.export.thesis_vehicle import vehicle, with_value

RPM = 2 * math.pi / 60
SHARE_N = thesis.MASS_KG * 9.81 / 4
HOVER_RPM = thesis.HOVER_SPEED_RAD_S / RPM
MOMENT_NM = thesis.TORQUE_POLY[0] * SHARE_N  # without the constant, which cancels between rotors


def test_the_hover_command_is_where_the_map_carries_the_weight() -> None:
    assert hover_command(vehicle()) == pytest.approx(thesis.HOVER_COMMAND, rel=1e-9)


def test_the_firmwares_header_compiles_over_its_defaults(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    (tmp_path / "measured.h").write_text(export("firmware", vehicle()))
    (tmp_path / "try.c").write_text(
        "#include <stdio.h>\n#define CF_MASS 0.029f\n#define THRUST2TORQUE 1.0f\n"
        '#include "measured.h"\n#include "measured.h"\n'
        'int main(void) { printf("%.8g %.8g %.8g %.8g %.8g %.8g\\n", CF_MASS, ARM_LENGTH, THRUST2TORQUE,\n'
        "  VMOTOR2THRUST0 + VMOTOR2THRUST1 * 3 + VMOTOR2THRUST2 * 9 + VMOTOR2THRUST3 * 27, DRAG_B_X, THRUST_MAX); }\n"
    )
    command = ["cc", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o", str(tmp_path / "try"), str(tmp_path / "try.c")]
    subprocess.run(command, check=True, capture_output=True, text=True)
    found = subprocess.run([tmp_path / "try"], check=True, capture_output=True, text=True).stdout

    drag_1_s = 9.1785e-7 * 4 * thesis.HOVER_SPEED_RAD_S / thesis.MASS_KG
    cubic_3v = -0.01 + 0.04 * 3 - 0.02 * 9 + 0.006 * 27
    expected = (0.028, 0.046, 0.005964552, cubic_3v, drag_1_s, thesis.MAX_THRUST_N)
    assert [float(word) for word in found.split()] == pytest.approx(expected, rel=1e-6)


def test_crazyflow_has_thrust_torque_and_lag_per_rpm_and_drag_per_velocity() -> None:
    found = toml("crazyflow", vehicle())["cf2x_L250"]

    def at_hover(poly: list[float]) -> float:
        return sum(c * HOVER_RPM**power for power, c in enumerate(poly))

    assert at_hover(found["rpm2thrust"]) == pytest.approx(SHARE_N)
    assert at_hover(found["rpm2torque"]) == pytest.approx(MOMENT_NM)
    up, up_squared, down, down_squared = found["rotor_dyn_coef"]
    assert (up, down) == (7.0, 3.0)
    step = 10.0  # rad/s; both forms give the same acceleration
    rad_s = thesis.RISING[0] * step + thesis.RISING[1] * (
        (thesis.HOVER_SPEED_RAD_S + step) ** 2 - thesis.HOVER_SPEED_RAD_S**2
    )
    rpm = up * step / RPM + up_squared * ((HOVER_RPM + step / RPM) ** 2 - HOVER_RPM**2)
    assert rpm * RPM == pytest.approx(rad_s)
    assert down_squared == pytest.approx(thesis.FALLING[1] * RPM)
    assert found["drag_matrix"][2][2] == pytest.approx(-10.311e-7 * 4 * thesis.HOVER_SPEED_RAD_S)
    assert found["thrust_min"] == 0.001
    assert found["thrust_max"] == pytest.approx(thesis.MAX_THRUST_N)


def test_crazyflow_keeps_the_quadratics_value_and_slope_at_hovering_and_lifts_nothing_at_rest() -> None:
    poly = [1.8e-8, 2e-6, -3e-4]
    curved = thesis.with_value(vehicle(), "thrust_of_speed", poly)
    constant, linear, quadratic = toml("crazyflow", curved)["cf2x_L250"]["rpm2thrust"]

    speed = thesis.HOVER_SPEED_RAD_S
    assert constant == 0
    assert linear >= 0
    expected = poly[0] * speed**2 + poly[1] * speed + poly[2]
    assert linear * HOVER_RPM + quadratic * HOVER_RPM**2 == pytest.approx(expected)
    assert (linear + 2 * quadratic * HOVER_RPM) / RPM == pytest.approx(2 * poly[0] * speed + poly[1])


@pytest.mark.parametrize("poly", [[2.5e-8, -8e-6, -3e-4], [1e-9, 1e-5, 0.05]])
def test_crazyflow_takes_k_where_the_quadratic_would_pull_down_or_bend_down(poly: list[float]) -> None:
    odd = thesis.with_value(vehicle(), "thrust_of_speed", poly)
    constant, linear, quadratic = toml("crazyflow", odd)["cf2x_L250"]["rpm2thrust"]

    assert (constant, linear) == (0, 0)
    assert quadratic * HOVER_RPM**2 == pytest.approx(SHARE_N)


def test_crazyflows_rotors_stand_around_the_centre_of_mass() -> None:
    known = vehicle()
    moved = replace(known, centre=replace(known.centre, value=[0.002, 0.001, 0.017]))  # 1 mm forward, 2 mm to the right
    found = toml("crazyflow", moved)["cf2x_L250"]

    roll, pitch = (found["L"] * np.array(found["mixing_matrix"][i]) for i in (0, 1))
    side = 0.046 / math.sqrt(2)
    np.testing.assert_allclose(roll, [-side + 0.002, -side + 0.002, side + 0.002, side + 0.002])
    np.testing.assert_allclose(pitch, [0.001 - side, 0.001 + side, 0.001 + side, 0.001 - side])


def test_the_gyms_constants_are_per_rpm_of_one_motor() -> None:
    found = attributes(xml("gym-pybullet-drones", vehicle()).find("properties"))

    assert found["kf"] * HOVER_RPM**2 == pytest.approx(SHARE_N)
    assert found["km"] * HOVER_RPM**2 == pytest.approx(MOMENT_NM)
    assert found["arm"] == 0.046
    assert found["thrust2weight"] == pytest.approx(4 * thesis.MAX_THRUST_N / (0.028 * 9.81))


def test_the_gyms_sideways_drag_is_the_mean_of_forward_and_left() -> None:
    known = with_value(vehicle(), "drag", [-1e-7, -2e-7, -4e-7])
    found = attributes(xml("gym-pybullet-drones", known).find("properties"))

    assert (found["drag_coeff_xy"], found["drag_coeff_z"]) == pytest.approx((1.5e-7, 4e-7))


def test_safe_control_gym_comes_from_command_to_rpm_by_a_straight_line() -> None:
    found = attributes(xml("safe-control-gym", vehicle()).find("properties"))

    command = 40000
    speed = thesis.SPEED_POLY[0] * command + thesis.SPEED_POLY[1]
    assert (found["pwm2rpm_scale"] * command + found["pwm2rpm_const"]) * RPM == pytest.approx(speed)


def test_rotorpy_has_speeds_in_rad_s_and_constants_of_one_rotor(tmp_path: Path) -> None:
    found = python("rotorpy", vehicle(), tmp_path)

    assert found["k_eta"] * thesis.HOVER_SPEED_RAD_S**2 == pytest.approx(SHARE_N)
    assert found["k_m"] * thesis.HOVER_SPEED_RAD_S**2 == pytest.approx(MOMENT_NM)
    assert found["rotor_speed_max"] == pytest.approx(thesis.SPEED_POLY[0] * 65535 + thesis.SPEED_POLY[1])
    assert found["k_d"] == pytest.approx(9.1785e-7)


def test_lags_are_those_of_the_rotor_model_around_hovering(tmp_path: Path) -> None:
    gazebo = xml("gazebo", vehicle())
    up, down = (1 / (a + 2 * b * thesis.HOVER_SPEED_RAD_S) for a, b in (thesis.RISING, thesis.FALLING))

    assert [float(e.text or "") for e in gazebo.iter("timeConstantUp")] == pytest.approx([up] * 4)
    assert [float(e.text or "") for e in gazebo.iter("timeConstantDown")] == pytest.approx([down] * 4)
    assert python("rotorpy", vehicle(), tmp_path)["tau_m"] == pytest.approx((up + down) / 2)


def test_without_steps_the_lag_is_that_of_the_transfer_function(tmp_path: Path) -> None:
    assert python("rotorpy", vehicle("dynamics.rising"), tmp_path)["tau_m"] == pytest.approx(thesis.TIME_CONSTANT_S)
    coefficients = toml("crazyflow", vehicle("dynamics.falling"))["cf2x_L250"]["rotor_dyn_coef"]
    assert coefficients == pytest.approx([1 / thesis.TIME_CONSTANT_S, 0, 1 / thesis.TIME_CONSTANT_S, 0])


def test_gazebo_has_newtons_per_rad_s_squared_and_metres() -> None:
    gazebo = xml("gazebo", vehicle())

    assert [float(e.text or "") * thesis.HOVER_SPEED_RAD_S**2 for e in gazebo.iter("motorConstant")] == pytest.approx(
        [SHARE_N] * 4
    )
    assert [float(e.text or "") for e in gazebo.iter("rotorDragCoefficient")] == pytest.approx([9.1785e-7] * 4)
    assert [e.text for e in gazebo.iter("turningDirection")] == ["ccw", "cw", "ccw", "cw"]


def test_omnidrones_has_newtons_and_newton_metres_per_rad_s_squared() -> None:
    rotors = yaml("omnidrones", vehicle())["rotor_configuration"]

    assert rotors["force_constants"][0] * thesis.HOVER_SPEED_RAD_S**2 == pytest.approx(SHARE_N)
    assert rotors["moment_constants"][0] * thesis.HOVER_SPEED_RAD_S**2 == pytest.approx(MOMENT_NM)
    assert rotors["arm_lengths"] == pytest.approx([0.046] * 4)


def test_yaml_numbers_are_numbers() -> None:
    found = yaml("omnidrones", vehicle())

    assert all(isinstance(value, float) for value in found["inertia"].values())


def test_system_id_has_lowest_powers_first_and_rpm() -> None:
    found = toml("system-id", vehicle())

    assert found["vmotor2thrust"] == thesis.VOLTAGE_POLY
    assert found["rpm2thrust"][2] * HOVER_RPM**2 == pytest.approx(SHARE_N)
    assert found["thrust2torque"] == thesis.TORQUE_POLY[0]
    assert found["rpm_coef"] == pytest.approx([7.0, 0.002 * RPM, 3.0, 0.001 * RPM])
    assert found["thrust_coef"] == pytest.approx(1 / thesis.TIME_CONSTANT_S)


def test_a_curved_torque_is_taken_by_its_tangent_where_it_hovers() -> None:
    curved = thesis.with_value(vehicle(), "torque_of_thrust", [0.01, 0.005, 1e-5])

    assert toml("system-id", curved)["thrust2torque"] == pytest.approx(2 * 0.01 * SHARE_N + 0.005)


def test_crazyflows_rotors_have_neither_thrust_nor_torque_at_rest() -> None:
    drone = toml("crazyflow", vehicle())["cf2x_L250"]

    assert drone["rpm2thrust"][0] == drone["rpm2torque"][0] == 0.0


def test_system_id_and_the_header_have_one_least_thrust_where_the_cubic_begins_above_idle() -> None:
    """At 0 V the map gives 0.02 N, more than 7000/65535 of the largest thrust."""
    lifted = with_value(with_value(vehicle(), "thrust_of_voltage", [0.02, 0.02, 0.001, 0.001]), "max_thrust", 0.16)
    found = toml("system-id", lifted)

    assert found["THRUST_MIN"] == pytest.approx(0.02)
    assert found["VMOTOR_MIN"] == pytest.approx(0.0, abs=1e-8)
    assert "#define THRUST_MIN 0.02f" in export("firmware", lifted)
