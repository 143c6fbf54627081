"""The axis that the encoder reads: one motion follows another without a jump."""

import numpy as np
import pytest

from cfid.records.rig_file import thesis_rig
from cfid.sim.plants import DroppingWeight
from cfid.sim.swing import DROPS, PERIOD_S, RELEASES, Axis, draw_truth, dropping, pendulum, resting, swinging
from cfid.sim.truth import INERTIA_KG_M2

MS = 1e-3


@pytest.fixture(scope="module")
def swung() -> Axis:
    rng = np.random.default_rng(4)
    vehicle = draw_truth(thesis_rig(), inertia_kg_m2=INERTIA_KG_M2, rng=rng)
    return swinging(pendulum(vehicle, "x"), rng=rng)


@pytest.fixture(scope="module")
def dropped() -> Axis:
    weight = DroppingWeight(
        setup_inertia_kg_m2=1.5e-7, weight_kg=0.03, radius_m=0.002, viscous_nms_per_rad=1.1e-6, coulomb_nm=3.2e-4
    )
    return dropping([weight] * DROPS, rng=np.random.default_rng(4))


def _angles(axis: Axis, begin_s: float, end_s: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([axis.angle_at(time_s) for time_s in np.arange(begin_s, end_s, MS)])


def test_every_release_is_another_one(swung: Axis) -> None:
    rest_rad = swung.angle_at(0.0)
    highest = [np.abs(_angles(swung, i * PERIOD_S, i * PERIOD_S + 4) - rest_rad).max() for i in range(RELEASES)]
    assert min(highest) > np.radians(15)
    assert len(np.unique(np.round(highest, 4))) == RELEASES


def test_a_swing_goes_over_into_the_next_without_a_jump(swung: Axis) -> None:
    for turn in (1, RELEASES):
        steps = np.diff(_angles(swung, turn * PERIOD_S - 0.5, turn * PERIOD_S + 0.5))
        assert np.abs(steps).max() < 1e-3


def test_a_swing_comes_to_rest_before_the_next(swung: Axis) -> None:
    assert np.ptp(_angles(swung, PERIOD_S - 1, PERIOD_S)) < 1e-3


def test_a_weight_falls_and_is_wound_up_before_it_falls_again(dropped: Axis) -> None:
    angles = _angles(dropped, 0, 2 * PERIOD_S) - dropped.angle_at(0.0)
    assert angles.max() > 499
    assert abs(angles[round((PERIOD_S + 4.2) / MS)]) < 1e-6
    assert np.abs(np.diff(angles)).max() < 0.5


def test_before_time_zero_and_without_anything_on_it_the_axis_stands_still(swung: Axis) -> None:
    assert swung.angle_at(-5.0) == swung.angle_at(0.0)
    still = resting(offset_rad=1.5)
    assert still.angle_at(0.0) == still.angle_at(33.3) == 1.5
