"""Targets whose programs are not in the package index: the tests have a reader for each, based on its source code."""

import json
import math
import re
import runpy
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.consumers.conftest import Judge
from tests.consumers.plant import (
    DOWN_S,
    DRAG_1_S,
    HOVER_RAD_S,
    INERTIA,
    MASS_KG,
    MIXES,
    RPM,
    UP_S,
    YAW,
    Array,
    G,
    K,
    Row,
    accelerations,
    pairs,
    speeds,
    written,
)
from tests.export import thesis_vehicle as thesis


def vrml(text: str) -> list[str]:
    """Return the words of a PROTO, without its comments."""
    lines = (re.sub(r"#.*", "", line) for line in text.splitlines())
    return " ".join(lines).replace("[", " [ ").replace("]", " ] ").split()


def after(words: list[str], name: str, count: int) -> list[list[float]]:
    """Return the `count` numbers that follow each field called `name`."""
    kept = [word for word in words if word not in "[]"]
    return [[float(w) for w in kept[i + 1 : i + 1 + count]] for i, word in enumerate(kept) if word == name]


def test_webots_propellers_lift_turn_and_brake_the_vehicle(tmp_path: Path, judge: Judge) -> None:
    # WbPropeller.cpp: thrust t1 |w| w - t2 |w| V, and the vehicle turns against the torque q1 |w| w - q2 |w| V.
    text = written("webots", tmp_path, "Crazyflie.proto").read_text()
    words = vrml(text)
    thrust, torque = np.array(after(words, "thrustConstants", 2)), np.array(after(words, "torqueConstants", 2))
    places = np.array(after(words, "centerOfThrust", 3))
    xx, yy, zz, xy, xz, yz = after(words, "inertiaMatrix", 6)[0]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass = after(words, "mass", 1)[0][0]
    spin = np.array([1, -1, 1, -1])  # the sense of the rotors, and of their commands according to the file

    def lift(rotor_speeds: Array, rise_mps: float = 0.0) -> Array:
        found: Array = thrust[:, 0] * rotor_speeds**2 * spin - thrust[:, 1] * rotor_speeds * rise_mps
        return found

    def turn(rotor_speeds: Array) -> Array:
        moment = np.cross(places, np.outer(lift(rotor_speeds), [0, 0, 1])).sum(axis=0)
        moment[2] -= np.sum(torque[:, 0] * rotor_speeds**2 * spin)
        found: Array = np.linalg.solve(inertia, moment)
        return found

    hovering = np.full(4, HOVER_RAD_S)
    judge(
        Row(
            target="webots",
            version="R2023b's formulas",
            loaded="a reader in the tests",
            hover=(HOVER_RAD_S, math.sqrt(mass * G / lift(np.ones(4)).sum())),
            hover_unit="rad/s",
            turning=pairs(accelerations(), [turn(speeds(axis))[i] for i, axis in enumerate(MIXES)]),
            drag_1_s=[(float(DRAG_1_S[2]), float((lift(hovering) - lift(hovering, 1.0)).sum() / mass))],
        )
    )
    assert text.startswith("#VRML_SIM R2023b utf8\n")
    assert text.count("{") == text.count("}")
    assert text.count("[") == text.count("]")
    assert [word for word in words if word.endswith('_motor"')] == [f'"m{i}_motor"' for i in range(1, 5)]


def test_omnidrones_rotors_lift_and_turn_the_vehicle(tmp_path: Path, judge: Judge) -> None:
    # rotor_group.py: thrust (throttle w_max)^2 k, moment against the direction; lee_position_controller.py: places.
    import yaml

    found = yaml.safe_load(written("omnidrones", tmp_path, "crazyflie.yaml").read_text())
    rotors = {name: np.array(values) for name, values in found["rotor_configuration"].items()}
    angles, arms = rotors["rotor_angles"], rotors["arm_lengths"]
    entries = found["inertia"]
    inertia = np.array([[entries["".join(sorted(a + b))] for b in "xyz"] for a in "xyz"])

    def turn(rotor_speeds: Array) -> Array:
        share = (rotor_speeds / rotors["max_rotation_velocities"]) ** 2
        lift = share * rotors["max_rotation_velocities"] ** 2 * rotors["force_constants"]
        drag = -rotors["directions"] * share * rotors["max_rotation_velocities"] ** 2 * rotors["moment_constants"]
        moment = np.array([np.sum(np.sin(angles) * arms * lift), -np.sum(np.cos(angles) * arms * lift), drag.sum()])
        result: Array = np.linalg.solve(inertia, moment)
        return result

    judge(
        Row(
            target="omnidrones",
            version="rotor_group.py",
            loaded="a reader in the tests",
            hover=(HOVER_RAD_S, math.sqrt(found["mass"] * G / rotors["force_constants"].sum())),
            hover_unit="rad/s",
            turning=pairs(accelerations(), [turn(speeds(axis)[::-1])[i] for i, axis in enumerate(MIXES)]),  # m4 to m1
        )
    )


