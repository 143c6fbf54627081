"""Commands that change between two rows of a log bias no time constant, in any order of early and late changes."""

import math
from itertools import accumulate
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from cfid.motors.lag.between_rows import mixed_share
from cfid.motors.lag.model import Signal
from cfid.records.result import Result
from tests.motors.rotor_logs import RISING_S, RPM, fit_of, following, off

Array = npt.NDArray[np.float64]


def fitted(folder: Path, change_s: Array, *, row_s: float, every: int, seed: int) -> Result:
    """Fit 20 s of two rotors whose commands change at the same times; one in `every` rows has speeds."""
    rng, time_s = np.random.default_rng(seed), np.arange(0.002, 20, row_s)
    read = np.arange(len(time_s)) % every == 0
    columns = {"t": time_s, "pm.vbat": np.round(4 + rng.normal(0, 0.004, len(time_s)), 3)}
    for motor in (1, 2):
        command = np.round(rng.uniform(15000, 55000, len(change_s)))
        speed = following(change_s, 400 + 0.033 * command, time_s) + rng.normal(0, 1.5, len(time_s))
        columns[f"motor.m{motor}"] = command[np.searchsorted(change_s, time_s + 1e-9, side="right") - 1]
        columns[f"rpm.m{motor}"] = np.where(read, np.round(RPM * speed), np.nan)
    return fit_of(folder, columns)


@pytest.mark.parametrize("seed", [21, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (22, 23))])
def test_changes_that_come_late_in_step_with_the_readings_give_the_lag(tmp_path: Path, seed: int) -> None:
    """Every second change appears 2 ms late, and these are the changes that a reading follows soonest."""
    result = fitted(tmp_path, np.arange(0, 20, 0.35), row_s=0.004, every=5, seed=seed)
    delay = result.quantities["dynamics.delay_s"]

    assert max(off(result, widest=0.004)) < 3
    assert abs(delay.value) < 2 * delay.std


@pytest.mark.parametrize("every", [1, 2])
def test_changes_at_any_time_in_rows_of_10_ms_give_the_lag(tmp_path: Path, every: int) -> None:
    change_s = np.append(0, np.random.default_rng(5).uniform(0.17, 0.52, 60).cumsum())
    result = fitted(tmp_path, change_s, row_s=0.01, every=every, seed=5)

    assert max(off(result, widest=0.006)) < 3
    assert any(one.code == "lag-command-between-rows" for one in result.findings)


def controlled(folder: Path, *, every_s: float, correlated_s: float, row_s: float, noise: float = 0.0) -> Result:
    """Fit 40 s of four rotors whose controller changes commands at random; each value of `noise` lasts one step."""
    time_s, change_s = np.arange(0, 40, row_s), np.arange(0, 40, every_s)
    kept = np.exp(-every_s / correlated_s)
    columns = {"t": time_s, "pm.vbat": np.full(len(time_s), 4.0)}
    for motor in (1, 2, 3, 4):
        rng = np.random.default_rng(motor)
        pushes = rng.normal(0, np.sqrt(1 - kept**2), len(change_s))
        each = np.array(list(accumulate(pushes, lambda now, new: kept * now + new)))
        jitter = noise * rng.normal(size=len(change_s)) if noise else np.zeros(len(change_s))
        command = np.asarray(np.clip(35000 + 8000 * each + jitter, 10000, 60000).round(), np.float64)
        speed = following(np.append(0, change_s[1:] + 0.006), 400 + 0.033 * command, time_s)
        speed += rng.normal(0, 8, len(time_s))
        columns[f"motor.m{motor}"] = command[np.searchsorted(change_s, time_s + 1e-9, side="right") - 1]
        columns[f"rpm.m{motor}"] = np.round(RPM * speed)
    return fit_of(folder, columns)


@pytest.mark.parametrize(
    ("every_s", "correlated_s", "row_s"),
    [
        pytest.param(0.002, 0.02, 0.01, marks=pytest.mark.slow),
        pytest.param(0.002, 0.05, 0.01, marks=pytest.mark.slow),
        (0.004, 0.05, 0.02),
    ],
)
def test_commands_that_change_in_all_rows_and_between_them_leave_the_lag_within_its_uncertainty(
    tmp_path: Path, every_s: float, correlated_s: float, row_s: float
) -> None:
    """Rows show one command in five, and the rising and falling lags come out too similar; both were 10 % too long."""
    result = controlled(tmp_path, every_s=every_s, correlated_s=correlated_s, row_s=row_s)
    (found,) = (one for one in result.findings if one.code == "lag-command-between-rows")

    assert max(off(result, widest=0.15)) < 2
    assert {"dynamics.rising", "dynamics.falling", "dynamics.delay_s"} == set(found.quantities)
    assert "nearer to each other by" in found.sentence
    assert "taken as straight in between" in found.sentence


def test_commands_that_alternate_from_row_to_row_have_a_finite_share() -> None:
    """Their mean squared change is four times their variance, which is the maximum."""
    command = Signal(np.arange(0, 20, 0.01), np.tile([0.4, 0.6], 1000))
    assert 1 < mixed_share(command) < 3


@pytest.mark.parametrize("row_s", [0.01, pytest.param(0.02, marks=pytest.mark.slow)])
def test_noise_that_commands_have_within_a_row_is_in_the_uncertainty_of_the_lag(tmp_path: Path, row_s: float) -> None:
    """The noise makes time constants too long: a row shows the noise of one step, but its mean has hardly any."""
    result = controlled(tmp_path, every_s=0.002, correlated_s=0.5, row_s=row_s, noise=2000)

    assert 0.7 < result.quantities["dynamics.rising"].value[0] * RISING_S < 0.9
    assert max(off(result, widest=0.3)) < 2


def test_commands_of_a_controller_as_slow_as_rows_leave_the_lag_within_its_uncertainty(tmp_path: Path) -> None:
    """Each command is held from row to row, so nothing changes in between."""
    result = controlled(tmp_path, every_s=0.02, correlated_s=0.05, row_s=0.02)
    delay = result.quantities["dynamics.delay_s"]

    assert max(off(result, widest=0.15)) < 1
    assert (
        abs(delay.value - 0.006) < 0.011
    )  # a change may lie anywhere in the row before, up to half a row off its middle
    assert delay.std == pytest.approx(0.02 / math.sqrt(12), rel=0.05)
