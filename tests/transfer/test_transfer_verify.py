"""Comparison of a transfer function with a run that was left out of its fit."""

from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.transfer.estimation import fit_transfer, measure
from cfid.transfer.model import EQ_3_15
from cfid.transfer.sines.alignment import SineRun, align
from cfid.transfer.verification import verify_run
from tests.transfer.sine_recordings import SHAKEN, STILL, noiseless_bench, recorded, simulated

LEAST_S = 0.0006 - 0.012


def run_of(periods: int, *, shaken: bool = True) -> SineRun:
    truth = SHAKEN if shaken else STILL
    return align(recorded(simulated((3, periods, 9), truth=truth))).runs[1]


def test_a_run_left_out_of_the_fit_is_simulated_to_within_its_noise() -> None:
    series = align(recorded(simulated((1, 2, 4, 8, 12, 16, 25, 40, 60, 100))))
    rest = tuple(run for run in series.runs if run.sine.periods not in (12, 25))
    fit = fit_transfer([measure("first", replace(series, runs=rest))])
    for run in (run for run in series.runs if run.sine.periods in (12, 25)):
        found = verify_run(run, fit.dynamics, after_quickest_s=fit.delays["first"].after_quickest_s)

        assert found.fit_percent > 93
        assert found.unfiltered_fit_percent < 30  # vibration dominates the load cell's readings
        assert abs(found.late_s) < 3 * found.late_std_s < 1.5e-3
        assert abs(found.gain_ratio - 1) < 3 * found.gain_ratio_std < 0.015
        assert found.residual_rms_n < 2e-3


def test_without_noise_the_fit_is_perfect() -> None:
    run = align(recorded(simulated((12,), truth=STILL, bench=noiseless_bench(1000)))).runs[0]
    found = verify_run(run, EQ_3_15, after_quickest_s=0.0)

    assert found.fit_percent > 99.99
    assert found.unfiltered_fit_percent > 99.9
    assert abs(found.time_s[0] - 1.0) < 0.01
    assert found.measured_n == pytest.approx(found.simulated_n, abs=1e-5)


def test_a_delay_left_out_is_the_shift_that_figure_3_16_shows() -> None:
    found = verify_run(run_of(25), EQ_3_15, after_quickest_s=0.0)

    assert found.late_s == pytest.approx(LEAST_S, abs=3e-3)
    assert found.fit_percent < 85


def test_an_uncertain_delay_makes_the_lateness_uncertain_and_not_the_gain() -> None:
    run = run_of(12)
    sure, unsure = (verify_run(run, EQ_3_15, after_quickest_s=LEAST_S, delay_std_s=std_s) for std_s in (0.0, 2e-3))

    assert unsure.late_std_s == pytest.approx(np.hypot(sure.late_std_s, 2e-3))
    assert unsure.late_std_rad == pytest.approx(unsure.late_std_s * run.frequency_rad_s)
    assert unsure.gain_ratio_std == sure.gain_ratio_std


def test_another_gain_shows_as_a_ratio() -> None:
    weaker = replace(EQ_3_15, static_gain_n=EQ_3_15.static_gain_n / 1.1)
    found = verify_run(run_of(5), weaker, after_quickest_s=LEAST_S)

    assert found.gain_ratio == pytest.approx(1.1, abs=3 * found.gain_ratio_std)


def test_the_thesis_form_is_the_same_a_sample_later() -> None:
    run = run_of(12)
    held = verify_run(run, EQ_3_15, after_quickest_s=LEAST_S)
    early = verify_run(run, EQ_3_15, after_quickest_s=LEAST_S + 0.002, form="thesis")

    assert early.fit_percent == pytest.approx(held.fit_percent, abs=0.01)


def test_a_run_too_short_to_be_compared_is_refused() -> None:
    run = run_of(12)
    with pytest.raises(DataError, match="too short"):
        verify_run(run, EQ_3_15, after_quickest_s=0.0, settle_s=7.9)


def test_smoothing_shifts_nothing() -> None:
    run = run_of(30, shaken=False)
    kept = verify_run(run, EQ_3_15, after_quickest_s=LEAST_S, smoothed_hz=25.0)
    rough = verify_run(run, EQ_3_15, after_quickest_s=LEAST_S, smoothed_hz=100.0)
    omega = run.frequency_rad_s
    phases = [np.angle(np.sum(found.simulated_n * np.exp(-1j * omega * found.time_s))) for found in (kept, rough)]

    assert phases[0] == pytest.approx(phases[1], abs=2e-3)