def test_the_identification_tool_goes_on_from_the_file_in_all_its_modes(tmp_path: Path, judge: Judge) -> None:
    # system_id.py: static_verification takes THRUST_MAX; dynamic takes THRUST_MIN and inverts two polynomials.
    found: dict[str, Any] = tomllib.loads(written("system-id", tmp_path, "parameters_cfid.toml").read_text())
    share = MASS_KG * G / 4
    constant, linear, square = found["rpm2thrust"]
    rpm = (-linear + math.sqrt(linear**2 - 4 * square * (constant - share))) / (2 * square)
    roots = np.roots([*found["vmotor2thrust"][:0:-1], found["vmotor2thrust"][0] - share])
    volt = float(np.max(roots[np.isreal(roots)].real))  # the largest real root, as in system_id.py

    assert found["vmotor2rpm"][0] + found["vmotor2rpm"][1] * volt == pytest.approx(rpm)
    torque = np.polyval(found["vmotor2torque"][::-1], volt)
    assert torque == pytest.approx(np.polyval(thesis.TORQUE_POLY, share))
    assert torque == pytest.approx(np.polyval(found["rpm2torque"][::-1], rpm))
    for name in ("MIN", "MAX"):
        thrust = np.polyval(found["vmotor2thrust"][::-1], found[f"VMOTOR_{name}"])
        assert thrust == pytest.approx(found[f"THRUST_{name}"])
    assert found["THRUST_MAX"] == pytest.approx(thesis.MAX_THRUST_N)
    assert found["THRUST_MIN"] == pytest.approx(7000 / 65535 * thesis.MAX_THRUST_N)
    a, b = found["rpm_coef"][:2]
    c, d = found["rpm_coef"][2:]
    lags = [1 / (a + 2 * b * rpm), 1 / (c + 2 * d * rpm)]
    assert found["rpm_coef_simple"] == pytest.approx(2 / sum(lags))
    judge(
        Row(
            target="system-id",
            version="system_id.py",
            loaded="a reader in the tests",
            hover=(HOVER_RAD_S, rpm * RPM),
            hover_unit="rad/s",
            lag_s=(thesis.TIME_CONSTANT_S, 1 / found["thrust_coef"]),
        )
    )


def test_crazyswarm2_finds_what_its_server_asks_for(tmp_path: Path) -> None:
    # crazyflie_server.py: robots with type, uri and place; firmware_params of all, type and robot.
    import yaml

    found = yaml.safe_load(written("crazyswarm2", tmp_path, "crazyflies.yaml").read_text())
    robot = found["robots"]["cf1"]
    kind = found["robot_types"][robot["type"]]

    assert found["fileversion"] == 3
    assert robot["enabled"]
    assert robot["uri"].startswith("radio://")
    assert len(robot["initial_position"]) == 3
    assert kind["motion_capture"]["tracking"] == "librigidbodytracker"
    assert {"firmware_logging", "firmware_params", "reference_frame", "broadcasts"} <= set(found["all"])
    lee = kind["firmware_params"]["ctrlLee"]
    assert [lee["mass"], lee["J_x"], lee["J_y"], lee["J_z"]] == pytest.approx([MASS_KG, *np.diag(INERTIA)])
    assert kind["firmware_params"]["ctrlMel"]["mass"] == MASS_KG


def test_isaac_labs_thrusters_lift_and_turn_the_vehicle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, judge: Judge
) -> None:
    # multirotor.py: wrench = allocation_matrix @ thrusts in the thrusters' order; thruster.py: T = const rps^2.
    class Config(SimpleNamespace):
        InitialStateCfg = SimpleNamespace

    for name in ("isaaclab_contrib", "isaaclab_contrib.actuators", "isaaclab_contrib.assets"):
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(ThrusterCfg=Config, MultirotorCfg=Config))
    found = runpy.run_path(str(written("isaac-lab", tmp_path, "crazyflie.py")))
    multirotor = found["CRAZYFLIE_CFG"]
    thruster = multirotor.actuators["thrusters"]
    (rps,) = multirotor.init_state.rps.values()
    const = np.mean(thruster.thrust_const_range)

    def wrench(rotor_speeds: Array) -> Array:
        result: Array = np.array(multirotor.allocation_matrix) @ (const * (rotor_speeds / (2 * math.pi)) ** 2)
        return result

    force, turn = wrench(np.full(4, rps * 2 * math.pi))[:3], np.array(found["INERTIA_KG_M2"])
    assert force == pytest.approx([0, 0, MASS_KG * G])
    assert [np.mean(thruster.tau_inc_range), np.mean(thruster.tau_dec_range)] == pytest.approx([UP_S, DOWN_S])
    assert multirotor.rotor_directions == (-YAW).tolist()
    judge(
        Row(
            target="isaac-lab",
            version="thruster.py of 2.3.2",
            loaded="a reader in the tests",
            hover=(HOVER_RAD_S, math.sqrt(found["MASS_KG"] * G / 4 / const) * 2 * math.pi),
            hover_unit="rad/s",
            turning=pairs(
                accelerations(),
                [np.linalg.solve(turn, wrench(speeds(axis))[3:])[i] for i, axis in enumerate(MIXES)],
            ),
        )
    )


