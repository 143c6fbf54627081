"""Rows that a log lost, in which commands changed unseen, bias no time constant and are named."""

from itertools import accumulate
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.records.result import Result
from tests.motors.rotor_logs import RPM, fit_of, following, off

Array = npt.NDArray[np.float64]

ROWS = 10_000  # in 20 s


def always(rng: np.random.Generator) -> Array:
    """Return commands (n,) that change at random in each row."""
    each = list(accumulate(rng.normal(0, 0.28, ROWS), lambda now, new: 0.96 * now + new))
    return np.asarray(np.round(np.clip(35000 + 8000 * np.array(each), 10000, 60000)))


def at_times(rng: np.random.Generator) -> Array:
    """Return commands (n,) that are each held for about a quarter of a second."""
    held = np.searchsorted(rng.integers(60, 200, 200).cumsum(), np.arange(ROWS), side="right")
    return np.asarray(np.round(rng.uniform(15000, 55000, 201))[held])


def fitted(folder: Path, command: Array, lost: npt.NDArray[np.bool_], rng: np.random.Generator) -> Result:
    """Fit a log at 500 Hz without the rows (n,) that were lost."""
    time_s = np.arange(ROWS) / 500
    speed = following(time_s, 400 + 0.033 * command, time_s) + rng.normal(0, 1.5, ROWS)
    volts = np.round(4 + rng.normal(0, 0.004, ROWS), 3)
    columns = {"t": time_s, "motor.m1": command, "rpm.m1": np.round(RPM * speed), "pm.vbat": volts}
    return fit_of(folder, pd.DataFrame(columns)[~lost])


def named(result: Result) -> list[str]:
    return [one.sentence for one in result.findings if one.code == "lag-rows-missing"]


def test_what_follows_gaps_of_rows_is_left_out_and_gaps_are_named(tmp_path: Path) -> None:
    """In 20 s, 30 gaps of 40 ms are missing, and the command changed 20 times in each gap."""
    rng = np.random.default_rng(3)
    lost = np.zeros(ROWS, bool)
    for first in 600 + 300 * np.arange(30):
        lost[first : first + 19] = True
    result = fitted(tmp_path, always(rng), lost, rng)

    assert max(off(result, widest=0.002)) < 3
    assert named(result)[0].startswith("30 gaps of rows, 1.2 s together, the longest 40 ms: ")


def test_a_step_of_the_command_in_a_gap_moves_no_lag(tmp_path: Path) -> None:
    """Every fifth step falls in a gap, 10 ms after the gap starts; the row after the gap shows the step 20 ms late."""
    rng = np.random.default_rng(4)
    command, lost = at_times(rng), np.zeros(ROWS, bool)
    for step in np.flatnonzero(np.diff(command))[4::5]:
        lost[step - 4 : step + 11] = True

    assert max(off(fitted(tmp_path, command, lost, rng), widest=0.003)) < 3


def test_gaps_so_dense_that_little_is_left_are_followed_for_a_shorter_time(tmp_path: Path) -> None:
    """Some rows are missing every 200 ms, which is shorter than three time constants."""
    rng = np.random.default_rng(5)
    lost = (np.arange(ROWS) % 100 >= 95) & (np.arange(ROWS) > 500)
    result = fitted(tmp_path, always(rng), lost, rng)

    assert max(off(result, widest=0.01)) < 3
    assert len(named(result)) == 1


@pytest.mark.parametrize("every", [2, 3])
def test_rows_that_come_evenly_or_in_turns_are_no_gaps(tmp_path: Path, every: int) -> None:
    """A log without every second or third row has rows 4 ms apart, or alternately 2 and 4 ms apart."""
    rng = np.random.default_rng(6)
    result = fitted(tmp_path, at_times(rng), np.arange(ROWS) % every == 1, rng)

    assert not named(result)
