"""Lags of rotors on a battery that sags under load, with a voltage that is read less often than speeds change."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.motors.lag import fit as fit_lag
from cfid.motors.lag.data import rotor_log
from cfid.records.result import Result
from tests.motors.rotor_logs import NOISE, RPM, off
from tests.motors.test_repeated_speeds import sagging

Array = npt.NDArray[np.float64]

RATE_HZ, ROWS = 500, 10_000


def driven(seed: int, rotors: int) -> tuple[Array, pd.DataFrame, Array]:
    """Return times (n,), commands and speeds of rotors for 20 s, and the volts (n,) that a sensor reads."""
    rng, time_s = np.random.default_rng(seed), np.arange(ROWS) / RATE_HZ
    commands = np.round(rng.uniform(15000, 55000, (rotors, 1 + ROWS // 175))).repeat(175, axis=1)[:, :ROWS]
    speeds, volts = sagging(commands)
    shown_rpm = np.round(RPM * (speeds + rng.normal(0, NOISE, speeds.shape)))
    columns = {f"motor.m{motor}": command for motor, command in enumerate(commands, start=1)}
    columns |= {f"rpm.m{motor}": rpm for motor, rpm in enumerate(shown_rpm, start=1)}
    return time_s, pd.DataFrame(columns), np.round(volts + rng.normal(0, 0.004, ROWS), 3)


def fitted(folder: Path, log: pd.DataFrame) -> Result:
    log.to_csv(folder / "log.csv", index=False)
    found = rotor_log(folder / "log.csv")
    assert found is not None
    return fit_lag(found)


@pytest.mark.parametrize(
    ("every", "seeds"), [(1, (3,)), *(pytest.param(every, (3, 4, 5), marks=pytest.mark.slow) for every in (1, 10, 25))]
)
def test_a_battery_that_one_rotor_alone_draws_down_does_not_bias_its_lag(
    tmp_path: Path, every: int, seeds: tuple[int, ...]
) -> None:
    """With a voltage every 20 ms, rates were 2 % too high, or 8 to 10 standard uncertainties."""
    worst = []
    for seed in seeds:
        time_s, log, volts = driven(seed, 1)
        read = np.where(np.arange(ROWS) % every == 0, volts, np.nan)
        worst.append(max(off(fitted(tmp_path, log.assign(t=time_s, **{"pm.vbat": read})))))
    print(worst)
    assert max(worst) < 3


@pytest.mark.parametrize("seeds", [(3,), pytest.param((4, 5, 6), marks=pytest.mark.slow)])
def test_blocks_of_a_log_at_rates_of_their_own_give_the_lag(tmp_path: Path, seeds: tuple[int, ...]) -> None:
    """Commands every 10 ms, speeds every 20 ms between them, and the voltage every 100 ms are joined by their times."""
    worst = []
    for seed in seeds:
        time_s, log, volts = driven(seed, 4)
        log = log.assign(t=time_s, **{"pm.vbat": volts})
        names = [f"{what}.m{motor}" for what in ("motor", "rpm") for motor in range(1, 5)]
        for columns, rows in (((*names[:4],), slice(0, None, 5)), ((*names[4:],), slice(1, None, 10))):
            other = np.ones(ROWS, dtype=bool)
            other[rows] = False
            log.loc[other, list(columns)] = np.nan
        other = np.ones(ROWS, dtype=bool)
        other[3::50] = False
        log.loc[other, "pm.vbat"] = np.nan
        worst.append(max(off(fitted(tmp_path, log.dropna(how="all", subset=[*names, "pm.vbat"])))))
    print(worst)
    assert max(worst) < 3
