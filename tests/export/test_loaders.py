"""Other programs load our files with their own loaders and hover: within 5 % of the command that was predicted.

Each test needs its program; those that are not installed with cfid's development tools are skipped with a sentence.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export import thesis_vehicle as thesis
from tests.export.reading import export, python
from tests.export.thesis_vehicle import vehicle

SHARE_N = thesis.MASS_KG * 9.81 / 4
RPM = 2 * math.pi / 60
STEP_S = 0.002
KP, KD, KI = 6.0, 5.0, 2.0  # of height, as accelerations


class Height:
    """A controller of height that knows no parameter of the vehicle but a first guess of its command."""

    def __init__(self, guess: float) -> None:
        self.guess, self.sum = guess, 0.0

    def command(self, height_m: float, speed_mps: float) -> float:
        error = 1.0 - height_m
        self.sum += error * STEP_S
        return self.guess * max(1 + (KP * error - KD * speed_mps + KI * self.sum) / 9.81, 0.0)


def command_of_speed(speed_rad_s: float) -> float:
    """Return the command whose rotor speed is that, by the campaign's own map."""
    return (speed_rad_s - thesis.SPEED_POLY[1]) / thesis.SPEED_POLY[0]


def test_mujoco_loads_the_model_and_hovers_it() -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    model = mujoco.MjModel.from_xml_string(export("mujoco", vehicle()))
    model.opt.timestep = STEP_S
    data = mujoco.MjData(model)
    data.qpos[2] = 0.8
    controller = Height(0.7 * SHARE_N)

    for _ in range(15000):
        data.ctrl[:] = controller.command(data.qpos[2], data.qvel[2])
        mujoco.mj_step(model, data)

    assert data.qpos[2] == pytest.approx(1, abs=0.01)
    assert data.ctrl[0] == pytest.approx(SHARE_N, rel=0.05)
    thrust_to_command = np.roots([*thesis.THRUST_POLY[:2], thesis.THRUST_POLY[2] - data.ctrl[0]]).max()
    assert thrust_to_command == pytest.approx(thesis.HOVER_COMMAND, rel=0.05)


def test_mujocos_inertia_is_the_turned_matrix() -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    model = mujoco.MjModel.from_xml_string(export("mujoco", vehicle()))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, mass, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, mass)

    np.testing.assert_allclose(
        mass[3:, 3:],
        [
            [16.655602e-6, -0.830806e-6, 1.800197e-6],
            [-0.830806e-6, 16.571710e-6, -0.718277e-6],
            [1.800197e-6, -0.718277e-6, 29.261652e-6],
        ],
        atol=1e-12,
    )


def test_mujocos_motors_roll_pitch_and_yaw_as_a_crazyflie() -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    model = mujoco.MjModel.from_xml_string(export("mujoco", vehicle("tf.time_constant_s", "dynamics.rising")))
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.1, 0, 0, 0]  # m1, in front on the right
    mujoco.mj_forward(model, data)
    side = 0.046 / math.sqrt(2)

    # It lifts its corner: rolls to the left (negative about forward), pitches up (negative about left), yaws clockwise.
    np.testing.assert_allclose(data.qfrc_actuator[2:], [0.1, -0.1 * side, -0.1 * side, -0.1 * 0.005964552], rtol=1e-6)


def test_rotorpy_loads_the_dictionary_and_hovers_it(tmp_path: Path) -> None:
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor", reason="rotorpy is not installed")
    drone = multirotor.Multirotor(python("rotorpy", vehicle(), tmp_path))
    guess = 0.9 * thesis.HOVER_SPEED_RAD_S
    state = {
        "x": np.array([0, 0, 0.8]), "v": np.zeros(3), "q": np.array([0, 0, 0, 1]), "w": np.zeros(3),
        "wind": np.zeros(3), "rotor_speeds": np.full(4, guess),
    }  # fmt: skip
    controller = Height(guess**2)

    for _ in range(8000):
        speed = math.sqrt(controller.command(state["x"][2], state["v"][2]))
        state = drone.step(state, {"cmd_motor_speeds": np.full(4, speed)}, STEP_S)

    assert state["x"][2] == pytest.approx(1, abs=0.02)
    assert command_of_speed(speed) == pytest.approx(thesis.HOVER_COMMAND, rel=0.05)


