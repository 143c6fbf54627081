"""Transfer functions with delay from series of sines: promised accuracy, orders, joint series, verdicts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import FitError
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
from cfid.transfer.model import EQ_3_15, EQ_3_16, TransferFunction
from tests.offline.sine_bench import Bench, LinearTruth
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
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_a_simulated_series_gives_time_constant_gain_and_delay(
    periods: tuple[int, ...], samples: int, stamped: bool, lag_within: float, gain_within: float, seed: int
) -> None:
    found = measured(periods, samples=samples, seed=seed, stamped=stamped)
    fit = fit_transfer([found])

    assert 17 <= len(found.responses) <= 43
    assert fit.time_constant_s == pytest.approx(LAG_S, rel=lag_within)
    assert fit.gain_n == pytest.approx(GAIN_N, rel=gain_within)
    assert fit.delays["first"].delay_s == pytest.approx(USUAL.delay_s, abs=1.5e-3)
    assert fit.accepted
    assert fit.time_constant_std_s < lag_within * LAG_S


def test_a_loop_that_is_off_by_3_in_a_thousand_shows_in_stamps_of_the_host_too() -> None:
    bench = replace(USUAL, loop_error=3e-3)
    fit = fit_transfer([measured(log_spaced(17, 100), bench=bench, stamped=False)])

    assert fit.function.sample_s == pytest.approx(0.002 / 1.003, rel=1e-4)
    assert fit.time_constant_s == pytest.approx(LAG_S, rel=0.02)


def orders_of(truth: LinearTruth, *, lag_s: float = 0.0) -> dict[Shape, TransferFit]:
    """Fit all shapes to the responses of a truth followed by a second lag."""
    found = measure("first", align(recorded(simulated(log_spaced(25, 100), truth=truth))))
    lagging = [
        replace(response, value=response.value / (1 + 1j * response.frequency_rad_s * lag_s))
        for response in found.responses
    ]
    return fit_shapes([replace(found, responses=tuple(lagging))])


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


LAGS = [((0.0775,), 0.0), ((0.08, 0.01), 0.0), ((0.05, 0.05), 0.0), ((0.08,), 0.03)]
COMMANDS = np.random.default_rng(1).uniform(10000, 50000, 400)
SAMPLES_S = np.arange(400) * np.float64(0.002)


@pytest.mark.parametrize(("lags_s", "lead_s"), LAGS)
def test_a_simulation_is_the_difference_equation_and_ends_at_the_static_gain(
    lags_s: tuple[float, ...], lead_s: float
) -> None:
    function = TransferFunction.of_lags(2.0, lags_s, lead_s=lead_s)
    force: list[float] = []
    for n in range(len(COMMANDS)):
        fed = sum(b * COMMANDS[n - k] for k, b in enumerate(function.numerator) if n >= k)
        force.append(fed - sum(a * force[n - k] for k, a in enumerate(function.denominator) if 0 < k <= n))

    assert function.simulate(COMMANDS, SAMPLES_S) == pytest.approx(force)
    assert function.static_gain_n == pytest.approx(2.0)
    assert function.response(np.array([1e-6]))[0] == pytest.approx(2.0)
    assert function.time_constant_s == pytest.approx(max(lags_s), rel=1e-6)
    assert function.denominator[0] == 1


def test_a_lag_behind_a_hold_has_the_coefficients_of_its_decay_over_a_sample() -> None:
    pole = math.exp(-0.002 / 0.06)
    function = TransferFunction.of_lags(3e-6, [0.06])

    assert function.numerator == pytest.approx([0, 3e-6 * (1 - pole)], rel=1e-12)
    assert function.denominator == pytest.approx([1, -pole], rel=1e-12)


def test_eq_3_15_and_3_16_as_gain_and_time_constant() -> None:
    assert EQ_3_15.static_gain_n == pytest.approx(6.0705967e-8 / (1 - 0.9745210))
    assert EQ_3_15.time_constant_s == pytest.approx(0.0775, abs=1e-4)
    assert EQ_3_16.static_gain_n == pytest.approx(2.375e-6, rel=1e-3)
    assert EQ_3_16.time_constant_s == pytest.approx(0.0647, abs=1e-4)


def test_eq_3_11_is_evaluated_in_rising_powers() -> None:
    z = np.exp(0.3j)
    function = TransferFunction(numerator=np.array([1.0, 2.0]), denominator=np.array([1.0, -0.5, 0.2]))

    assert function.response(np.array([0.3 / 0.002]))[0] == pytest.approx((1 + 2 / z) / (1 - 0.5 / z + 0.2 / z**2))
