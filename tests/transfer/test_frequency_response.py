"""The plant's response at the frequency of a sine run, and its uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.sim.propulsion import RotorTruth
from cfid.transfer.alignment import SineRun, align
from cfid.transfer.frequency_response import Response, respond
from tests.offline.sine_bench import Bench, simulate_sines
from tests.transfer.sine_recordings import GAIN_N, LAG_S, STILL, exact, noiseless_bench, recorded, simulated

B0, A1 = 6.0705967e-8, 0.9745210


def noisy(run: SineRun, noise_n: np.ndarray[tuple[int], np.dtype[np.float64]]) -> SineRun:
    return replace(run, force_n=run.force_n + noise_n)


def truth_at(response: Response) -> complex:
    """Return the response of the thesis' plant behind a hold, of the force at any instant."""
    laplace, half = 1j * response.frequency_rad_s, response.frequency_rad_s * response.sample_s / 2
    return complex(GAIN_N / (1 + laplace * LAG_S) * np.sinc(half / np.pi) * np.exp(-1j * half))


def test_a_drift_changes_nothing() -> None:
    run = align(recorded(simulated((3,), truth=STILL, bench=noiseless_bench(1000)))).runs[0]
    drift = 2e-3 * run.time_s - 1e-4 * run.time_s**2

    assert respond(noisy(run, drift)).value == pytest.approx(respond(run).value, rel=1e-9)


@pytest.mark.parametrize(
    ("periods", "colour"), [(3, "white"), (40, "white"), (40, "falling"), (3, "lines"), (40, "lines")]
)
def test_responses_scatter_as_they_say_in_noise_of_any_colour(periods: int, colour: str) -> None:
    run = align(recorded(simulated((periods,), truth=STILL, bench=noiseless_bench(1000)))).runs[0]
    rng = np.random.default_rng(periods)
    count = len(run.time_s)
    hertz = np.fft.rfftfreq(count, 1e-3)
    scores = []
    for _ in range(150):
        spectrum = np.fft.rfft(rng.normal(0, 5e-3, count))
        if colour == "falling":
            spectrum /= np.maximum(hertz, 0.02) ** 0.5
        noise = np.fft.irfft(spectrum, count)
        if colour == "lines":
            speed = rng.uniform(230, 260) + 40 * np.sin(2 * np.pi * periods / 8 * run.time_s)
            noise += 0.2 * np.sin(2 * np.pi * np.cumsum(speed) * 1e-3 + rng.uniform(0, 6))
        found = respond(noisy(run, noise))
        size_std, phase_std = found.polar_std
        turned = found.value / truth_at(found)
        scores.append([(abs(turned) - 1) * abs(found.value) / size_std, np.angle(turned) / phase_std])

    assert np.std(scores, axis=0) == pytest.approx([1, 1], abs=0.25)


def test_the_parts_of_a_response_covary_as_stated_where_less_than_a_period_was_measured() -> None:
    run = align(recorded(simulated((1,), truth=STILL, bench=noiseless_bench(1000)))).runs[0]
    rng = np.random.default_rng(9)
    found = [respond(noisy(run, rng.normal(0, 5e-3, len(run.time_s))), settle_s=3.0) for _ in range(200)]
    spread = np.corrcoef([(one.value.real, one.value.imag) for one in found], rowvar=False)[0, 1]
    stated = found[0].covariance[0, 1] / np.sqrt(np.prod(np.diag(found[0].covariance)))

    assert abs(stated) > 0.3
    assert spread == pytest.approx(stated, abs=0.2)


def test_thrust_that_goes_with_the_square_of_speed_shows_in_the_second_harmonic_alone() -> None:
    truth = RotorTruth()
    middle, swing = 381 + 0.0408 * 30000, 0.0408 * 20000  # rad/s
    run = simulate_sines(truth, periods=[2], samples=4000, rng=np.random.default_rng(1))
    response = respond(align(recorded(run)).runs[0])
    lag = 1 + 1j * response.frequency_rad_s * truth.time_constant_s

    assert abs(response.second) == pytest.approx(swing / (4 * middle) / abs(lag), rel=0.05)
    assert abs(response.value) == pytest.approx(2 * truth.thrust_ns2_per_rad2 * middle * 0.0408 / abs(lag), rel=0.01)


def test_a_clipped_sine_is_divided_by_what_was_played() -> None:
    bench = Bench(loadcell=noiseless_bench(1000).loadcell)
    run = simulate_sines(STILL, periods=[4], samples=4000, rng=np.random.default_rng(2), amplitude=45000, bench=bench)
    response = respond(align(recorded(run)).runs[0])

    assert abs(response.value) == pytest.approx(abs(truth_at(response)), rel=1e-3)


def test_a_sine_without_frequency_or_at_half_of_the_sampling_rate_is_refused() -> None:
    for run in align(exact(B0, A1, periods=[0, 2000], samples=4000)).runs:
        with pytest.raises(DataError, match="not above zero and below half"):
            respond(run)
