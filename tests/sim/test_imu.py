"""The simulated gyro and accelerometer: bias, scale, alignment, noise, steps and range, at rest and turning."""

import math

import numpy as np
import pytest

from cfid.records.rig_file import thesis_rig
from cfid.sim.imu import Hanging, Imu, ImuTruth, Turning
from cfid.sim.swing import draw_truth, hanging
from cfid.sim.truth import INERTIA_KG_M2

EXACT = ImuTruth(gyro_noise_dps=0, gyro_bias_dps=(0, 0, 0), acc_noise_g=0, acc_bias_g=(0, 0, 0))
HANGING = Hanging(
    axis=np.array([1.0, 0, 0]), down=np.array([0, -1.0, 0]), sensor_m=np.array([0, -0.03, 0]), gravity_mps2=9.81
)
STEP_DPS, STEP_G = 2000 / 32768, 16 / 32768


def imu(truth: ImuTruth, turning: Turning = lambda time_s: (0.0, 0.0, 0.0), how: Hanging = HANGING) -> Imu:
    return Imu(truth, how, turning, np.random.default_rng(3))


def test_at_rest_the_gyro_shows_its_bias_and_noise_and_the_accelerometer_what_holds_it_up() -> None:
    still = imu(ImuTruth())
    gyro = np.array([still.at(time_s).gyro_dps for time_s in range(2000)])

    assert gyro.mean(axis=0) == pytest.approx([0.3, -0.2, 0.3], abs=0.006)
    assert gyro.std(axis=0) == pytest.approx(math.hypot(0.07, STEP_DPS / math.sqrt(12)), rel=0.06)
    assert imu(EXACT).at(0.0).acc_g == pytest.approx((0, 1, 0), abs=STEP_G)


def test_a_swing_is_felt_about_its_axis_with_scale_alignment_and_inward_force() -> None:
    truth = EXACT.model_copy(update={"gyro_scale": (0.01, 0.0, 0.0), "misalignment_deg": (0.0, 0.0, 1.0)})
    moving = imu(truth, lambda time_s: (0.0, 5.0, 0.0)).at(0.0)

    assert moving.gyro_dps[0] == pytest.approx(math.degrees(5) * math.cos(math.radians(1)) * 1.01, abs=STEP_DPS)
    assert moving.gyro_dps[1] == pytest.approx(-math.degrees(5) * math.sin(math.radians(1)), abs=STEP_DPS)
    # A sensor 30 mm below the axis also shows the centripetal acceleration w^2 r, besides the support against gravity.
    assert imu(EXACT, lambda time_s: (0.0, 5.0, 0.0)).at(0.0).acc_g[1] == pytest.approx(1 + 25 * 0.03 / 9.81, abs=1e-3)


@pytest.mark.parametrize("mount", ["x", "z", "yz"])
def test_a_vehicle_hangs_with_its_centre_of_mass_below_the_axis(mount: str) -> None:
    truth = draw_truth(thesis_rig(), inertia_kg_m2=INERTIA_KG_M2, rng=np.random.default_rng(1))

    how = hanging(truth, mount)

    below = truth.centre_of_mass_m - truth.mounts[mount].point_m
    assert how.down @ how.axis == pytest.approx(0, abs=1e-12)
    assert how.down @ below == pytest.approx(np.linalg.norm(np.cross(below, how.axis)))
