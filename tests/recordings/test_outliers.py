"""Which readings are faults of a sensor: single ones, segments that jump off and back, and a value that stays."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.recordings.outliers import offset_segments, outliers, stuck

Array = npt.NDArray[np.float64]

TURN = 2 * math.pi
COUNT = TURN / 8192


def swinging(rate_hz: float) -> tuple[Array, Array]:
    """Return a swing of 20 s that decays from one radian."""
    time_s = np.arange(0, 20, 1 / rate_hz)
    return time_s, np.exp(-time_s / 20) * np.cos(8 * time_s)


def places(mask: npt.NDArray[np.bool_]) -> list[int]:
    return np.flatnonzero(mask).tolist()


@pytest.mark.parametrize("off_rad", [0.3, 3.0, -2.0])
@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("rate_hz", [100, 500, 1000])
def test_up_to_three_readings_off_a_swing_are_outliers(rate_hz: float, wrapped: bool, off_rad: float) -> None:
    """Also the first and the last one, and those on a circle."""
    _, angle = swinging(rate_hz)
    rows = [0, 9, 666, 667, 1000, 1001, 1002, len(angle) - 1]
    angle[rows] += off_rad
    values, period = (angle % TURN, TURN) if wrapped else (angle, None)
    assert places(outliers(values, 0.1, period=period)) == rows


@pytest.mark.parametrize("rate_hz", [24, 100, 1000])
def test_a_swing_has_no_outliers(rate_hz: float) -> None:
    _, angle = swinging(rate_hz)
    assert not outliers(angle, 0.1).any()
    assert not outliers(angle % TURN, 0.1, period=TURN).any()


def test_readings_next_to_an_outlier_of_a_fast_turn_stay() -> None:
    angle = 0.2 * np.arange(3000.0) % TURN
    angle[[500, 1500, 1501]] += 1.0
    assert places(outliers(angle % TURN, 0.1, period=TURN)) == [500, 1500, 1501]


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


def test_missing_readings_are_no_outliers() -> None:
    _, angle = swinging(100)
    angle[[300, 301]] = np.nan
    angle[700] += 1.0
    assert places(outliers(angle, 0.1)) == [700]


def test_a_segment_between_a_jump_and_one_back_is_off() -> None:
    _, angle = swinging(1000)
    angle[5000:5120] += 0.7
    assert places(offset_segments(angle, 0.1)) == list(range(5000, 5120))
    assert not offset_segments(angle[:5060], 0.1).any()  # it never jumps back


def test_a_voltage_that_sags_under_load_is_no_offset_and_one_that_halves_is() -> None:
    volts = np.full(1000, 4.2)
    volts[400:450] = 3.4
    assert not offset_segments(volts, most_share=0.1).any()
    volts[700:750] = 2.0
    assert places(offset_segments(volts, most_share=0.1)) == list(range(700, 750))


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
