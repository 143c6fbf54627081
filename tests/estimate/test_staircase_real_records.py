"""Thrust-stand records that Bitcraze took of a Crazyflie 2.1 (IMRCLab/crazyflie-system-id): 100 Hz, grams.

The stand reports its weight ten times a second, a quarter of a second after the motors.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cfid.errors import FitError
from cfid.estimate.staircase import Point, Staircase, reduce_staircase
from tests.lab import DATA

STAND = DATA / "bitcraze_2021"
STEPS, RAMP = STAND / "cf21_stock2.csv", STAND / "cf2.1-stock-prop.csv"
RATE_HZ = 100.0
N_PER_G = 9.81e-3

needs_data = pytest.mark.skipif(not STEPS.exists(), reason="the public thrust-stand records are not here (CFID_DATA)")


def reduced(path: Path, *, logged: bool) -> tuple[pd.DataFrame, Staircase]:
    table = pd.read_csv(path)
    time_s = np.arange(len(table)) / RATE_HZ
    log = np.repeat(table[["pwm"]].to_numpy(float), 4, axis=1) if logged else None
    staircase = reduce_staircase(
        time_s=time_s,
        channels=table[["weight[g]"]].to_numpy(float),
        command_time_s=time_s if logged else None,
        commands=log,
        thrust=0,
    )
    return table, staircase


def thrust_ns2_per_rad2(table: pd.DataFrame, point: Point) -> float:
    """Return thrust over the sum of squared speeds, which are taken earlier by the delay of the thrust."""
    assert point.delay_s is not None
    rows = slice(*(round(RATE_HZ * (at_s - point.delay_s)) for at_s in (point.begin_s, point.end_s)))
    speed_rad_s = table.filter(regex="rpm").to_numpy(float)[rows] * 2 * np.pi / 60
    return float(N_PER_G * point.mean[0] / np.mean(np.sum(speed_rad_s**2, axis=1)))


@needs_data
def test_the_same_steps_are_found_with_and_without_the_log() -> None:
    found, seen = (reduced(STEPS, logged=logged)[1].points for logged in (True, False))

    assert [point.command for point in found] == [*range(15000, 45001, 5000), *range(40000, 4999, -5000)]
    assert len(seen) == len(found)
    pairs = [(one, other) for one, other in zip(found, seen, strict=True) if one.settled]
    assert all(abs(one.begin_s - other.begin_s) < 0.05 and abs(one.end_s - other.end_s) < 0.05 for one, other in pairs)
    assert all(other.settled for _, other in pairs)


@needs_data
def test_what_settles_within_a_second_gives_the_known_thrust_constant() -> None:
    table, staircase = reduced(STEPS, logged=True)
    settled = staircase.steady()

    assert [point.command for point in settled] == [30000, 35000, 40000, 45000, 40000]
    assert all(1.88e-8 < thrust_ns2_per_rad2(table, point) < 2.04e-8 for point in settled)


@needs_data
def test_two_readings_of_a_rest_are_a_tare_that_knows_how_little_it_is_worth() -> None:
    staircase = reduced(STEPS, logged=True)[1]

    assert staircase.tare_before.mean[0] == pytest.approx(-0.2, abs=0.2)
    assert 0.3 < staircase.tare_before.std[0] < 2
    assert staircase.tare_after is None


@needs_data
@pytest.mark.parametrize("logged", [True, False])
def test_a_ramp_of_short_steps_never_settles_and_that_is_said(logged: bool) -> None:
    staircase = reduced(RAMP, logged=logged)[1]

    assert not any(point.settled for point in staircase.points)
    with pytest.raises(FitError, match=r"none of \d+ steps settles"):
        staircase.steady()
