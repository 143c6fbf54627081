"""Every target has its numbers in its own units and axes; all targets give the same physics."""

import json
import math
import shutil
import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from cfid.export.derived import Derived
from cfid.export.vehicle import ExportVehicle, collect
from cfid.records.covariances import Covariance
from cfid.records.parameters import Parameter
from cfid.records.rig_file import BodyFrame, thesis_rig
from tests.export import thesis_vehicle as thesis
from tests.export.reading import attributes, drone, export, macros, python, toml, xml, yaml
from tests.export.thesis_vehicle import INERTIA_KG_M2, flown_sections, sections, vehicle, with_value
from tests.lab import values_of

RPM = 2 * math.pi / 60
SHARE_N = thesis.MASS_KG * 9.81 / 4
HOVER_RAD_S, HOVER_RPM = thesis.HOVER_SPEED_RAD_S, thesis.HOVER_SPEED_RAD_S / RPM
MOMENT_M = thesis.TORQUE_POLY[0]  # without the constant, which cancels between rotors
MOMENT_NM = MOMENT_M * SHARE_N
FULL_RAD_S = thesis.SPEED_POLY[0] * 65535 + thesis.SPEED_POLY[1]
LAGS_S = [1 / (a + 2 * b * HOVER_RAD_S) for a, b in (thesis.RISING, thesis.FALLING)]
K = "motor.thrust_per_speed_squared_n_s2"
THESIS_FRAME = {"forward": "x", "left": "y", "up": "z"}  # as those read the thesis who do not turn it
# The thesis' matrix as others publish it, unturned: crazyflie-simulation's model.sdf; its diagonal also in
# controller_lee.c of firmware 2026.08 and in crazyswarm2's simulator.
COPIED = {
    "xx": 16.571710e-6, "yy": 16.655602e-6, "zz": 29.261652e-6,
    "xy": 0.830806e-6, "xz": 0.718277e-6, "yz": 1.800197e-6,
}  # fmt: skip
TURNED = {
    "xx": COPIED["yy"], "yy": COPIED["xx"], "zz": COPIED["zz"],
    "xy": -COPIED["xy"], "xz": COPIED["yz"], "yz": -COPIED["xz"],
}  # fmt: skip


# Axes


def axis(name: str) -> list[float]:
    return [(-1.0 if name.startswith("-") else 1.0) * (letter == name[-1]) for letter in "xyz"]


def right_handed() -> list[BodyFrame]:
    frames = []
    for forward, left, up in product(("x", "-x", "y", "-y", "z", "-z"), repeat=3):
        try:
            frames.append(BodyFrame.model_validate({"forward": forward, "left": left, "up": up}))
        except ValidationError:
            continue
    return frames


def test_vectors_and_tensors_turn_by_the_matrix_of_the_three_axes() -> None:
    assert len(right_handed()) == 24
    for frame in right_handed():
        rotation = np.array([axis(frame.forward), axis(frame.left), axis(frame.up)])
        turned = Derived(vehicle(frame=frame.model_dump()))
        std = np.array(thesis.INERTIA_STD_KG_M2)
        np.testing.assert_array_equal(turned.inertia_kg_m2, rotation @ np.array(INERTIA_KG_M2) @ rotation.T)
        np.testing.assert_allclose(
            turned.turned_tensor(std.tolist(), signed=False), abs(rotation) @ std @ abs(rotation).T, rtol=1e-15
        )


def test_an_unknown_entry_of_a_tensor_stays_unknown_where_it_turns_to() -> None:
    assert Derived(vehicle()).turned_tensor([[1.0, 2.0, 3.0], [4.0, None, 6.0], [7.0, 8.0, 9.0]])[0][0] is None


