"""Which readings are faults of a sensor: single ones, segments that jump off and back, and a value that stays."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.recordings import supply
from cfid.recordings.outliers import outliers, stuck

Array = npt.NDArray[np.float64]

COUNT = 2 * math.pi / 8192


def swinging(rate_hz: float) -> tuple[Array, Array]:
    """Return a swing of 20 s that decays from one radian."""
    time_s = np.arange(0, 20, 1 / rate_hz)
    return time_s, np.exp(-time_s / 20) * np.cos(8 * time_s)


def places(mask: npt.NDArray[np.bool_]) -> list[int]:
    return np.flatnonzero(mask).tolist()


@pytest.mark.parametrize("off_rad", [0.3, 3.0, -2.0])
@pytest.mark.parametrize("rate_hz", [100, 1000])
def test_up_to_three_readings_off_a_swing_are_outliers(rate_hz: float, off_rad: float) -> None:
    """Also the first and the last one."""
    _, angle = swinging(rate_hz)
    rows = [0, 9, 666, 667, 1000, 1001, 1002, len(angle) - 1]
    angle[rows] += off_rad
    assert places(outliers(angle, 0.1)) == rows


def test_noise_and_steps_have_no_outliers() -> None:
    random = np.random.default_rng(1)
    noise = random.standard_normal(100_000)
    steps = np.repeat(random.uniform(0, 5, 60), 400) + 0.02 * random.standard_normal(24_000)
    assert not outliers(noise).any()
    assert not outliers(steps).any()
    steps[[77, 5000, 5001]] = 9.0
    assert places(outliers(steps)) == [77, 5000, 5001]


def test_readings_far_beyond_all_others_are_outliers_in_any_number() -> None:
    noise = np.random.default_rng(1).standard_normal(10_000)
    noise[4000:4050] = 1e6
    assert places(outliers(noise)) == list(range(4000, 4050))


def test_more_than_one_reading_in_a_hundred_is_no_fault() -> None:
    _, angle = swinging(100)
    angle[5::50] += 1.0
    assert not outliers(angle, 0.1).any()


def test_an_encoder_that_repeats_one_value_in_motion_is_stuck() -> None:
    time_s, angle = swinging(1000)
    angle = COUNT * np.rint(angle / COUNT)
    angle[5000:5120] = angle[5000]
    assert places(stuck(angle, time_s)) == list(range(5000, 5120))
    assert places(stuck(angle)) == list(range(5000, 5120))
    assert not stuck(angle, 1e-4 * time_s).any()  # 12 ms change nothing


def test_a_body_at_rest_is_not_stuck() -> None:
    """Its readings go on from the value that they repeat."""
    time_s = np.arange(0, 20, 1e-3)
    angle = COUNT * np.rint(np.exp(-time_s / 3) * np.cos(8 * time_s) / COUNT)
    assert not stuck(angle, time_s).any()


def test_a_sensor_that_is_slower_than_its_rows_is_not_stuck() -> None:
    time_s, angle = swinging(1000)
    assert not stuck(np.repeat(angle[::40], 40), time_s).any()


# Supply voltages, of one to twelve cells and bench supplies


ROWS = 4000


def battery(cells: float, *, sag: float = 0.3) -> Array:
    """Return the voltage of lithium cells that discharge under loads that change from one row to the next."""
    rng = np.random.default_rng(4)
    load = np.repeat(rng.uniform(0, 1, ROWS // 20) ** 2, 20)
    return np.asarray(cells * (np.linspace(4.3, 3.7, ROWS) - sag * 3.7 * load + rng.normal(0, 0.01, ROWS)))


@pytest.mark.parametrize("cells", [1, 4, 12])
def test_a_battery_that_gives_way_by_a_third_under_load_keeps_every_voltage(cells: int) -> None:
    assert not supply.impossible(battery(cells)).any()


@pytest.mark.parametrize(
    "volts",
    [
        np.linspace(3.0, 25.0, ROWS),
        np.repeat(np.arange(2.0, 18.0, 2.0), ROWS // 8),
        np.tile(np.repeat([12.0, 4.0], [80, 20]), ROWS // 100),
    ],
    ids=["swept", "in steps", "switched"],
)
def test_a_supply_that_is_set_to_other_voltages_keeps_them(volts: Array) -> None:
    assert not supply.impossible(volts + np.random.default_rng(4).normal(0, 0.01, len(volts))).any()


@pytest.mark.parametrize(("cells", "times"), [(1, 0.3), (6, 2.0)])
@pytest.mark.parametrize(("begin", "count"), [(0, 1), (1000, 350), (ROWS - 30, 30)])
def test_voltages_that_jump_far_off_the_others_and_back_are_impossible(
    cells: int, times: float, begin: int, count: int
) -> None:
    volts = battery(cells)
    volts[begin : begin + count] = times * 3.8 * cells
    assert np.array_equal(np.flatnonzero(supply.impossible(volts)), np.arange(begin, begin + count))


def test_voltages_that_are_noise_for_a_while_and_those_beyond_any_battery_are_impossible() -> None:
    volts = battery(3)
    volts[500:600] = np.random.default_rng(2).uniform(20.0, 59.0, 100)
    volts[2000:2003] = 0.0, 1e300, -5.0
    volts[3000:3010] = np.nan
    assert np.array_equal(np.flatnonzero(supply.impossible(volts)), [*range(500, 600), 2000, 2001, 2002])
    assert supply.usual(volts, supply.impossible(volts)) == pytest.approx(12.0, rel=0.1)
    assert not supply.impossible(np.full(3, np.nan)).any()
    assert supply.impossible(np.zeros(3)).all()
