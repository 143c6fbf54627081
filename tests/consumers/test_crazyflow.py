"""crazyflow takes the file's drone beside its own, or its values in a running simulation, and flies both."""

import importlib.metadata
import importlib.util
import runpy
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.consumers.conftest import Judge
from tests.consumers.plant import (
    DRAG_1_S,
    HOVER_RAD_S,
    MIXES,
    RPM,
    Array,
    Row,
    accelerations,
    crossing,
    pairs,
    speeds,
    written,
)
from tests.export import thesis_vehicle as thesis
from tests.export.reading import export

OTHER = "cf2x_L250"
STEP_S = 1e-3


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a copy of the package before the installed one on the path; return its folder."""
    found = importlib.util.find_spec("crazyflow")
    assert found is not None
    assert found.submodule_search_locations is not None
    shutil.copytree(found.submodule_search_locations[0], tmp_path / "crazyflow")
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path / "crazyflow"


def moves(dynamics: Any, rotor_speeds: Array, velocity: Any = (0, 0, 0), command: Array | None = None) -> Any:
    """Return the linear and angular accelerations, and those of the rotors, whose speeds are in rpm."""
    rpm = np.asarray(rotor_speeds, dtype=float) / RPM
    return [
        np.asarray(part)
        for part in dynamics(
            pos=np.array([0.0, 0.0, 1.0]), quat=np.array([0.0, 0.0, 0.0, 1.0]), vel=np.array(velocity, dtype=float),
            ang_vel=np.zeros(3), cmd=rpm if command is None else command / RPM, rotor_vel=rpm,
        )[2:]
    ]  # fmt: skip


def rising_lag(faster: float, acceleration: Any) -> float:
    """Return the time of 63.2 % of the change of thrust from hover; `acceleration` takes rad/s and gives rad/s^2."""
    speed, values = HOVER_RAD_S, [HOVER_RAD_S**2]
    for _ in range(800):  # fourth-order Runge-Kutta
        a = acceleration(speed)
        b = acceleration(speed + STEP_S / 2 * a)
        c = acceleration(speed + STEP_S / 2 * b)
        d = acceleration(speed + STEP_S * c)
        speed += STEP_S / 6 * (a + 2 * b + 2 * c + d)
        values.append(speed**2)
    level = HOVER_RAD_S**2 * (1 + (1 - np.exp(-1)) * (faster**2 - 1))
    return crossing([i * STEP_S for i in range(len(values))], values, level)


def flown(sim: Any) -> Array:
    """Return the rotor speeds in rad/s after 15 s with the program's own controller, which has to reach its goal."""
    command = np.zeros((1, 1, 16), dtype=np.float32)
    command[..., [2, 12]] = 1.0  # 1 m high, upright
    for _ in range(150):
        sim.state_control(command)
        sim.step(sim.freq // 10)
    np.testing.assert_allclose(np.asarray(sim.data.states.pos)[0, 0], [0, 0, 1], atol=0.05)
    found: Array = RPM * np.asarray(sim.data.states.rotor_vel, dtype=float)[0, 0]
    return found


def sinking(sim: Any, weight_n: float) -> float:
    """Return the vertical velocity in m/s after 2 s with a thrust of the weight by the attitude controller."""
    states = sim.data.states
    turning = states.rotor_vel.at[...].set(HOVER_RAD_S / RPM)
    sim.data = sim.data.replace(states=states.replace(pos=states.pos.at[..., 2].set(5.0), rotor_vel=turning))
    command = np.zeros((1, 1, 4), dtype=np.float32)
    command[..., 3] = weight_n
    for _ in range(20):
        sim.attitude_control(command)
        sim.step(sim.freq // 10)
    return float(np.asarray(sim.data.states.vel)[0, 0, 2])


def test_crazyflow_flies_the_drone_that_the_file_adds(package: Path, judge: Judge) -> None:
    # The controller has no integral of roll and pitch: with an off-centre mass, the vehicle would fall over.
    script = package.parent / "thesis_drone.py"
    script.write_text(export("crazyflow", thesis.vehicle()))
    for code in (0, 1):  # nothing is added twice
        assert subprocess.run([sys.executable, script, package], capture_output=True, check=False).returncode == code
    added = runpy.run_path(str(script))
    own, mass_kg = added["NAME"], added["FIRST_PRINCIPLES"]["mass"]

    from crazyflow.drones import Drone
    from crazyflow.dynamics import supported_drones
    from crazyflow.dynamics.core import parametrize
    from crazyflow.dynamics.first_principles import dynamics as first_principles
    from crazyflow.sim import Sim

    assert {OTHER, own} <= set(supported_drones("first_principles"))
    at_end = flown(Sim(drone=own, dynamics="first_principles", control="state", freq=500))
    set_in = Sim(drone=OTHER, dynamics="first_principles", control="state", freq=500)
    set_in.data = added["measured"](set_in.data)
    np.testing.assert_allclose(flown(set_in), at_end, rtol=1e-3)
    held = Sim(drone=own, dynamics="first_principles", control="attitude", freq=500)
    assert abs(sinking(held, 9.81 * mass_kg)) < 0.01

    centred = parametrize(first_principles, Drone(own))
    moved = runpy.run_path(str(written("crazyflow", package.parent, "moved_drone.py")))["FIRST_PRINCIPLES"]
    moved = {key: np.asarray(value) for key, value in moved.items()}
    moved["J_inv"] = np.linalg.inv(moved["J"])
    dynamics = partial(centred.func, **(centred.keywords | {k: v for k, v in moved.items() if k in centred.keywords}))
    hovering, target = np.full(4, HOVER_RAD_S), 1.1 * HOVER_RAD_S
    a, b = thesis.RISING

    braking = [-(moves(dynamics, hovering, np.eye(3)[i])[0] - moves(dynamics, hovering)[0])[i] for i in range(3)]
    judge(
        Row(
            target="crazyflow",
            version=f"crazyflow {importlib.metadata.version('crazyflow')}",
            loaded="as a drone of its own, flown by `Sim` with its state controller",
            hover=(HOVER_RAD_S, float(np.sqrt(np.mean(at_end**2)))),
            hover_unit="rad/s",
            turning=pairs(accelerations(), [moves(dynamics, speeds(axis))[1][i] for i, axis in enumerate(MIXES)]),
            lag_s=(
                rising_lag(1.1, lambda w: a * (target - w) + b * (target**2 - w**2)),
                rising_lag(
                    1.1, lambda w: RPM * float(moves(dynamics, np.full(4, w), command=np.full(4, target))[2][0])
                ),
            ),
            drag_1_s=pairs(DRAG_1_S, braking),
        )
    )
    assert moves(dynamics, np.zeros(4))[0][2] == pytest.approx(-9.81)  # no thrust without rotor speed