@pytest.mark.parametrize(("frame", "entries"), [(THESIS_FRAME, COPIED), (None, TURNED)], ids=["unturned", "turned"])
def test_the_inertia_that_others_copied_is_turned_in_every_file(
    frame: dict[str, str] | None, entries: dict[str, float], tmp_path: Path
) -> None:
    known = vehicle(frame=frame)
    found = macros(export("firmware", known))
    mujoco = [float(n) for n in next(xml("mujoco", known).iter("inertial")).attrib["fullinertia"].split()]
    rotorpy = python("rotorpy", known, tmp_path)
    lee = yaml("crazyswarm2", known)["robot_types"]["Crazyflie_2_0"]["firmware_params"]["ctrlLee"]
    webots = export("webots", known).partition("inertiaMatrix [")[2].partition("]")[0].split()

    assert {name: found[f"CFID_INERTIA_{name.upper()}"] for name in entries} == entries
    assert dict(zip(COPIED, mujoco, strict=True)) == entries
    assert {name: rotorpy[f"I{name}"] for name in entries} == entries
    assert yaml("omnidrones", known)["inertia"] == entries
    assert dict(zip(COPIED, map(float, webots), strict=True)) == entries
    assert [lee["J_x"], lee["J_y"], lee["J_z"]] == [entries["xx"], entries["yy"], entries["zz"]]
    assert drone(known)["J"][0] == [entries["xx"], entries["xy"], entries["xz"]]
    for gym in ("gym-pybullet-drones", "safe-control-gym"):
        moments = attributes(next(xml(gym, known).iter("inertia")))
        assert moments == {f"i{name}": entries[name] if name[0] == name[1] else 0 for name in entries}
        assert f'ixy="{entries["xy"]:.10g}" ixz="{entries["xz"]:.10g}"' in export(gym, known)  # left out


def test_moments_and_drag_of_flights_stand_for_those_that_the_rig_did_not_measure() -> None:
    for frame in right_handed():
        body = thesis_rig().vehicle.model_copy(update={"body_frame": frame})
        known = collect(thesis_rig().model_copy(update={"vehicle": body}), values_of(flown_sections()))
        assert Derived(known).inertia_kg_m2 == np.diag([1.6e-5, 1.7e-5, 2.9e-5]).tolist()
        assert Derived(known).drag_n_s_per_m == pytest.approx([8e-3, 9e-3, 0.0])
    assert known.quantities["inertia.matrix_kg_m2"].origin == known.quantities["rotor_inertia_kg_m2"].origin
    both = collect(thesis_rig(), values_of(sections() | flown_sections()))
    assert [both.quantities[key].value for key in ("inertia.matrix_kg_m2", "drag.simple_kg_per_rad")] == [
        INERTIA_KG_M2,
        thesis.DRAG_KG_PER_RAD,
    ]
    assert both.find("flight.inertia_kg_m2.roll") is not None


def test_json_has_the_uncertainties_of_flights_and_null_where_there_are_none() -> None:
    known = collect(thesis_rig(), values_of(flown_sections()))
    found = json.loads(export("json", known))["quantities"]
    assert found["inertia.matrix_kg_m2"]["in_vehicle_frame"]["std"] == [
        [pytest.approx(1.6e-7), None, None],
        [None, pytest.approx(1.7e-7), None],
        [None, None, pytest.approx(2.9e-7)],
    ]
    assert "products of inertia were not measured" in found["inertia.matrix_kg_m2"]["caveat"]
    assert found["drag.simple_kg_per_rad"]["in_vehicle_frame"]["std"][2] is None
    assert found["flight.moment_per_velocity_ns.pitch"]["value"] == -8e-4