def test_l2fs_dynamics_lift_and_turn_the_vehicle(tmp_path: Path, judge: Judge) -> None:
    # 60_dynamics.h: T = c0 + c1 u + c2 u^2 along a rotor's direction, its torque over T, J_inv times the moments.
    found = json.loads(written("l2f", tmp_path, "l2f.json").read_text())["dynamics"]
    arrays = {name: np.array(value) for name, value in found.items() if isinstance(value, list)}
    coefficients = arrays["rotor_thrust_coefficients"]
    at_hover = np.full(4, found["hovering_throttle_relative"])

    def lift(commands: Array) -> Array:
        thrusts = coefficients[:, 0] + coefficients[:, 1] * commands + coefficients[:, 2] * commands**2
        result: Array = thrusts[:, None] * arrays["rotor_thrust_directions"]
        return result

    def turn(thrusts: Array) -> Array:
        torques = arrays["rotor_torque_directions"] * (thrusts[:, 2] * arrays["rotor_torque_constants"])[:, None]
        result: Array = arrays["J_inv"] @ (np.cross(arrays["rotor_positions"], thrusts) + torques).sum(axis=0)
        return result

    share_n = np.tile([0, 0, MASS_KG * G / 4], (4, 1))
    np.testing.assert_allclose(arrays["J"], INERTIA)
    np.testing.assert_allclose(arrays["gravity"], [0, 0, -G])
    judge(
        Row(
            target="l2f",
            version="60_dynamics.h of l2f 2.0.18",
            loaded="a reader in the tests",
            hover=(MASS_KG * G / 4, float(lift(at_hover).sum(axis=0)[2]) / 4),
            hover_unit="N a motor",
            turning=pairs(
                accelerations(),
                [turn(share_n * (speeds(axis)[:, None] / HOVER_RAD_S) ** 2)[i] for i, axis in enumerate(MIXES)],
            ),
            lag_s=(UP_S, found["rotor_time_constants_rising"][2]),
        )
    )


def test_ardupilots_frame_lifts_turns_and_brakes_the_vehicle(tmp_path: Path, judge: Judge) -> None:
    # SIM_Frame.cpp and SIM_Motor.cpp; x forward, y right, z down; motors 1 to 4 of the frame x are m1, m3, m4 and m2.
    text = written("ardupilot", tmp_path, "frame.json").read_text()
    found = json.loads(re.sub("#.*", "", text))  # AP_JSON takes # to the end of a line as a comment
    gravity, order = 9.80665, [0, 2, 3, 1]
    weight_n, tilt = found["mass"] * gravity, math.cos(math.radians(found["refAngle"]))
    places = np.array([found[f"motor{i}_position"] for i in range(1, 5)])
    yaws = np.array([found[f"motor{i}_yaw"] for i in range(1, 5)])

    def thrust(command: float) -> float:
        shape = (1 - found["propExpo"]) * command + found["propExpo"] * command**2
        return float(weight_n / 4 / found["hoverThrOut"] * shape)

    def command(thrust_n: float) -> float:
        e, wanted = found["propExpo"], thrust_n / thrust(1.0)
        return float((e - 1 + math.sqrt((1 - e) ** 2 + 4 * e * wanted)) / (2 * e))

    def turn(rotor_speeds: Array) -> Array:
        thrusts = K * rotor_speeds[order] ** 2
        commands = np.array([command(one) for one in thrusts])
        moment = np.cross(places, np.outer(thrusts, [0, 0, -1])).sum(axis=0)
        moment[2] += np.sum(yaws * commands * 0.05 * found["diagonal_size"] * thrusts)
        result: Array = moment / found["moment_inertia"] * [1, -1, -1]  # back to left and up
        return result

    drag_at_ref_n = weight_n * math.tan(math.radians(found["refAngle"]))
    momentum = tilt**2 * found["refSpd"] * math.sqrt(weight_n / tilt * 1.1 * found["disc_area"])  # over mdrag_coef
    assert found["mdrag_coef"] * momentum > drag_at_ref_n  # so that the program lowers it, and areaCd is zero
    linear = drag_at_ref_n / momentum * math.sqrt(weight_n * 1.1 * found["disc_area"])  # per velocity, in any air
    slower, faster = (turn(HOVER_RAD_S * (1 + part * MIXES["yaw"]))[2] for part in (-0.001, 0.001))
    assert thrust(1.0) == pytest.approx(thesis.MAX_THRUST_N)
    assert (faster - slower) / 0.002 == pytest.approx(
        8 * K * HOVER_RAD_S**2 * thesis.TORQUE_POLY[0] / INERTIA[2, 2], rel=1e-5
    )
    judge(
        Row(
            target="ardupilot",
            version="SIM_Frame.cpp",
            loaded="a reader in the tests",
            hover=(thesis.HOVER_COMMAND, 65535 * command(MASS_KG * G / 4)),
            hover_unit="command",
            turning=pairs(
                accelerations(np.diag(np.diag(INERTIA)))[:2],
                [turn(speeds(axis))[i] for i, axis in enumerate(["roll", "pitch"])],
            ),
            drag_1_s=[(float(DRAG_1_S[0]), linear / MASS_KG)],
        )
    )
