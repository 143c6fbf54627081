"""PyFlyt's QuadX loads the pair of files, and its own controller flies the vehicle."""

import importlib.metadata
from pathlib import Path
from typing import Any

import numpy as np

from tests.consumers.conftest import Judge
from tests.consumers.plant import (
    DOWN_S,
    HOVER_RAD_S,
    INERTIA,
    MIXES,
    MOST_N,
    UP_S,
    Array,
    K,
    Row,
    accelerations,
    pairs,
    speeds,
    written,
)

LINKS = [0, 2, 3, 1]  # the motors of links 0 to 3: m1, m3, m4 and m2
STEP_S, STEPS = 1 / 240, 2  # of physics, in each step of the controller
GOAL = np.array([0.3, -0.2, 0.5, 1.2])  # x, y, yaw, z


def of_speeds(rotor_speeds: Array) -> Array:
    """Return the commands, 1 at the largest thrust, that hold rotor speeds."""
    found: Array = (rotor_speeds * np.sqrt(K / MOST_N))[LINKS]
    return found


def test_pyflyt_flies_the_vehicle_with_its_own_controller(tmp_path: Path, judge: Judge) -> None:
    from PyFlyt.core import Aviary

    (tmp_path / "cfid").mkdir()
    written("pyflyt", tmp_path, "cfid/cfid.yaml")
    written("pyflyt-urdf", tmp_path, "cfid/cfid.urdf")
    aviary = Aviary(
        start_pos=np.array([[0.0, 0.0, 1.0]]),
        start_orn=np.zeros((1, 3)),
        drone_type="quadx",
        drone_options={"model_dir": str(tmp_path), "drone_model": "cfid"},
    )

    def begun(commands: Array) -> Any:
        """Return the vehicle with rotors that turn."""
        aviary.reset()
        aviary.set_mode(-1)
        aviary.set_setpoint(0, commands)
        aviary.drones[0].motors.throttle[:] = commands
        return aviary.drones[0]

    def moved(commands: Array) -> Array:
        """Return the angular (3,) and linear (3,) acceleration in the body."""
        drone = begun(commands)
        aviary.step()
        found: Array = np.concatenate([drone.state[0], drone.state[2]]) / (STEPS * STEP_S)
        return found

    hovering = of_speeds(np.full(4, HOVER_RAD_S))
    less, more = (moved(share * hovering)[5] for share in (0.9, 1.1))
    turning = [moved(of_speeds(speeds(axis)))[i] for i, axis in enumerate(MIXES)]
    drone = begun(hovering)
    aviary.set_setpoint(0, 1.1 * hovering)
    aviary.step()
    left = (1.1 * hovering[0] - drone.motors.throttle[0]) / (0.1 * hovering[0])
    aviary.set_mode(7)
    aviary.set_setpoint(0, GOAL)
    for _ in range(15 * 120):
        aviary.step()

    np.testing.assert_allclose(drone.state[3], GOAL[[0, 1, 3]], atol=0.05)
    judge(
        Row(
            target="pyflyt",
            version=f"PyFlyt {importlib.metadata.version('PyFlyt')}",
            loaded="`Aviary`, flown by `QuadX`",
            hover=(HOVER_RAD_S, HOVER_RAD_S * float(np.sqrt(0.81 - 0.4 * less / (more - less)))),
            hover_unit="rad/s",
            turning=pairs(accelerations(np.diag(np.diag(INERTIA))), turning),
            lag_s=((UP_S + DOWN_S) / 2, STEP_S / (1 - left ** (1 / STEPS))),
        )
    )
