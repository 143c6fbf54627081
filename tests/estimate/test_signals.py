"""Spectra, means in the presence of lines and spikes, and their uncertainties."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from cfid.estimate.signals import (
    find_spikes,
    quiet_mean,
)

Array = npt.NDArray[np.float64]

RATE_HZ = 1000.0


def white(windows: int, seconds: float, *, seed: int = 1) -> Array:
    return np.random.default_rng(seed).standard_normal((windows, round(seconds * RATE_HZ)))


def line(series: Array, *, frequency_hz: float, amplitude: float, seed: int = 2) -> Array:
    phase = np.random.default_rng(seed).uniform(0, 2 * math.pi, (len(series), 1))
    time_s = np.arange(series.shape[1]) / RATE_HZ
    return amplitude * np.cos(2 * math.pi * frequency_hz * time_s + phase)


def filtered(series: Array, kept: float) -> Array:
    return np.asarray(lfilter([1], [1, -kept], series, axis=1), np.float64)


def coverage(series: Array) -> float:
    mean = quiet_mean(series, rate_hz=RATE_HZ)
    return float(np.mean(np.abs(mean.value) < 1.96 * mean.std))


@pytest.mark.parametrize("seconds", [0.3, 1.0, 3.6])
@pytest.mark.parametrize("amplitude", [0.0, 20.0])
def test_the_interval_of_a_mean_covers_among_noise_and_lines(seconds: float, amplitude: float) -> None:
    noise = white(1500, seconds)

    assert 0.93 <= coverage(noise + line(noise, frequency_hz=83.3, amplitude=amplitude)) <= 0.975


def test_two_readings_alone_give_an_interval_that_covers() -> None:
    assert 0.93 <= coverage(np.random.default_rng(5).standard_normal((4000, 2))) <= 0.97


def test_the_interval_of_a_mean_still_covers_among_noise_that_is_slower_than_a_sample() -> None:
    kept = math.exp(-1 / (0.02 * RATE_HZ))

    assert 0.91 <= coverage(filtered(white(1000, 4.6), kept)[:, 1000:]) <= 0.97


@given(frequency_hz=st.floats(60, 480), phase=st.floats(0, 6.3))
def test_a_line_moves_a_quiet_mean_a_hundred_times_less_than_it_may_move_a_plain_one(
    frequency_hz: float, phase: float
) -> None:
    series = np.cos(2 * np.pi * frequency_hz / RATE_HZ * np.arange(3600.0) + phase)

    assert abs(quiet_mean(series, rate_hz=RATE_HZ).value) < 0.01 / (math.pi * frequency_hz * 3.6)


def test_a_mean_is_that_of_the_middle_of_a_slope_and_tells_the_slope() -> None:
    mean = quiet_mean(3 + 0.5 / RATE_HZ * np.arange(2001.0), rate_hz=RATE_HZ)

    assert mean.value == pytest.approx(3.5)
    assert mean.slope == pytest.approx(0.5)


def test_white_noise_has_as_many_effective_samples_as_there_are_and_correlated_noise_has_fewer() -> None:
    kept = 0.9
    noise = white(300, 4.6)
    slow = filtered(noise, kept)[:, 1000:]

    plain, correlated = (quiet_mean(each, rate_hz=RATE_HZ).effective_samples for each in (noise[:, 1000:], slow))
    assert np.median(plain) == pytest.approx(3600, rel=0.15)
    assert np.median(correlated) == pytest.approx(3600 * (1 - kept) / (1 + kept), rel=0.2)


def test_lone_and_paired_spikes_are_found_with_what_stands_beside_them() -> None:
    rows = white(2, 2.0)
    rows[0, 700] += 40
    rows[1, 1200:1202] += [-25, 60]
    rows[1, 1990] = 30

    row, place, instead = find_spikes(rows, length=300)
    found = dict(zip(zip(row.tolist(), place.tolist(), strict=True), instead, strict=True))
    assert set(found) == {(0, 700), (1, 1200), (1, 1201), (1, 1990)}
    assert found[0, 700] == pytest.approx((rows[0, 699] + rows[0, 701]) / 2)
    assert found[1, 1200] == found[1, 1201] == pytest.approx((rows[1, 1199] + rows[1, 1202]) / 2)


@pytest.mark.parametrize("rate_over_frequency", [3.0, 4.0, 6.0, 2.1, 17.3])
def test_a_line_is_no_spike_however_it_is_sampled(rate_over_frequency: float) -> None:
    turns = np.arange(4000) / rate_over_frequency
    vibration = np.cos(2 * np.pi * turns) + 0.5 * np.cos(np.pi * turns)

    assert len(find_spikes((vibration + 0.01 * white(1, 4.0)[0])[np.newaxis], length=200)[0]) == 0


def test_a_step_and_the_start_of_vibration_are_no_spikes() -> None:
    time_s = np.arange(4000) / RATE_HZ
    running = time_s > 1.9995
    rows = 0.01 * white(1, 4.0) + running * (1 + 1.5 * np.cos(2 * np.pi * 240 * time_s))

    assert len(find_spikes(rows, length=200)[0]) == 0
