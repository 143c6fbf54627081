"""The simulated dropping weight against the closed form of the thesis' eq. 2.14 and its limits."""

from dataclasses import replace

import numpy as np
import pytest

from cfid.sim.plants import DroppingWeight, drop

WAIT_S = 0.5
FIFTY_GRAMS = DroppingWeight(
    setup_inertia_kg_m2=4e-7,
    weight_kg=0.05,
    radius_m=2e-3,
    viscous_nms_per_rad=1.2e-6,
    coulomb_nm=2.5e-4,
)
TEN_GRAMS = replace(FIFTY_GRAMS, weight_kg=0.01, viscous_nms_per_rad=1e-6, coulomb_nm=1.2e-4)


def test_the_speed_rises_as_the_exponential_with_the_weights_own_inertia() -> None:
    motion = drop([FIFTY_GRAMS], duration_s=1.3, wait_s=WAIT_S)
    falling = (motion.time_s >= WAIT_S) & (motion.angle_rad[:, 0] < 499)
    since_s = motion.time_s[falling] - WAIT_S
    inertia_kg_m2 = 4e-7 + 0.05 * 2e-3**2
    steady_rad_per_s = (0.05 * 9.81 * 2e-3 - 2.5e-4) / 1.2e-6
    expected = steady_rad_per_s * (1 - np.exp(-since_s * 1.2e-6 / inertia_kg_m2))
    assert since_s[-1] > 0.7
    assert motion.speed_rad_per_s[falling, 0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_slack_line_lets_the_axis_coast_down_on_friction_alone() -> None:
    motion = drop([FIFTY_GRAMS], duration_s=3.0, wait_s=WAIT_S)
    slack = int(np.searchsorted(motion.angle_rad[:, 0], FIFTY_GRAMS.drop_m / FIFTY_GRAMS.radius_m)) + 1
    since_s = motion.time_s[slack:] - motion.time_s[slack]
    dry_rad_per_s = 2.5e-4 / 1.2e-6
    start_rad_per_s = motion.speed_rad_per_s[slack, 0]
    expected = (start_rad_per_s + dry_rad_per_s) * np.exp(-since_s * 1.2e-6 / 4e-7) - dry_rad_per_s
    assert start_rad_per_s > 300
    assert motion.speed_rad_per_s[slack:, 0] == pytest.approx(np.maximum(expected, 0), abs=1e-6)
    assert np.ptp(motion.angle_rad[-100:, 0]) == 0


def test_a_weight_too_light_for_the_friction_stays() -> None:
    light = replace(FIFTY_GRAMS, weight_kg=0.01)
    motion = drop([light], duration_s=2.0, wait_s=WAIT_S)
    assert np.all(motion.angle_rad == 0)


def test_a_weight_that_comes_slowly_to_an_angle_of_much_friction_stops_there() -> None:
    stuck_at_start = replace(TEN_GRAMS, coulomb_nm=1.5e-4, ripple_nm=8e-5)
    stuck_later = replace(TEN_GRAMS, coulomb_nm=1.8e-4, ripple_nm=-1e-4)
    motion = drop([stuck_at_start, stuck_later], duration_s=6.0, wait_s=WAIT_S)
    pull_nm = 0.01 * 9.81 * 2e-3
    assert np.all(motion.angle_rad[:, 0] == 0)
    stopped_rad = motion.angle_rad[-1, 1]
    assert 1 < stopped_rad < 2 * np.pi
    assert np.ptp(motion.angle_rad[-200:, 1]) == 0
    assert stuck_later.coulomb_nm + stuck_later.ripple_nm * np.cos(stopped_rad) > pull_nm
