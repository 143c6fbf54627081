"""Transfer functions with delay from series of sines: promised accuracy, orders, joint series, verdicts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import FitError
from cfid.sim.propulsion import RotorTruth
from cfid.transfer.alignment import align
from cfid.transfer.estimation import (
    MeasuredSeries,
    Shape,
    TransferFit,
    corrected_aic,
    fit_shapes,
    fit_transfer,
    measure,
)
from tests.offline.sine_bench import Bench, LinearTruth, simulate_sines
from tests.transfer.sine_recordings import (
    FIRST_PERIODS,
    GAIN_N,
    LAG_S,
    STILL,
    USUAL,
    log_spaced,
    noiseless_bench,
    recorded,
    simulated,
)

WHOLE = (2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 80, 100)
KEYS = ("tf.numerator", "tf.denominator", "tf.time_constant_s", "tf.static_gain_n", "tf.delay_s")
EQUATIONS = [(6.0705967e-8, 0.9745210), (7.2345374e-8, 0.9695404)]
SERIES = [(log_spaced(19, 100), 4000), (FIRST_PERIODS, 4000), (log_spaced(22, 200), 8000), (log_spaced(60, 200), 8000)]


def measured(
    periods: tuple[int, ...],
    *,
    samples: int = 4000,
    seed: int = 0,
    stamped: bool = True,
    bench: Bench = USUAL,
    name: str = "first",
) -> MeasuredSeries:
    runs = simulated(periods, samples=samples, seed=seed, bench=bench)
    return measure(name, align(recorded(runs, stamped=stamped)))


@pytest.mark.parametrize(("b0", "a1"), EQUATIONS)
def test_noiseless_forces_between_the_samples_give_the_same_plant_with_its_hold(b0: float, a1: float) -> None:
    truth = LinearTruth.of_coefficients(b0, a1)
    runs = simulated((2, 5, 12, 31, 67, 97), truth=truth, bench=noiseless_bench(7000))
    fit = fit_transfer([measure("first", align(recorded(runs)))])

    assert fit.function.numerator[0] == 0
    assert fit.function.numerator[1] == pytest.approx(b0, rel=2e-5)
    assert fit.function.denominator == pytest.approx([1, -a1], rel=2e-6)
    # Eq. 3.15 lacks the z^-1 of a hold, so its force is one sample early.
    assert fit.delays["first"].delay_s == pytest.approx(-0.002, abs=2e-6)


@pytest.mark.parametrize(("periods", "samples"), SERIES)
@pytest.mark.parametrize(("stamped", "lag_within", "gain_within"), [(True, 0.01, 0.005), (False, 0.03, 0.01)])
def test_a_simulated_series_gives_time_constant_gain_and_delay(
    periods: tuple[int, ...], samples: int, stamped: bool, lag_within: float, gain_within: float
) -> None:
    for seed in range(2):
        found = measured(periods, samples=samples, seed=seed, stamped=stamped)
        fit = fit_transfer([found])

        assert 17 <= len(found.responses) <= 43
        assert fit.time_constant_s == pytest.approx(LAG_S, rel=lag_within)
        assert fit.gain_n == pytest.approx(GAIN_N, rel=gain_within)
        assert fit.delays["first"].delay_s == pytest.approx(USUAL.delay_s, abs=1.5e-3)
        assert fit.accepted
        assert fit.time_constant_std_s < lag_within * LAG_S


def test_a_loop_that_is_off_by_3_in_a_thousand_changes_nothing() -> None:
    bench = replace(USUAL, loop_error=3e-3)
    for stamped in (True, False):
        fit = fit_transfer([measured(log_spaced(17, 100), bench=bench, stamped=stamped)])
        assert fit.function.sample_s == pytest.approx(0.002 / 1.003, rel=1e-4)
        assert fit.time_constant_s == pytest.approx(LAG_S, rel=0.02)


def test_rotors_whose_thrust_goes_with_the_square_of_speed_give_the_slope_of_their_thrust() -> None:
    truth = RotorTruth()
    rng = np.random.default_rng(3)
    runs = simulate_sines(truth, periods=log_spaced(9, 100), samples=4000, rng=rng)
    fit = fit_transfer([measure("first", align(recorded(runs)))])
    slope = 2 * truth.thrust_ns2_per_rad2 * (381 + 0.0408 * 30000) * 0.0408

    assert fit.gain_n == pytest.approx(slope, rel=0.005)
    assert fit.time_constant_s == pytest.approx(truth.time_constant_s, rel=0.01)
    assert fit.accepted


def orders_of(truth: LinearTruth, *, lag_s: float = 0.0) -> dict[Shape, TransferFit]:
    """Fit all shapes to the responses of a truth followed by a second lag."""
    found = measure("first", align(recorded(simulated(log_spaced(25, 100), truth=truth))))
    lagging = [
        replace(response, value=response.value / (1 + 1j * response.frequency_rad_s * lag_s))
        for response in found.responses
    ]
    return fit_shapes([replace(found, responses=tuple(lagging))])


def test_a_first_order_lag_with_delay_is_preferred_where_it_is_the_truth() -> None:
    scores = corrected_aic(fit_shapes([measured(log_spaced(25, 100))]))

    assert scores["first"] > 1000
    assert scores["first+delay"] < 2.5
    assert set(scores) == {"first", "first+delay", "second", "zero"}


def test_a_second_lag_is_found_where_there_is_one() -> None:
    fits = orders_of(STILL, lag_s=0.012)
    scores = corrected_aic(fits)

    assert min(scores, key=lambda shape: scores[shape]) == "second"
    assert sorted(fits["second"].lags_s) == pytest.approx([0.012, LAG_S], rel=0.15)
    assert fits["second"].time_constant_s == max(fits["second"].lags_s)
    assert fits["second"].delays["first"].delay_s == pytest.approx(USUAL.delay_s, abs=2e-3)


def test_an_error_that_all_runs_share_is_in_the_delays_uncertainty_as_is_the_mean_latenesss() -> None:
    found = measured(log_spaced(17, 100))
    late = [replace(response, shared_s={"offset": 5e-3}) for response in found.responses]
    fit = fit_transfer([replace(found, responses=tuple(late), mean_lateness_std_s=3e-3)])
    delay = fit.delays["first"]

    assert delay.after_quickest_std_s == pytest.approx(5e-3, rel=0.01)
    assert delay.std_s == pytest.approx(math.hypot(delay.after_quickest_std_s, 3e-3))


def test_a_lag_shorter_than_the_samples_resolve_rejects_what_follows_from_it_and_keeps_gain_and_delay() -> None:
    fit = fit_transfer([measured(log_spaced(17, 100))])
    instant = replace(fit, values=fit.values * [1, 1e-4, 1])
    (finding,) = instant.findings(KEYS)

    assert finding.code == "transfer-no-time-constant"
    assert finding.quantities == ("tf.numerator", "tf.denominator", "tf.time_constant_s")
    assert not instant.accepted


def test_a_run_without_a_response_is_left_out_with_a_warning() -> None:
    series = align(recorded(simulated((3, 8, 25))))
    silent = replace(series.runs[1], force_n=np.zeros_like(series.runs[1].force_n))
    found = measure("first", replace(series, runs=(series.runs[0], silent, series.runs[2])))

    assert [response.periods for response in found.responses] == [3, 25]
    assert [one.code for one in found.findings] == ["sine-without-response"]
    assert found.findings[0].text.startswith("l = 8: the load cell measured nothing")
    with pytest.raises(FitError, match="measured nothing"):
        measure("first", replace(series, runs=(silent,)))


def test_a_run_of_another_plant_widens_the_deviations() -> None:
    found = measured(log_spaced(17, 100))
    wrong = list(found.responses)
    wrong[5] = replace(wrong[5], value=wrong[5].value * 1.05)
    plain, spoilt = fit_transfer([found]), fit_transfer([replace(found, responses=tuple(wrong))])

    assert spoilt.probability < 1e-3
    assert spoilt.time_constant_std_s > 2 * plain.time_constant_std_s
    assert spoilt.accepted  # a motor may have 1 % of systematic difference
    assert [(one.code, one.severity) for one in spoilt.findings(KEYS)] == [("transfer-scatter", "warning")]