def test_rotors_stand_around_the_centre_of_mass() -> None:
    # The thesis' y points forward and its x to the right: the centre is 1 mm forward and 2 mm to the right.
    moved = with_value(vehicle(), "centre_of_mass_m", [0.002, 0.001, 0.017])
    side = 0.046 / math.sqrt(2)
    x = np.array([side, -side, -side, side]) - 0.001
    y = np.array([-side, -side, side, side]) + 0.002
    motors = Derived(moved).motors
    crazyflow = drone(moved)
    omnidrones = yaml("omnidrones", moved)["rotor_configuration"]
    sites = [e.attrib["pos"].split() for e in xml("mujoco", moved).iter("site") if "pos" in e.attrib]
    airframe = export("px4-airframe", moved)

    np.testing.assert_allclose([motor.place_m for motor in motors], np.column_stack([x, y, 0 * x]))
    assert [motor.yaw_sign for motor in motors] == [-1, 1, -1, 1]
    for name, order in (("gazebo", [0, 1, 2, 3]), ("px4-gazebo", [0, 2, 3, 1])):
        poses = [link.findtext("pose", "").split()[:2] for link in xml(name, moved).iter("link")][1:]
        np.testing.assert_allclose(np.array(poses, dtype=float), np.column_stack([x, y])[order])
    hull = next(e.attrib["pos"].split() for e in xml("mujoco", moved).iter("geom") if "pos" in e.attrib)
    np.testing.assert_allclose(np.array(hull, dtype=float), [-0.001, 0.002, 0])
    np.testing.assert_allclose(crazyflow["L"] * np.array(crazyflow["mixing_matrix"][:2]), [y, -x])
    assert crazyflow["mixing_matrix"][2] == [-1, 1, -1, 1]
    np.testing.assert_allclose(omnidrones["arm_lengths"], np.hypot(x, y)[::-1])
    np.testing.assert_allclose(omnidrones["rotor_angles"], np.arctan2(y, x)[::-1] % (2 * math.pi))
    assert omnidrones["directions"] == [-1, 1, -1, 1]
    np.testing.assert_allclose(np.array(sites, dtype=float)[:, :2], np.column_stack([x, y]))
    for rotor, motor in enumerate((0, 2, 3, 1)):
        assert f"CA_ROTOR{rotor}_PX {x[motor]:.10g}\n" in airframe
        assert f"CA_ROTOR{rotor}_PY {-y[motor]:.10g}\n" in airframe
    assert [line.split()[-1] for line in airframe.splitlines() if "_KM" in line] == [
        "0.005964552", "0.005964552", "-0.005964552", "-0.005964552",
    ]  # fmt: skip


# Units


