"""Speed over time from vibration: staircases, ramps, and stopped rotors, which are distinguished from running ones."""

import functools

import numpy as np
import numpy.typing as npt
import pytest
from scipy.special import roots_jacobi

from cfid.errors import FitError
from cfid.motors.vibration.ridge import SpeedRidge, speed_ridge
from cfid.sim.loadcell import LoadCellTruth, SimulatedLoadCell
from cfid.sim.propulsion import RotorTruth, SimulatedRotors
from tests.motors.test_rotor_speed import HZ, noise, rotating

Array = npt.NDArray[np.float64]

STAIRCASE = (0, 10000, 20000, 40000, 64000, 30000, 8000, 0)
WINDOW_S, STEP_S = 0.1, 0.05


@functools.cache
def staircase(commands: tuple[int, ...] = STAIRCASE, *, hold_s: float = 0.8) -> tuple[Array, Array, Array]:
    """Return times, the load cell's readings in N and Nm, and the speed of motor 1, which follows step by step."""
    truth, rng = RotorTruth(), np.random.default_rng(4)
    rotors, count = SimulatedRotors(truth, rng), round(hold_s * HZ)
    rotors.advance(np.zeros(1), np.zeros(4))
    wrenches, speeds, speed = [], [], 0.0
    for k, command in enumerate(commands):
        time_s = k * hold_s + np.arange(1, count + 1) / HZ
        wrenches.append(rotors.advance(time_s, np.array([command, 0.0, 0, 0])))
        steady = float(truth.steady_rad_per_s(np.array(command), volts=truth.nominal_v))
        speeds.append(steady + (speed - steady) * np.exp(-(time_s - k * hold_s) / truth.time_constant_s))
        speed = float(speeds[-1][-1])
    time_s = np.arange(1, count * len(commands) + 1) / HZ
    counts, _ = SimulatedLoadCell(LoadCellTruth(), rng).read(time_s, np.vstack(wrenches))
    return time_s, counts / LoadCellTruth().counts_per_unit, np.concatenate(speeds)


@functools.cache
def ridge_of_the_staircase() -> tuple[SpeedRidge, Array]:
    """Return the ridge, and the true speeds averaged as its windows weight them."""
    time_s, wrench, speed = staircase()
    ridge = speed_ridge(time_s=time_s, wrench=wrench, window_s=WINDOW_S, step_s=STEP_S)
    nodes, weights = roots_jacobi(8, 1, 1)
    seen = weights @ np.interp(ridge.time_s + WINDOW_S / 2 * nodes[:, None], time_s, speed) / weights.sum()
    return ridge, seen


def test_a_staircase_is_followed_up_and_down() -> None:
    ridge, truth = ridge_of_the_staircase()
    estimated = np.isfinite(ridge.speed_rad_per_s)
    off = np.abs(ridge.speed_rad_per_s / np.maximum(truth, 1) - 1)

    settling = ridge.time_s % 0.8 < WINDOW_S + 0.1  # here the step blurs a window's lines
    assert np.all(estimated[(truth > 600) & ~settling])
    assert np.mean(off[estimated] < 0.02) > 0.93
    assert np.max(off[estimated]) < 0.15  # no window in another octave, not even across a step


def test_steady_windows_have_honest_deviations() -> None:
    ridge, truth = ridge_of_the_staircase()
    phase_s = ridge.time_s % 0.8
    steady = np.isfinite(ridge.speed_rad_per_s) & (phase_s > 0.5) & (phase_s < 0.75) & (truth > 100)
    off = (ridge.speed_rad_per_s - truth)[steady]

    assert np.sum(steady) > 20
    assert np.max(np.abs(off) / truth[steady]) < 0.01
    assert np.mean(np.abs(off) < 2.5 * ridge.std_rad_per_s[steady]) > 0.9


def test_a_rotor_at_rest_is_not_heard() -> None:
    ridge, truth = ridge_of_the_staircase()

    assert np.all(np.isnan(ridge.speed_rad_per_s[truth < 1]))
    assert np.max(ridge.evidence[truth < 1]) < 20 < np.median(ridge.evidence[truth > 600])


def test_a_ramp_is_followed_within_a_fraction_of_a_percent() -> None:
    time = np.arange(3 * HZ) / HZ
    ridge = speed_ridge(time_s=time, wrench=rotating(700 * time + 400 * time**2), window_s=0.1, step_s=0.05)

    np.testing.assert_allclose(ridge.speed_rad_per_s, 700 + 800 * ridge.time_s, rtol=3e-3)


def test_a_loud_knock_does_not_throw_the_ridge_off() -> None:
    time = np.arange(2 * HZ) / HZ
    wrench = rotating(1500 * time)
    knock = slice(HZ, HZ + HZ // 5)
    wrench[knock] += 100 * noise(HZ // 5)
    ridge = speed_ridge(time_s=time, wrench=wrench, window_s=0.1, step_s=0.05)
    estimated = np.isfinite(ridge.speed_rad_per_s)
    knocked = (ridge.time_s > 0.95) & (ridge.time_s < 1.25)

    assert np.all(estimated[~knocked])
    assert not np.any(estimated[(ridge.time_s > 1.05) & (ridge.time_s < 1.15)])
    np.testing.assert_allclose(ridge.speed_rad_per_s[estimated], 1500, rtol=0.01)


def test_a_ridge_where_blade_pass_may_fold_is_refused_unless_slower_rotors_are_expected() -> None:
    time = np.arange(2 * HZ) / HZ
    seventh = slice(None, None, 7)  # 1000 samples a second
    wrench = rotating(1200 * time)[seventh]
    with pytest.raises(FitError, match="blade pass of a rotor above 1571 rad/s folds back"):
        speed_ridge(time_s=time[seventh], wrench=wrench, window_s=0.2, step_s=0.1)
    ridge = speed_ridge(
        time_s=time[seventh], wrench=wrench, window_s=0.2, step_s=0.1, expected_rad_per_s=(400.0, 1500.0)
    )

    np.testing.assert_allclose(ridge.speed_rad_per_s, 1200, rtol=1e-3)
