"""Preparation of a record: rest, release, peaks and window are found where a simulated hand and encoder made them."""

import functools
import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.sim.plants import HandRelease, Motion, Pendulum, swing
from cfid.swing.window import FEWEST_PEAKS, find_swing

Array = npt.NDArray[np.float64]

PENDULUM = Pendulum(
    axis_inertia_kg_m2=3.1e-5, gravity_moment_nm=6.28e-3, viscous_nms_per_rad=1.5e-5, coulomb_nm=4e-5, rest_rad=0.3
)
HELD_LONG = [HandRelease(angle_rad=math.radians(degrees), hold_s=1.1) for degrees in (-65, -30, 12, 45, 70)]
RELEASES = [*HELD_LONG, *(HandRelease(angle_rad=angle_rad) for angle_rad in (0.5, 0.8, 0.9))]


@functools.cache
def swung() -> Motion:
    """Return the motion of all releases, simulated at once, which takes no longer than one."""
    return swing([PENDULUM] * len(RELEASES), RELEASES, duration_s=12.0, step_s=1e-3, store_every=1)


def recorded(release: HandRelease) -> tuple[Array, Array]:
    motion, steps = swung(), 2 * math.pi / 8192
    return motion.time_s, steps * np.floor(motion.angle_rad[:, RELEASES.index(release)] / steps)


@pytest.mark.parametrize("release", HELD_LONG, ids=lambda release: f"{math.degrees(release.angle_rad):.0f}")
def test_the_release_is_where_the_hand_lets_go(release: HandRelease) -> None:
    found = find_swing(*recorded(release))

    assert found.release_s == pytest.approx(release.free_s, abs=0.04)
    assert found.peak_angle_rad[0] == pytest.approx(release.angle_rad, abs=math.radians(1.0))
    assert found.time_s[found.hand_gone] > release.free_s


def test_the_release_counts_as_the_first_peak_and_one_follows_every_period() -> None:
    found = find_swing(*recorded(HandRelease(angle_rad=0.8)), peaks=8)
    small = 2 * math.pi * math.sqrt(3.1e-5 / 6.28e-3)

    assert found.peaks_used == 8
    assert np.all(np.diff(np.abs(found.peak_angle_rad)) < 0)
    assert np.diff(found.peak_time_s)[-1] == pytest.approx(small, rel=0.01)
    assert found.time_s[found.end] == pytest.approx(found.peak_time_s[7], abs=2e-3)


def test_the_ten_degree_rule_stops_at_the_last_peak_of_ten_degrees() -> None:
    found = find_swing(*recorded(HandRelease(angle_rad=0.9)), smallest_peak_rad=math.radians(10))
    heights = np.degrees(np.abs(found.peak_angle_rad))

    assert heights[found.peaks_used - 1] >= 10 > heights[found.peaks_used]


def test_a_swing_pushed_again_ends_before_the_push() -> None:
    _, angle = recorded(HandRelease(angle_rad=0.8))
    pushed: Array = np.concatenate([angle[:4500], 0.3 + (angle[2000:6000] - 0.3) * 0.9]).astype(np.float64)
    found = find_swing(np.asarray(0.001 * np.arange(len(pushed)), dtype=np.float64), pushed)

    assert found.time_s[found.end] < 4.6
    assert [finding.code for finding in found.findings] == ["swing-peak-grows"]


def test_a_body_that_is_lifted_again_at_the_end_leaves_the_swing_before() -> None:
    _, angle = recorded(HandRelease(angle_rad=0.8))
    time_s, again = recorded(HandRelease(angle_rad=0.9))
    second = np.asarray(again[: round(1000 * (find_swing(time_s, again).release_s + 0.6))])
    both = np.concatenate([angle[:9000], second])
    whole, found = find_swing(time_s[:9000], angle[:9000]), find_swing(np.arange(len(both)) / 1000.0, both)
    assert found.release_s == pytest.approx(whole.release_s, abs=0.01)
    assert found.peaks_used > FEWEST_PEAKS
    assert found.period_s == pytest.approx(whole.period_s, rel=0.01)
    assert [finding.code for finding in found.findings] == ["swing-peak-grows"]


TIME_S = np.arange(0, 9, 0.001)
REFUSED: dict[str, tuple[Array, dict[str, int], str]] = {
    "never changes": (np.full(9000, 1.2), {}, "never changes"),
    "a wobble below a degree": (0.005 * np.cos(14 * TIME_S), {}, "no swing"),
    "lifted before the end": (np.radians(-55.6) * np.clip(TIME_S - 8.3, 0, 0.5) / 0.5, {}, "no release found"),
    "500 rad": (1000 * recorded(HandRelease(angle_rad=0.8))[1][:9000], {}, "goes over the top"),
    "three peaks": (recorded(HandRelease(angle_rad=0.8))[1][:3000], {}, "usable peaks"),
    "more peaks than there are": (recorded(HandRelease(angle_rad=0.5))[1][:9000], {"peaks": 99}, "were requested"),
}


@pytest.mark.parametrize(("angle", "window", "reason"), REFUSED.values(), ids=REFUSED)
def test_a_record_without_a_free_swing_is_refused(angle: Array, window: dict[str, int], reason: str) -> None:
    with pytest.raises(DataError, match=reason):
        find_swing(TIME_S[: len(angle)], angle, **window)


def test_a_record_of_hours_is_refused_until_its_window_is_given() -> None:
    time_s = np.arange(4_000_000, dtype=np.float64) * 1e-3
    since_s = (time_s - 2000).clip(0, 60)
    angle_rad = 0.5 * np.exp(-since_s / 10) * np.cos(10 * since_s) * (since_s < 60)
    with pytest.raises(DataError, match="`from_s` and `to_s`"):
        find_swing(time_s, angle_rad)
    found = find_swing(time_s, angle_rad, from_s=1990, to_s=2065)

    assert found.release_s == pytest.approx(2000, abs=0.05)
    assert found.period_s == pytest.approx(2 * np.pi / 10, rel=1e-4)