def test_crazyflow_loads_the_section_and_hovers_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    core = pytest.importorskip("crazyflow.dynamics.core", reason="crazyflow is not installed")
    drone = pytest.importorskip("crazyflow.drones").Drone.cf2x_L250
    dynamics = pytest.importorskip("crazyflow.dynamics.first_principles").dynamics

    (tmp_path / "first_principles").mkdir()
    for other in ("so_rpy", "so_rpy_rotor", "so_rpy_rotor_drag"):
        (tmp_path / other).mkdir()
        (tmp_path / other / "params.toml").write_text("")
    (tmp_path / "params.toml").write_text("gravity_vec = [0.0, 0.0, -9.81]\n")
    text = export("crazyflow", vehicle()).replace("[Crazyflie_2_0]", "[cf2x_L250]")
    (tmp_path / "first_principles" / "params.toml").write_text(text)
    monkeypatch.setattr(core, "__file__", str(tmp_path / "core.py"))
    move = core.parametrize(dynamics, drone)

    pos, vel, quat, spin = np.array([0, 0, 0.8]), np.zeros(3), np.array([0, 0, 0, 1.0]), np.zeros(3)
    guess = 0.9 * thesis.HOVER_SPEED_RAD_S / RPM
    rotors, controller = np.full(4, guess), Height(guess**2)
    for _ in range(8000):
        speed = math.sqrt(controller.command(pos[2], vel[2]))
        _, _, acceleration, turning, spin_up = move(
            pos=pos, quat=quat, vel=vel, ang_vel=spin, cmd=np.full(4, speed), rotor_vel=rotors
        )
        vel = vel + STEP_S * np.asarray(acceleration)
        pos, rotors = pos + STEP_S * vel, rotors + STEP_S * np.asarray(spin_up)
        np.testing.assert_allclose(turning, 0, atol=1e-6)

    assert pos[2] == pytest.approx(1, abs=0.02)
    assert command_of_speed(speed * RPM) == pytest.approx(thesis.HOVER_COMMAND, rel=0.05)


@pytest.mark.parametrize("name", ["gym-pybullet-drones", "safe-control-gym"])
def test_pybullet_loads_the_urdf_and_hovers_it(name: str, tmp_path: Path) -> None:
    bullet: Any = pytest.importorskip("pybullet", reason="pybullet, which both gyms load with, is not installed")
    from tests.export.reading import attributes, xml

    path = tmp_path / "vehicle.urdf"
    path.write_text(export(name, vehicle()))
    kf = attributes(xml(name, vehicle()).find("properties"))["kf"]
    client = bullet.connect(bullet.DIRECT)
    try:
        bullet.setGravity(0, 0, -9.81, physicsClientId=client)
        bullet.setTimeStep(STEP_S, physicsClientId=client)
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        body = bullet.loadURDF(str(path), [0, 0, 0.8], flags=flags, physicsClientId=client)
        bullet.changeDynamics(body, -1, linearDamping=0, angularDamping=0, physicsClientId=client)
        mass, _, diagonal = bullet.getDynamicsInfo(body, -1, physicsClientId=client)[:3]
        guess = 0.9 * thesis.HOVER_SPEED_RAD_S / RPM
        controller = Height(guess**2)
        for _ in range(8000):
            height = bullet.getBasePositionAndOrientation(body, physicsClientId=client)[0][2]
            rise = bullet.getBaseVelocity(body, physicsClientId=client)[0][2]
            rpm = math.sqrt(controller.command(height, rise))
            for link in range(4):
                force = [0, 0, kf * rpm**2]
                bullet.applyExternalForce(body, link, force, [0, 0, 0], bullet.LINK_FRAME, physicsClientId=client)
            bullet.stepSimulation(physicsClientId=client)
    finally:
        bullet.disconnect(client)

    assert mass == 0.028
    eigenvalues = np.linalg.eigvalsh(np.array(thesis.INERTIA_KG_M2))
    assert sorted(diagonal) == pytest.approx(eigenvalues, rel=0.01), json.dumps(diagonal)
    assert height == pytest.approx(1, abs=0.02)
    assert command_of_speed(rpm * RPM) == pytest.approx(thesis.HOVER_COMMAND, rel=0.05)
