"""Exports of the thesis' numbers, compared with the numbers that other projects took from the thesis and publish.

The published numbers were read in public sources in November 2026. Ours differ only by the rotation that those
projects left out: the thesis' x is the pitch axis, whereas theirs is the roll axis.
"""

from pathlib import Path

import pytest

from cfid.export.vehicle import ExportVehicle
from tests.export.reading import attributes, export, macros, python, toml, xml, yaml
from tests.export.thesis_vehicle import vehicle

# crazyflie-firmware 2026.08, controller_lee.c (.J); crazyswarm2, crazyflie_sim/backend/np.py (J) and its
# dynobench and pinocchio files: all copy the diagonal as the thesis prints it.
COPIED_DIAGONAL = (16.571710e-6, 16.655602e-6, 29.261652e-6)
# crazyflie-simulation, simulator_files/gazebo/crazyflie/model.sdf: copies all six entries.
COPIED_MATRIX = {
    "ixx": 16.571710e-6,
    "iyy": 16.655602e-6,
    "izz": 29.261652e-6,
    "ixy": 0.830806e-6,
    "ixz": 0.718277e-6,
    "iyz": 1.800197e-6,
}
# crazyflie-firmware 2026.08, platform_defaults.h (THRUST2TORQUE); crazyflie-simulation, model.sdf (momentConstant).
COPIED_MOMENT_M = 0.005964552
# gym-pybullet-drones and safe-control-gym, assets/cf2x.urdf.
COPIED_DRAG = {"drag_coeff_xy": 9.1785e-7, "drag_coeff_z": 10.311e-7}
# rotorpy 3.0.0, vehicles/crazyflie_params.py, from the thesis' cross-coupling model.
ROTORPY_DRAG = {"k_d": 10.2506e-7, "k_z": 7.553e-7}


def test_the_lee_controllers_inertia_is_ours_with_roll_and_pitch_exchanged() -> None:
    found = macros(export("firmware", vehicle()))
    ours = tuple(found[f"CFID_INERTIA_{axis}"] for axis in ("XX", "YY", "ZZ"))

    assert ours == (COPIED_DIAGONAL[1], COPIED_DIAGONAL[0], COPIED_DIAGONAL[2])


def test_the_headers_products_of_inertia_bear_the_names_of_their_axes() -> None:
    found = macros(export("firmware", vehicle()))
    unturned = macros(export("firmware", vehicle(frame={"forward": "x", "left": "y", "up": "z"})))

    assert {axis: unturned[f"CFID_INERTIA_{axis[1:].upper()}"] for axis in COPIED_MATRIX} == COPIED_MATRIX
    assert [found[f"CFID_INERTIA_{axis}"] for axis in ("XY", "XZ", "YZ")] == [
        -COPIED_MATRIX["ixy"], COPIED_MATRIX["iyz"], -COPIED_MATRIX["ixz"],
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["gym-pybullet-drones", "safe-control-gym"])
def test_the_gyms_diagonal_is_turned_too(name: str) -> None:
    moments = attributes(next(xml(name, vehicle()).iter("inertia")))

    assert (moments["iyy"], moments["ixx"], moments["izz"]) == COPIED_DIAGONAL
    assert (moments["ixy"], moments["ixz"], moments["iyz"]) == (0, 0, 0)


def test_crazyswarm2_gets_the_same_exchange() -> None:
    lee = yaml("crazyswarm2", vehicle())["robot_types"]["Crazyflie_2_0"]["firmware_params"]["ctrlLee"]

    assert (lee["J_y"], lee["J_x"], lee["J_z"]) == COPIED_DIAGONAL


def entries(known: ExportVehicle) -> dict[str, float]:
    inertial = next(xml("mujoco", known).iter("inertial"))
    numbers = map(float, inertial.attrib["fullinertia"].split())
    return dict(zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), numbers, strict=True))


def test_gazebos_published_inertia_is_ours_before_turning() -> None:
    unturned = {"forward": "x", "left": "y", "up": "z"}
    before, after = entries(vehicle(frame=unturned)), entries(vehicle())

    assert before == COPIED_MATRIX
    assert after == {
        "ixx": COPIED_MATRIX["iyy"],
        "iyy": COPIED_MATRIX["ixx"],
        "izz": COPIED_MATRIX["izz"],
        "ixy": -COPIED_MATRIX["ixy"],
        "ixz": COPIED_MATRIX["iyz"],
        "iyz": -COPIED_MATRIX["ixz"],
    }


def test_the_firmwares_and_gazebos_torque_over_thrust_is_the_slope_of_the_thesis() -> None:
    assert macros(export("firmware", vehicle()))["THRUST2TORQUE"] == COPIED_MOMENT_M
    assert [float(e.text or "") for e in xml("gazebo", vehicle()).iter("momentConstant")] == [COPIED_MOMENT_M] * 4


@pytest.mark.parametrize("target", ["gym-pybullet-drones", "safe-control-gym"])
def test_the_gyms_drag_is_that_of_the_simple_model(target: str) -> None:
    properties = attributes(xml(target, vehicle()).find("properties"))

    assert {name: properties[name] for name in COPIED_DRAG} == pytest.approx(COPIED_DRAG, rel=1e-12)


def test_rotorpys_drag_is_the_diagonal_of_the_cross_coupling_model(tmp_path: Path) -> None:
    crossed = python("rotorpy", vehicle("drag.simple_kg_per_rad"), tmp_path)
    simple = python("rotorpy", vehicle(), tmp_path)

    assert {name: crossed[name] for name in ROTORPY_DRAG} == pytest.approx(ROTORPY_DRAG, rel=1e-12)
    assert (simple["k_d"], simple["k_z"]) == pytest.approx((9.1785e-7, 10.311e-7))


def test_crazyflows_arm_is_the_diagonal_one_over_the_root_of_two() -> None:
    # crazyflow 0.4.0, dynamics/first_principles/params.toml: L = 0.03253 for arms of 46 mm, and the same mixing.
    found = toml("crazyflow", vehicle())["cf2x_L250"]

    assert found["L"] == pytest.approx(0.03253, abs=5e-6)
    assert found["mixing_matrix"] == [[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]]


def test_omnidrones_rotors_stand_and_turn_as_it_publishes_them() -> None:
    # OmniDrones, robots/assets/usd/crazyflie.yaml
    rotors = yaml("omnidrones", vehicle())["rotor_configuration"]

    assert rotors["directions"] == [-1.0, 1.0, -1.0, 1.0]
    assert rotors["rotor_angles"] == pytest.approx([0.78539816, 2.35619449, 3.92699082, 5.49778714])
