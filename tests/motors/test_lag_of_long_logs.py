"""Logs of more than five minutes are fitted in parts: what these have in common, no mean of them makes surer."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.motors.lag.estimation import LagFit, joined
from cfid.motors.lag.model import InputLag
from tests.campaigns import Cfid
from tests.motors.rotor_logs import FALLING_S, RISING_S, RPM

Array = npt.NDArray[np.float64]

TRUE = np.array([100.0, 2000.0, -300.0, 0.05, 0.08, 0.01])  # of the map, and of the lag in s


def part(rng: np.random.Generator, own: Array, common: Array, *, scatter: float, error: float) -> LagFit:
    """Return the fit of a part: its own errors are `scatter` times what it states, the common one `error` times."""
    found = TRUE + scatter * own * rng.normal(size=6) + common[:, 0] * error
    return LagFit(
        lag=InputLag(*found[3:].tolist()), covariance=np.diag(own**2) + common @ common.T,
        map=(found[0], found[1], found[2]), explained=0.99, rms=1.0, drift=0.0, time_s=np.arange(4.0),
        measured=np.ones(4), shown=rng.normal(size=4), findings=(), effects=common,
    )  # fmt: skip


def test_an_error_that_parts_share_stays_in_their_mean() -> None:
    """An uncertainty of 1 ms in common and one of 0.1 ms in each of six parts was stated as 0.4 ms, or as none."""
    rng, own = np.random.default_rng(0), np.array([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4])
    common = np.array([[0.0], [0.0], [0.0], [1e-3], [1e-3], [0.0]])
    for scatter in (1.0, 2.0):
        in_std = []
        for _ in range(1000):
            error = float(rng.normal())
            fit = joined([part(rng, own, common, scatter=scatter, error=error) for _ in range(6)])
            in_std.append((fit.lag.rising_s - TRUE[3]) / fit.std_s.rising_s)
        assert 0.93 < np.std(in_std) < 1.07


def fitted(cfid: Cfid, *options: str) -> Any:
    ended = cfid("fit", "dynamics", "log.csv", *options, "--no-figures", "--json")
    assert ended.returncode == 0, ended.stderr
    (row,) = json.loads(ended.stdout)["parameters"]["dynamics.map"]["value"]
    return row


def test_a_long_log_states_the_uncertain_power_of_the_voltage_as_its_first_part_does(
    cfid: Cfid, tmp_path: Path
) -> None:
    """A battery that hardly sags does not show how speeds go with its voltage, however long the log is."""
    rng, step_s, minutes = np.random.default_rng(1), 0.004, 11
    count, held = int(60 * minutes / step_s), int(0.5 / step_s)
    command = np.repeat(np.round(rng.uniform(20000, 50000, count // held + 1)), held)[:count]
    rising, falling = np.exp(-step_s / np.array([RISING_S, FALLING_S])).tolist()
    speed, volts, now = np.empty(count), np.empty(count), 1000.0
    for place, (drive, full_v) in enumerate(zip(command / 65535, np.linspace(4.1, 3.9, count), strict=True)):
        volts[place], speed[place] = full_v - 0.01 * (now / 2000) ** 2, now
        leads_to = 100 + 2600 * drive * volts[place] / 3.9
        now = leads_to + (now - leads_to) * (rising if leads_to > now else falling)
    rows = slice(None, None, 5)
    shown, time_s = speed[rows], step_s * np.arange(count)[rows]
    table = {"t": time_s, "motor.m1": command[rows], "rpm.m1": np.round(RPM * (shown + rng.normal(0, 8, len(shown))))}
    table["pm.vbat"] = np.round(volts[rows] + rng.normal(0, 0.004, len(shown)), 3)
    pd.DataFrame(table).to_csv(tmp_path / "log.csv", index=False)
    whole, first = fitted(cfid), fitted(cfid, "--to", "290")

    assert abs(whole["c1"] - 2600 / 3.9) < 2 * whole["std_c1"]
    assert whole["std_c1"] > 0.9 * first["std_c1"]