def test_the_firmwares_header_compiles_over_its_defaults(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    (tmp_path / "measured.h").write_text(export("firmware", vehicle()))
    (tmp_path / "try.c").write_text(
        "#include <stdio.h>\n#define CF_MASS 0.029f\n#define THRUST2TORQUE 1.0f\n"
        "#define THRUST_MAX 0.12f\n#define PID_VEL_THRUST_BASE 36000.0f\n"
        '#include "measured.h"\n#include "measured.h"\n'
        'int main(void) { printf("%.8g %.8g %.8g %.8g %.8g %.8g %.8g %.8g %.8g %.8g\\n",\n'
        "  CF_MASS, ARM_LENGTH, THRUST2TORQUE,\n"
        "  VMOTOR2THRUST0 + VMOTOR2THRUST1 * 3 + VMOTOR2THRUST2 * 9 + VMOTOR2THRUST3 * 27, DRAG_B_X, DRAG_B_Z,\n"
        "  THRUST_MAX, PID_VEL_THRUST_BASE / 65535 * 4 * THRUST_MAX,\n"
        "  CFID_MASS_THRUST * 4 * THRUST_MAX, CFID_GAINS_LEGACY * THRUST_MAX); }\n"
    )
    command = ["cc", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o", str(tmp_path / "try"), str(tmp_path / "try.c")]
    subprocess.run(command, check=True, capture_output=True, text=True)
    printed = subprocess.run([tmp_path / "try"], check=True, capture_output=True, text=True).stdout

    drag_1_s = [drag * 4 * HOVER_RAD_S / thesis.MASS_KG for drag in (9.1785e-7, 10.311e-7)]
    cubic_3v = -0.01 + 0.04 * 3 - 0.02 * 9 + 0.006 * 27
    # The base carries the weight, and commands turn as fast with the largest thrust as with the firmware's own.
    expected = (0.028, 0.046, MOMENT_M, cubic_3v, *drag_1_s, thesis.MAX_THRUST_N, thesis.MASS_KG * 9.81, 65535, 0.12)
    assert [float(word) for word in printed.split()] == pytest.approx(expected, rel=1e-6)


def test_crazyflow_has_rpm_and_drag_per_velocity() -> None:
    flown = drone(vehicle())

    assert np.polyval(flown["rpm2thrust"][::-1], HOVER_RPM) == pytest.approx(SHARE_N)
    assert np.polyval(flown["rpm2torque"][::-1], HOVER_RPM) == pytest.approx(MOMENT_NM)
    assert flown["rpm2thrust"][0] == flown["rpm2torque"][0] == 0.0  # none at rest
    assert flown["rotor_dyn_coef"] == pytest.approx([7.0, 0.002 * RPM, 3.0, 0.001 * RPM])
    drag = -4 * HOVER_RAD_S * np.diag([9.1785e-7, 9.1785e-7, 10.311e-7])
    np.testing.assert_allclose(flown["drag_matrix"], drag)
    assert flown["thrust_max"] == pytest.approx(thesis.MAX_THRUST_N)
    assert flown["thrust_min"] == pytest.approx(macros(export("firmware", vehicle()))["THRUST_MIN"])
    assert flown["L"] == pytest.approx(0.03253, abs=5e-6)  # as crazyflow 0.4.0 publishes it


@pytest.mark.parametrize(
    ("poly", "kept"),
    [([1.8e-8, 2e-6, -3e-4], True), ([2.5e-8, -8e-6, -3e-4], False), ([1e-9, 1e-5, 0.05], False)],
    ids=["as measured", "would pull down", "would bend down"],
)
def test_thrust_over_rpm_keeps_the_measured_value_and_slope_at_hovering_where_it_can(
    poly: list[float], kept: bool
) -> None:
    _, linear, square = drone(with_value(vehicle(), "motor.thrust_speed_poly", poly))["rpm2thrust"]

    if kept:
        assert linear * HOVER_RPM + square * HOVER_RPM**2 == pytest.approx(np.polyval(poly, HOVER_RAD_S))
        assert (linear + 2 * square * HOVER_RPM) / RPM == pytest.approx(2 * poly[0] * HOVER_RAD_S + poly[1])
    else:
        assert (linear, square * HOVER_RPM**2) == (0, pytest.approx(SHARE_N))


def test_the_gyms_constants_are_per_rpm_of_one_motor() -> None:
    known = with_value(vehicle(), "drag.simple_kg_per_rad", [-1e-7, -2e-7, -4e-7])
    simple = attributes(xml("gym-pybullet-drones", known).find("properties"))
    commanded = attributes(xml("safe-control-gym", known).find("properties"))

    assert simple["kf"] * HOVER_RPM**2 == pytest.approx(SHARE_N)
    assert simple["km"] * HOVER_RPM**2 == pytest.approx(MOMENT_NM)
    assert simple["arm"] == 0.046
    assert simple["thrust2weight"] == pytest.approx(4 * thesis.MAX_THRUST_N / (0.028 * 9.81))
    assert (simple["drag_coeff_xy"], simple["drag_coeff_z"]) == pytest.approx((1.5e-7, 4e-7))  # mean across
    assert simple["prop_radius"] == 0.0231348
    speed = thesis.SPEED_POLY[0] * 40000 + thesis.SPEED_POLY[1]
    assert (commanded["pwm2rpm_scale"] * 40000 + commanded["pwm2rpm_const"]) * RPM == pytest.approx(speed)
    assert simple.items() <= commanded.items()


def test_rotorpy_has_speeds_in_rad_s_and_constants_of_one_rotor(tmp_path: Path) -> None:
    quad = python("rotorpy", vehicle(), tmp_path)
    crossed = python("rotorpy", vehicle("drag.simple_kg_per_rad"), tmp_path)

    assert quad["k_eta"] * HOVER_RAD_S**2 == pytest.approx(SHARE_N)
    assert quad["k_m"] * HOVER_RAD_S**2 == pytest.approx(MOMENT_NM)
    assert quad["rotor_speed_max"] == pytest.approx(FULL_RAD_S)
    assert quad["tau_m"] == pytest.approx(sum(LAGS_S) / 2)
    assert (quad["k_d"], quad["k_z"]) == pytest.approx((9.1785e-7, 10.311e-7))
    # rotorpy 3.0.0, crazyflie_params.py, from the thesis' cross-coupling model
    assert (crossed["k_d"], crossed["k_z"]) == pytest.approx((10.2506e-7, 7.553e-7), rel=1e-12)


def test_rotorpys_flapping_moment_is_the_mean_of_those_about_roll_and_pitch(tmp_path: Path) -> None:
    quad = python("rotorpy", collect(thesis_rig(), values_of(flown_sections())), tmp_path)

    # Its moment is (-vy, vx, 0) k_flap times a rotor's speed.
    assert -4 * HOVER_RAD_S * quad["k_flap"] == pytest.approx((6e-4 + 8e-4) / 2)
    assert python("rotorpy", vehicle(), tmp_path)["k_flap"] == 0


def test_the_inertia_of_rotors_that_flights_show_is_in_crazyflow_and_gazebo() -> None:
    known = collect(thesis_rig(), values_of(flown_sections()))

    assert drone(known)["prop_inertia"] == 3e-8
    for name in ("gazebo", "px4-gazebo"):
        along = [float(link.findtext("inertial/inertia/izz", "nan")) for link in xml(name, known).iter("link")]
        assert along[1:] == pytest.approx([10 * 3e-8] * 4)  # joints turn 10 times slower


@pytest.mark.parametrize("name", ["gazebo", "px4-gazebo"])
def test_sdf_has_newtons_per_rad_s_squared_and_metres(name: str) -> None:
    known = with_value(vehicle(), "drag.simple_kg_per_rad", [-1e-7, -2e-7, -4e-7])
    plugins = [e for e in xml(name, known).iter("plugin") if e.find("motorNumber") is not None]
    expected = {
        "motorConstant": SHARE_N / HOVER_RAD_S**2, "momentConstant": MOMENT_M, "rotorDragCoefficient": 1.5e-7,
        "timeConstantUp": LAGS_S[0], "timeConstantDown": LAGS_S[1], "maxRotVelocity": FULL_RAD_S,
    }  # fmt: skip

    for plugin in plugins:
        assert {key: float(plugin.findtext(key, "nan")) for key in expected} == pytest.approx(expected)
    turning = ["ccw", "cw", "ccw", "cw"] if name == "gazebo" else ["ccw", "ccw", "cw", "cw"]
    assert [plugin.findtext("turningDirection") for plugin in plugins] == turning


def test_sdfs_rotors_are_taken_out_of_the_measured_mass_and_inertia() -> None:
    rotor_kg_m2 = 3e-8
    known = with_value(with_value(vehicle(), "rotor_inertia_kg_m2", rotor_kg_m2), "centre_of_mass_m", [1e-3, 2e-3, 0.0])
    mass, total, moment = 0.0, np.zeros((3, 3)), np.zeros(3)
    for link in xml("gazebo", known).iter("link"):
        place = np.zeros(3)
        for pose in (link.find("pose"), link.find("inertial/pose")):
            place += np.zeros(3) if pose is None else [float(word) for word in (pose.text or "").split()[:3]]
        own_kg = float(link.findtext("inertial/mass", "nan"))
        entry = {name: float(link.findtext(f"inertial/inertia/i{name}", "nan")) for name in COPIED}
        own = np.array([[entry["".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])
        mass, moment = mass + own_kg, moment + own_kg * place
        total += own + own_kg * (place @ place * np.eye(3) - np.outer(place, place))
        if "prop" in link.attrib["name"]:
            assert (own_kg, entry["zz"]) == pytest.approx((2.8e-4, 10 * rotor_kg_m2))  # joints turn 10 times slower

    assert mass == pytest.approx(thesis.MASS_KG)
    np.testing.assert_allclose(moment, 0, atol=1e-12)
    np.testing.assert_allclose(total, Derived(known).inertia_kg_m2, rtol=1e-6)


def test_webots_thrust_has_the_sign_of_the_speed() -> None:
    words = export("webots", vehicle()).split()
    names = ("thrustConstants", "torqueConstants", "maxVelocity")
    of = {name: [float(words[i + 1]) for i, word in enumerate(words) if word == name] for name in names}
    k = SHARE_N / HOVER_RAD_S**2

    assert of["thrustConstants"] == pytest.approx([k, -k, k, -k])
    assert of["torqueConstants"] == pytest.approx([MOMENT_M * k] * 4)
    assert of["maxVelocity"] == pytest.approx([FULL_RAD_S] * 4)


def test_omnidrones_and_mujoco_and_px4_hover_alike() -> None:
    rotors = yaml("omnidrones", vehicle())["rotor_configuration"]
    generals = list(xml("mujoco", vehicle()).iter("general"))
    motors, drag = generals[:4], [float(e.attrib["biasprm"].split()[-1]) for e in generals[4:]]
    airframe = dict(line.split()[-2:] for line in export("px4-airframe", vehicle()).splitlines() if "param set" in line)

    assert np.multiply(rotors["force_constants"], HOVER_RAD_S**2) == pytest.approx([SHARE_N] * 4)
    assert np.multiply(rotors["moment_constants"], HOVER_RAD_S**2) == pytest.approx([MOMENT_NM] * 4)
    assert rotors["max_rotation_velocities"] == pytest.approx([FULL_RAD_S] * 4)
    assert [float(e.attrib["gear"].split()[-1]) for e in motors] == [-MOMENT_M, MOMENT_M, -MOMENT_M, MOMENT_M]
    assert [float(e.attrib["dynprm"]) for e in motors] == pytest.approx([sum(LAGS_S) / 2] * 4)
    assert drag == pytest.approx(-4 * HOVER_RAD_S * np.array([9.1785e-7, 9.1785e-7, 10.311e-7]))
    assert float(airframe["MPC_THR_HOVER"]) == pytest.approx((HOVER_RAD_S / FULL_RAD_S) ** 2)
    assert airframe["SIM_GZ_EC_MAX4"] == str(math.floor(FULL_RAD_S))


def test_system_id_has_lowest_powers_first_and_rpm() -> None:
    found = toml("system-id", vehicle())
    curved = toml("system-id", with_value(vehicle(), "motor.torque_poly", [0.01, 0.005, 1e-5]))

    assert found["vmotor2thrust"] == thesis.VOLTAGE_POLY
    assert found["rpm2thrust"][2] * HOVER_RPM**2 == pytest.approx(SHARE_N)
    assert found["thrust2torque"] == MOMENT_M
    assert found["rpm_coef"] == pytest.approx([7.0, 0.002 * RPM, 3.0, 0.001 * RPM])
    assert found["rpm_coef_simple"] == pytest.approx(2 / sum(LAGS_S))
    assert found["thrust_coef"] == pytest.approx(1 / thesis.TIME_CONSTANT_S)
    for end in ("MIN", "MAX"):
        thrust = np.polyval(thesis.VOLTAGE_POLY[::-1], found[f"VMOTOR_{end}"])
        assert thrust == pytest.approx(found[f"THRUST_{end}"], rel=1e-9)
    volts = np.roots([*thesis.VOLTAGE_POLY[:0:-1], thesis.VOLTAGE_POLY[0] - SHARE_N])
    hovering_v = float(volts[np.isreal(volts)].real.max())
    assert np.polyval(found["vmotor2rpm"][::-1], hovering_v) == pytest.approx(HOVER_RPM)
    assert np.polyval(found["vmotor2torque"][::-1], hovering_v) == pytest.approx(
        np.polyval(thesis.TORQUE_POLY, SHARE_N)
    )
    assert curved["thrust2torque"] == pytest.approx(2 * 0.01 * SHARE_N + 0.005)  # the tangent where it hovers


def test_system_id_and_the_header_have_one_least_thrust() -> None:
    """At 0 V the second map gives 0.02 N, more than 7000/65535 of the largest thrust."""
    lifted = with_value(
        with_value(vehicle(), "motor.thrust_voltage_poly", [0.02, 0.02, 0.001, 0.001]), "motor.max_thrust_n", 0.16
    )
    for known, least_n in ((vehicle(), 7000 / 65535 * thesis.MAX_THRUST_N), (lifted, 0.02)):
        assert toml("system-id", known)["THRUST_MIN"] == pytest.approx(least_n)
        assert macros(export("firmware", known))["THRUST_MIN"] == pytest.approx(least_n)


def test_without_a_rotor_model_the_lag_is_that_of_the_transfer_function(tmp_path: Path) -> None:
    lag_s = thesis.TIME_CONSTANT_S
    assert python("rotorpy", vehicle("dynamics.rising"), tmp_path)["tau_m"] == pytest.approx(lag_s)
    coefficients = drone(vehicle("dynamics.falling"))["rotor_dyn_coef"]
    assert coefficients == pytest.approx([1 / lag_s, 0, 1 / lag_s, 0])


def test_what_was_not_measured_is_left_out_or_zero(tmp_path: Path) -> None:
    none = vehicle("drag.simple_kg_per_rad", "drag.cross_coupling_kg_per_rad")

    # Gazebo has a drag of its own if the file has none; RotorPy's controllers and the gyms' parsers fail without it.
    assert python("rotorpy", none, tmp_path)["k_d"] == 0
    assert attributes(xml("gym-pybullet-drones", none).find("properties"))["drag_coeff_xy"] == 0
    assert {e.text for e in xml("gazebo", none).iter("rotorDragCoefficient")} == {"0.0"}
    rotor = next(link for link in xml("gazebo", none).iter("link") if link.attrib["name"] == "crazyflie/m1_prop")
    assert rotor.findtext("visual/geometry/cylinder/radius") == "0.0231"  # a Crazyflie's propeller, as a disc
    assert float(rotor.findtext("inertial/inertia/izz", "nan")) == pytest.approx(2.8e-4 * 0.0231**2 / 2)
    assert drone(none)["drag_matrix"] == [[0.0] * 3] * 3
    assert len(list(xml("mujoco", none).iter("general"))) == 4
    assert "DRAG_B_X" not in macros(export("firmware", none))
    assert macros(export("firmware", collect(thesis_rig(), values_of({})))) == {"CF_MASS": 0.028, "ARM_LENGTH": 0.046}


# Isaac Lab draws between two numbers


def isaac_range(name: str, known: ExportVehicle) -> list[float]:
    return [float(bound) for bound in export("isaac-lab", known).partition(f"{name}=(")[2].partition(")")[0].split(",")]


def test_ranges_are_expanded_uncertainties_of_what_may_covary() -> None:
    std = 0.01 * thesis.K_N_S2
    found, slope = sections(), 2 * HOVER_RAD_S
    thrust = {**found["thrust"].parameters, K: Parameter(value=thesis.K_N_S2, std=std, unit="N s^2/rad^2")}
    errors = np.array([[0.5, -0.5 / slope, 0.0, 0.0], [0.0, 0.0, 0.3, 0.0]])  # those of rising cancel at hovering
    block = Covariance(("dynamics.rising", "dynamics.falling"), tuple(map(tuple, (errors.T @ errors).tolist())))
    known = collect(
        thesis_rig(),
        values_of(
            found
            | {
                "thrust": replace(found["thrust"], parameters=thrust),
                "dynamics": replace(found["dynamics"], covariance=(block,)),
            }
        ),
    )

    per_turn = (2 * math.pi) ** 2
    k, rising, falling = (isaac_range(name, known) for name in ("thrust_const_range", "tau_inc_range", "tau_dec_range"))
    assert k == pytest.approx([(thesis.K_N_S2 - 2 * std) * per_turn, (thesis.K_N_S2 + 2 * std) * per_turn])
    assert rising == pytest.approx([LAGS_S[0]] * 2)
    assert falling == pytest.approx([LAGS_S[1] - 0.6 * LAGS_S[1] ** 2, LAGS_S[1] + 0.6 * LAGS_S[1] ** 2])
    lag = Parameter(value=thesis.TIME_CONSTANT_S, std=0.002, unit="s")
    rest = {name: each for name, each in found.items() if name != "dynamics"} | {
        "tf identify": replace(found["tf identify"], parameters={"tf.time_constant_s": lag})
    }
    alone = isaac_range("tau_dec_range", collect(thesis_rig(), values_of(rest)))
    assert alone == pytest.approx([thesis.TIME_CONSTANT_S - 0.004, thesis.TIME_CONSTANT_S + 0.004])
    assert isaac_range("tau_inc_range", vehicle()) == pytest.approx([LAGS_S[0]] * 2)


# JSON


def test_json_has_values_and_uncertainties_in_both_frames() -> None:
    rig = thesis_rig()
    centre = {"centre_of_mass_mm": (1.0, -2.0, 17.4), "centre_of_mass_std_mm": (0.5,) * 3}
    site = rig.site.model_copy(update={"gravity_mps2": 9.812, "gravity_std_mps2": 0.002})
    rig = rig.model_copy(update={"vehicle": rig.vehicle.model_copy(update=centre), "site": site})
    found = json.loads(export("json", collect(rig, values_of(sections()))))
    quantities = found["quantities"]

    assert [quantities["gravity_mps2"][key] for key in ("value", "std")] == [9.812, 0.002]
    np.testing.assert_allclose(quantities["centre_of_mass_m"]["value"], [0.001, -0.002, 0.0174])
    np.testing.assert_allclose(quantities["centre_of_mass_m"]["std"], 5e-4)
    assert [quantities[key]["unit"] for key in ("centre_of_mass_m", "mass_kg", "arm_m")] == ["m", "kg", "m"]
    inertia = quantities["inertia.matrix_kg_m2"]
    assert (inertia["value"], inertia["frame"]) == (INERTIA_KG_M2, "campaign")
    assert inertia["in_vehicle_frame"]["value"][0][1] == -0.830806e-6
    assert inertia["in_vehicle_frame"]["std"] == [[4e-8, 2e-8, 5e-8], [2e-8, 1e-8, 3e-8], [5e-8, 3e-8, 6e-8]]
    assert found["frames"]["campaign_to_vehicle"] == [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    hovering = found["at_hovering"]
    assert hovering["thrust_of_a_motor_n"] == pytest.approx(thesis.MASS_KG * 9.812 / 4)
    assert hovering["moment_per_thrust_m"] == MOMENT_M
    assert hovering["command"] == pytest.approx(thesis.HOVER_COMMAND, rel=1e-3)  # of another gravity
    assert hovering["lags_rising_and_falling_s"] == pytest.approx(LAGS_S, rel=1e-3)


def test_json_has_null_where_hovering_makes_no_sense() -> None:
    away = json.loads(export("json", with_value(vehicle(), "dynamics.rising", [7.0, -0.02])))["at_hovering"]

    assert away["lags_rising_and_falling_s"] is None
    assert away["command"] == pytest.approx(thesis.HOVER_COMMAND, rel=1e-9)


def test_json_has_both_fits_of_a_key_and_unknown_parts() -> None:
    rows = {name: [{"cmd": command, "thrust_n": 0.1}] for name, command in (("thrust", 20000.0), ("torque", 30000.0))}
    known = sections()
    for name, row in rows.items():
        known[name] = replace(known[name], parameters={**known[name].parameters, "motor.table": Parameter(value=row)})
    known["dynamics"] = thesis.section({"dynamics.rising": [7.0, 0.0], "dynamics.falling": [float("nan")] * 2})
    found = json.loads(export("json", collect(thesis_rig(), values_of(known))))

    assert found["quantities"]["motor.table"]["value"] == rows["torque"]
    assert found["further"]["thrust"]["motor.table"]["value"] == rows["thrust"]
    assert found["quantities"]["dynamics.falling"]["value"] == [None, None]
