"""Commands that change between two rows of a log move no time constant, in whatever order early and late ones come."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.motors.lag import fit
from cfid.motors.lag.data import rotor_log
from cfid.records.result import Result
from tests.motors.test_repeated_speeds import RPM, TRUTH, following

Array = npt.NDArray[np.float64]


def fitted(folder: Path, change_s: Array, *, row_s: float, every: int, seed: int) -> Result:
    """Fit 20 s of two rotors whose commands change at the same times, with speeds in one of `every` rows."""
    rng, time_s = np.random.default_rng(seed), np.arange(0.002, 20, row_s)
    read = np.arange(len(time_s)) % every == 0
    columns = {"t": time_s, "pm.vbat": np.round(4 + rng.normal(0, 0.004, len(time_s)), 3)}
    for motor in (1, 2):
        command = np.round(rng.uniform(15000, 55000, len(change_s)))
        speed = following(change_s, 400 + 0.033 * command, time_s) + rng.normal(0, 1.5, len(time_s))
        columns[f"motor.m{motor}"] = command[np.searchsorted(change_s, time_s + 1e-9, side="right") - 1]
        columns[f"rpm.m{motor}"] = np.where(read, np.round(RPM * speed), np.nan)
    pd.DataFrame(columns).to_csv(folder / "log.csv", index=False)
    log = rotor_log(folder / "log.csv")
    assert log is not None
    return fit(log)


def off(result: Result, *, widest: float) -> list[float]:
    """Return by how many standard uncertainties rates are off, which are at most a part `widest` of them."""
    found = [(result.quantities[f"dynamics.{way}"], tau_s) for way, tau_s in TRUTH]
    assert all(one.std[0] < widest / tau_s for one, tau_s in found)
    return [abs(one.value[0] - 1 / tau_s) / one.std[0] for one, tau_s in found]


@pytest.mark.parametrize("seed", [21, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (22, 23))])
def test_changes_that_come_late_in_step_with_the_readings_give_the_lag(tmp_path: Path, seed: int) -> None:
    """Every second one shows 2 ms late, and those are the ones after which a reading comes soonest."""
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
