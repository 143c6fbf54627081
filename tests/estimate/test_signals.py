"""Spectra, means in the presence of lines and spikes, and their uncertainties."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from cfid.estimate.blocks import block_means
from cfid.estimate.signals import (
    Runs,
    cosine_taper,
    density_near_zero,
    detrended,
    effective_samples,
    find_spikes,
    quiet_mean,
    slowed,
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


def test_the_taper_is_hanns_or_flat_but_for_its_ends_and_always_sums_to_one() -> None:
    hann, flat = cosine_taper(100, share=1.0), cosine_taper(100, share=0.2)

    np.testing.assert_allclose(hann, np.sin(np.pi * (np.arange(100) + 0.5) / 100) ** 2 / 50)
    assert np.ptp(flat[10:90]) == 0
    assert hann.sum() == pytest.approx(1)
    assert flat.sum() == pytest.approx(1)


@pytest.mark.parametrize("seconds", [0.5, 3.6])
def test_the_density_of_white_noise_is_its_variance_over_the_rate(seconds: float) -> None:
    density, freedom = density_near_zero(detrended(7 * white(1000, seconds))[0], rate_hz=RATE_HZ)

    assert density.mean() == pytest.approx(49 / RATE_HZ, rel=0.07)  # some have red noise by chance
    # A mean of squares with f degrees of freedom scatters by sqrt(2 / f).
    assert np.std(density / density.mean()) == pytest.approx(math.sqrt(2 / freedom.mean()), rel=0.25)


@pytest.mark.parametrize("frequency_hz", [60.3, 147.1, 476.2])
def test_strong_lines_of_rotors_do_not_change_the_density_near_zero(frequency_hz: float) -> None:
    noise = white(200, 3.6)
    lines = line(noise, frequency_hz=frequency_hz, amplitude=50.0)

    alone, among = (density_near_zero(detrended(each)[0], rate_hz=RATE_HZ)[0] for each in (noise, noise + lines))
    assert among.mean() == pytest.approx(alone.mean(), rel=0.02)


def test_noise_that_is_correlated_has_a_higher_density_near_zero_than_its_variance_tells() -> None:
    kept = math.exp(-1 / (0.02 * RATE_HZ))
    noise = filtered(white(300, 11), kept)[:, 1000:]

    density = density_near_zero(detrended(noise)[0], rate_hz=RATE_HZ)[0]
    assert density.mean() == pytest.approx(1 / (1 - kept) ** 2 / RATE_HZ, rel=0.1)


def test_too_short_a_window_has_no_density() -> None:
    density, freedom = density_near_zero(white(1, 0.05), rate_hz=RATE_HZ)

    assert np.isnan(density).all()
    assert freedom.tolist() == [0]


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


def test_there_are_never_more_effective_samples_than_samples() -> None:
    strong = line(white(50, 2.0), frequency_hz=83.3, amplitude=9.0)

    assert (effective_samples(strong, std_of_mean=np.full(50, 1e-9)) == 2000).all()


def test_block_means_are_those_of_each_block_of_each_channel() -> None:
    channels = white(2, 1.003)

    np.testing.assert_allclose(block_means(channels, length=7), channels[:, :1001].reshape(2, 143, 7).mean(axis=2))


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


def test_a_hundred_thousand_normal_samples_hold_no_spike() -> None:
    assert len(find_spikes(white(10, 10.0), length=200)[0]) <= 1


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


def test_smoothing_keeps_a_slow_series_and_suppresses_lines() -> None:
    time_s = np.arange(3000) / RATE_HZ
    slow_only = slowed(time_s, time_s**2, rate_hz=RATE_HZ)
    vibration = slowed(time_s, np.cos(2 * np.pi * 147 * time_s), rate_hz=RATE_HZ)

    assert slow_only.value[10:-10] == pytest.approx(slow_only.time_s[10:-10] ** 2, abs=1e-3)
    assert np.abs(vibration.value[10:-10]).max() < 0.01


def test_a_run_of_a_line_has_its_slope_and_nothing_about_it() -> None:
    runs = Runs.of(2 + 0.25 * np.arange(8.0), fewest=3)

    assert len(runs.slope) == 21
    assert runs.slope == pytest.approx(0.25)
    assert runs.wave == pytest.approx(0, abs=1e-7)


def test_neighbours_of_white_noise_are_not_alike_and_those_of_a_wave_are() -> None:
    noise = white(400, 0.016)
    wave = 3 * np.sin(np.arange(16) / 2)

    ratios = np.array([[Runs.of(series, fewest=16).alike[0] for series in (each, each + wave)] for each in noise])
    assert np.mean(ratios[:, 0] > 3) < 0.01
    assert np.mean(ratios[:, 1] > 2) > 0.7
