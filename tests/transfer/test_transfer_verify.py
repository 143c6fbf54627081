"""Comparison of a transfer function with a run that was left out of its fit."""

from dataclasses import replace

import pytest

from cfid.errors import DataError
from cfid.transfer.alignment import SineRun, align
from cfid.transfer.estimation import fit_transfer, measure
from cfid.transfer.model import TransferFunction
from cfid.transfer.verification import verify_run
from tests.transfer.sine_recordings import GAIN_N, LAG_S, SHAKEN, STILL, noiseless_bench, recorded, simulated

LEAST_S = 0.0006 - 0.012
HELD = TransferFunction.of_lags(GAIN_N, [LAG_S])


def run_of(periods: int, *, shaken: bool = True) -> SineRun:
    truth = SHAKEN if shaken else STILL
    return align(recorded(simulated((3, periods, 9), truth=truth))).runs[1]


def test_a_run_left_out_of_the_fit_is_simulated_to_within_its_noise() -> None:
    series = align(recorded(simulated((1, 2, 4, 8, 12, 16, 25, 40, 60, 100))))
    rest = tuple(run for run in series.runs if run.sine.periods not in (12, 25))
    fit = fit_transfer([measure("first", replace(series, runs=rest))])
    for run in (run for run in series.runs if run.sine.periods in (12, 25)):
        found = verify_run(run, fit.function, after_quickest_s=fit.delays["first"].after_quickest_s)

        assert found.fit_percent > 93
        assert found.unfiltered_fit_percent < 30  # vibration dominates the load cell's readings
        assert abs(found.late_s) < 3 * found.late_std_s < 1.5e-3
        assert abs(found.gain_ratio - 1) < 3 * found.gain_ratio_std < 0.015
        assert found.residual_rms_n < 2e-3


def test_without_noise_the_fit_is_perfect() -> None:
    run = align(recorded(simulated((12,), truth=STILL, bench=noiseless_bench(1000)))).runs[0]
    found = verify_run(run, HELD, after_quickest_s=0.0)

    assert found.fit_percent > 99.99
    assert found.unfiltered_fit_percent > 99.9
    assert abs(found.time_s[0] - 1.0) < 0.01
    assert found.measured_n == pytest.approx(found.simulated_n, abs=1e-5)


def test_a_delay_left_out_is_the_shift_that_figure_3_16_shows() -> None:
    found = verify_run(run_of(25), HELD, after_quickest_s=0.0)

    assert found.late_s == pytest.approx(LEAST_S, abs=3e-3)
    assert found.fit_percent < 85


def test_a_run_too_short_to_be_compared_is_refused() -> None:
    run = run_of(12)
    with pytest.raises(DataError, match="too short"):
        verify_run(run, HELD, after_quickest_s=0.0, settle_s=7.9)
