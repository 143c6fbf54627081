"""MuJoCo loads the model without changes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.export.vehicle import collect_published
from cfid.published import published_set
from tests.consumers.conftest import Judge
from tests.consumers.plant import (
    ARM_M,
    DOWN_S,
    DRAG_1_S,
    INERTIA,
    MASS_KG,
    MIXES,
    MOMENT_M,
    UP_S,
    G,
    K,
    Row,
    accelerations,
    crossing,
    pairs,
    speeds,
    written,
)
from tests.export.reading import export

SHARE_N = MASS_KG * G / 4


@pytest.fixture
def model(tmp_path: Path) -> Any:
    import mujoco

    return mujoco.MjModel.from_xml_path(str(written("mujoco", tmp_path, "crazyflie.xml")))


def at(model: Any, thrusts_n: Any, velocity: Any = (0, 0, 0)) -> Any:
    """Return the accelerations (6,) of a vehicle in the air whose motors have settled."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[2] = 1.0
    data.act[:4] = data.ctrl[:4] = thrusts_n
    data.qvel[:3] = velocity
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)


def test_mujoco_hovers_turns_and_brakes_the_vehicle(model: Any, judge: Judge) -> None:
    import mujoco

    rise = [at(model, np.full(4, share * SHARE_N))[2] for share in (0.5, 1.5)]
    hover = SHARE_N * (0.5 + rise[0] / (rise[0] - rise[1]))
    data = mujoco.MjData(model)
    data.act[:4], data.ctrl[:4] = SHARE_N, 1.2 * SHARE_N
    times, thrusts = [0.0], [SHARE_N]
    for _ in range(400):
        mujoco.mj_step(model, data)
        times.append(data.time)
        thrusts.append(float(data.act[0]))
    lag = crossing(times, thrusts, SHARE_N * (1 + 0.2 * (1 - np.exp(-1))))
    braking = [-(at(model, SHARE_N, np.eye(3)[i]) - at(model, SHARE_N))[i] for i in range(3)]

    judge(
        Row(
            target="mujoco",
            version=f"mujoco {mujoco.__version__}",
            loaded="`MjModel.from_xml_path`",
            hover=(SHARE_N, hover),
            hover_unit="N",
            turning=pairs(accelerations(), [at(model, K * speeds(axis) ** 2)[3 + i] for i, axis in enumerate(MIXES)]),
            lag_s=((UP_S + DOWN_S) / 2, lag),
            drag_1_s=pairs(DRAG_1_S, braking),
        )
    )


def test_mujoco_begins_upright_and_stays_on_the_floor(model: Any) -> None:
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    np.testing.assert_array_equal(data.qpos[3:7], [1, 0, 0, 0])
    for _ in range(2000):
        mujoco.mj_step(model, data)

    assert 0.01 < data.qpos[2] < 0.02


def test_mujocos_mass_matrix_is_the_measured_one(model: Any) -> None:
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    columns = []
    for axis in range(6):  # the inverse by columns, since versions store the matrix in different ways
        solved = np.zeros((1, model.nv))
        mujoco.mj_solveM(model, data, solved, np.eye(6)[axis : axis + 1])
        columns.append(solved[0])

    np.testing.assert_allclose(np.linalg.inv(columns)[3:, 3:], INERTIA, rtol=1e-6)


def test_mujoco_hovers_and_turns_the_published_vehicle(tmp_path: Path) -> None:
    """The centre of mass is assumed in the middle, so that four equal thrusts turn nothing."""
    import mujoco

    path = tmp_path / "thesis.xml"
    path.write_text(export("mujoco", collect_published(published_set("thesis"))))
    published = mujoco.MjModel.from_xml_path(str(path))
    side_m = ARM_M / np.sqrt(2)
    for i, (lever_m, mix) in enumerate(zip((side_m, side_m, MOMENT_M), MIXES.values(), strict=True)):
        moment = np.zeros(3)
        moment[i] = 4 * lever_m * 0.01 * SHARE_N
        turning = at(published, SHARE_N * (1 + 0.01 * mix))[3:]
        np.testing.assert_allclose(turning, np.linalg.solve(INERTIA, moment), rtol=1e-6, atol=1e-9)

    np.testing.assert_allclose(at(published, SHARE_N), 0, atol=1e-6)
