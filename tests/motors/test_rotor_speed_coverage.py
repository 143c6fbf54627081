"""Statistics of the standard uncertainty of a rotor speed over windows in which everything is drawn anew."""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lfilter

from cfid.motors.vibration.estimation import RotorSpeed, rotor_speed
from cfid.sim.loadcell import LoadCellTruth
from tests.motors.test_rotor_speed import HZ, window

Array = npt.NDArray[np.float64]

NOISE = np.array(LoadCellTruth().noise_std)


def as_it_is(wrench: Array, rng: np.random.Generator) -> Array:
    return wrench


def with_red_noise(wrench: Array, rng: np.random.Generator) -> Array:
    return np.asarray(wrench + lfilter([1], [1, -0.8], NOISE * rng.standard_normal(wrench.shape), axis=0))


def with_a_resonance(wrench: Array, rng: np.random.Generator) -> Array:
    """Add noise of a mount that resonates at 150 to 500 Hz, 50 Hz wide."""
    turn = 2 * math.pi * rng.uniform(150, 500) / HZ
    filtered = lfilter([1], [1, -1.96 * math.cos(turn), 0.9604], NOISE * rng.standard_normal(wrench.shape), axis=0)
    return wrench + 0.3 * np.asarray(filtered)


def scores(
    change: Callable[[Array, np.random.Generator], Array], *, windows: int, least: float, seconds: float
) -> tuple[Array, list[RotorSpeed]]:
    """Return the error of each accepted speed in its standard uncertainties, and all estimates."""
    off, found = [], []
    for seed in range(windows):
        rng = np.random.default_rng(10_000 + seed)
        command = rng.uniform(least, 64000)
        time_s, wrench, truth = window((command, 0, command, 0), seconds=seconds, seed=seed)
        one = rotor_speed(time_s=time_s, wrench=change(wrench, rng))
        found.append(one)
        if one.accepted:
            # No accepted speed belongs to another line: an error above 0.1 % is within 3 std of that speed.
            assert abs(one.speed_rad_per_s - truth[0]) < max(1e-3 * truth[0], 3 * one.std_rad_per_s)
            off.append((one.speed_rad_per_s - truth[0]) / one.std_rad_per_s)
    return np.array(off), found


def test_of_forty_windows_hardly_one_is_outside_two_deviations() -> None:
    off, found = scores(as_it_is, windows=40, least=8000, seconds=0.5)

    assert sum(one.accepted for one in found) > 35
    assert np.mean(np.abs(off) > 2.5) < 0.1
    assert 0.6 < np.std(off) < 1.4


@pytest.mark.slow
@pytest.mark.parametrize("change", [as_it_is, with_red_noise, with_a_resonance])
def test_ninety_five_percent_cover_in_noise_of_any_colour(
    change: Callable[[Array, np.random.Generator], Array],
) -> None:
    off, found = scores(change, windows=800, least=6000, seconds=1.0)

    held = float(np.mean(np.abs(off) < 1.96))
    print(f"intervals of speeds hold the truth: {held:.3f}")
    assert 0.93 <= held <= 0.97
    assert sum(one.accepted for one in found) > 0.7 * len(found)
    assert sum(one.wander_rad_per_s > 0 for one in found if one.accepted) < 0.01 * len(found)


@pytest.mark.slow
def test_each_of_two_rotors_is_covered_wherever_they_are_told_apart() -> None:
    off, told = [], 0
    for seed in range(200):
        rng = np.random.default_rng(20_000 + seed)
        command, apart = rng.uniform(8000, 60000), 10 ** rng.uniform(0, 2.5)
        time_s, wrench, truth = window((command, 0, command + apart / 0.0408, 0), seconds=1.0, seed=seed)
        found = rotor_speed(time_s=time_s, wrench=wrench, rotors=2)
        mean = (found.speed_rad_per_s - truth[[0, 2]].mean()) / found.std_rad_per_s
        if not found.accepted:
            continue
        if found.resolved:
            told += 1
            pairs = zip(found.rotors, truth[[0, 2]], strict=True)
            off += [(rotor.speed_rad_per_s - speed) / rotor.std_rad_per_s for rotor, speed in pairs]
        else:
            assert abs(mean) < 2.5

    assert told > 150
    assert 0.92 <= np.mean(np.abs(off) < 1.96) <= 0.975
