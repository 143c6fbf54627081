"""RotorPy takes the module as one of its own vehicles, and its SE3 controller flies the vehicle."""

import importlib.metadata
import runpy
from pathlib import Path
from typing import Any

import numpy as np

from tests.consumers.conftest import Judge
from tests.consumers.plant import (
    DOWN_S,
    DRAG_1_S,
    FLAPPING_NS,
    HOVER_RAD_S,
    INERTIA,
    MIXES,
    UP_S,
    Array,
    Row,
    accelerations,
    crossing,
    lag_of_first_order,
    pairs,
    speeds,
    written,
)

STEP_S = 0.001
OWN_ORDER = [3, 0, 1, 2]  # r1 to r4 are m4, m1, m2, m3
GOAL_M = np.array([0.0, 0.0, 1.0])
TO_HOVER = {
    "x": GOAL_M, "x_dot": np.zeros(3), "x_ddot": np.zeros(3), "x_dddot": np.zeros(3),
    "x_ddddot": np.zeros(3), "yaw": 0.0, "yaw_dot": 0.0, "yaw_ddot": 0.0,
}  # fmt: skip


def state_of(rotor_speeds: Array, velocity: Array | None = None) -> dict[str, Array]:
    return {
        "x": np.array([0.1, -0.1, 0.8]), "v": np.zeros(3) if velocity is None else velocity,
        "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3), "wind": np.zeros(3), "rotor_speeds": rotor_speeds,
    }  # fmt: skip


def flown(drone: Any, controller: Any) -> Array:
    """Return the rotor speeds after 10 s with the program's own controller, which has to reach its goal."""
    state = state_of(np.full(4, HOVER_RAD_S))
    for i in range(5000):
        state = drone.step(state, controller.update(0.002 * i, state, TO_HOVER), 0.002)
    np.testing.assert_allclose(state["x"], GOAL_M, atol=0.005)
    found: Array = state["rotor_speeds"]
    return found


def test_rotorpy_flies_the_vehicle_with_its_own_controller(tmp_path: Path, judge: Judge) -> None:
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.vehicles import crazyflie_params
    from rotorpy.vehicles.multirotor import Multirotor

    parameters = runpy.run_path(str(written("rotorpy", tmp_path, "rotorpy_params.py")))["quad_params"]
    drone = Multirotor(parameters)
    for name, place in crazyflie_params.quad_params["rotor_pos"].items():  # its RAPTOR controller knows no other order
        assert np.sign(parameters["rotor_pos"][name][:2]).tolist() == np.sign(place[:2]).tolist()
    assert parameters["rotor_directions"].tolist() == crazyflie_params.quad_params["rotor_directions"].tolist()
    still = {"cmd_motor_speeds": np.full(4, HOVER_RAD_S)}
    turning = [
        drone.statedot(state_of(speeds(axis)[OWN_ORDER]), still, STEP_S)["wdot"][i] for i, axis in enumerate(MIXES)
    ]  # fmt: skip
    braking = [
        -drone.statedot(state_of(np.full(4, HOVER_RAD_S), velocity=np.eye(3)[i]), still, STEP_S)["vdot"][i]
        for i in range(3)
    ]
    at_rest, forward, left = (
        INERTIA @ drone.statedot(state_of(np.full(4, HOVER_RAD_S), velocity=np.array(one)), still, STEP_S)["wdot"]
        for one in ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    )
    faster, state = {"cmd_motor_speeds": np.full(4, 1.1 * HOVER_RAD_S)}, state_of(np.full(4, HOVER_RAD_S))
    thrusts = [HOVER_RAD_S**2]
    for _ in range(600):
        state = drone.step(state, faster, STEP_S)
        thrusts.append(float(state["rotor_speeds"][0]) ** 2)
    level = HOVER_RAD_S**2 * (1 + (1 - np.exp(-1)) * (1.1**2 - 1))

    mean_ns = (FLAPPING_NS[0] - FLAPPING_NS[1]) / 2
    np.testing.assert_allclose((forward - at_rest)[:2], [0.0, -mean_ns], atol=1e-9)
    np.testing.assert_allclose((left - at_rest)[:2], [mean_ns, 0.0], atol=1e-9)
    judge(
        Row(
            target="rotorpy",
            version=f"rotorpy {importlib.metadata.version('rotorpy')}",
            loaded="`Multirotor`, flown by `SE3Control`",
            hover=(HOVER_RAD_S, float(np.sqrt(np.mean(flown(drone, SE3Control(parameters)) ** 2)))),
            hover_unit="rad/s",
            turning=pairs(accelerations(), turning),
            lag_s=(
                lag_of_first_order((UP_S + DOWN_S) / 2),
                crossing([i * STEP_S for i in range(len(thrusts))], thrusts, level),
            ),
            drag_1_s=pairs(DRAG_1_S, braking),
        )
    )


def test_a_policy_for_any_quadrotor_hovers_the_vehicle(tmp_path: Path) -> None:
    """RAPTOR needs no gains, but rotors in the order of RotorPy's own vehicles: else it crashes after 3.5 s."""
    from rotorpy.controllers.raptor import RaptorFoundationPolicy
    from rotorpy.vehicles.multirotor import Multirotor

    parameters = runpy.run_path(str(written("rotorpy", tmp_path, "rotorpy_params.py")))["quad_params"]
    drone, policy = Multirotor(parameters), RaptorFoundationPolicy(parameters)
    state, goal = {**state_of(np.full(4, HOVER_RAD_S)), "x": np.zeros(3)}, {**TO_HOVER, "x": np.zeros(3)}
    away_m = []
    for i in range(1000):
        state = drone.step(state, policy.update(0.01 * i, state, goal), 0.01)
        away_m.append(float(np.linalg.norm(state["x"])))
    assert max(away_m) < 0.05
