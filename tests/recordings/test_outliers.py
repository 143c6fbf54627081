"""Which readings are faults of a sensor: single ones, segments that jump off and back, and a value that stays."""

import math

import numpy as np
import numpy.typing as npt
import pytest

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
