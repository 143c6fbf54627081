"""Transfer functions with delay from series of sines: promised accuracy, orders, joint series, verdicts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import FitError
from cfid.sim.propulsion import RotorTruth
from cfid.transfer.estimation import MeasuredSeries, TransferFit, fit_transfer, measure
from cfid.transfer.frequency_response import respond
from cfid.transfer.identification import corrected_aic, fit_shapes
from cfid.transfer.likelihood import Shape
from cfid.transfer.sines.alignment import align
from tests.offline.sine_bench import Bench, LinearTruth, simulate_sines
from tests.transfer.sine_recordings import (
    FIRST_PERIODS,
    GAIN_N,
    LAG_S,
    STILL,
    USUAL,
    exact,
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
@pytest.mark.parametrize("periods", [WHOLE, (1, *WHOLE), FIRST_PERIODS])
def test_noiseless_data_of_the_thesis_functions_give_their_coefficients_and_no_delay(
    b0: float, a1: float, periods: tuple[int, ...]
) -> None:
    series = align(exact(b0, a1, periods=periods, samples=4000))
    fit = fit_transfer([measure("first", series, form="thesis")])

    assert fit.numerator == pytest.approx([b0], rel=1e-6)
    assert fit.denominator == pytest.approx([1, -a1], rel=1e-6)
    assert fit.delays["first"].delay_s == pytest.approx(0, abs=1e-7)
    assert fit.accepted


@pytest.mark.parametrize(("b0", "a1"), EQUATIONS)
def test_noiseless_forces_between_the_samples_give_the_same_plant_with_its_hold(b0: float, a1: float) -> None:
    truth = LinearTruth.of_coefficients(b0, a1)
    runs = simulated((2, 5, 12, 31, 67, 97), truth=truth, bench=noiseless_bench(7000))
    fit = fit_transfer([measure("first", align(recorded(runs)))])

    assert fit.numerator[0] == 0
    assert fit.numerator[1] == pytest.approx(b0, rel=2e-5)
    assert fit.denominator == pytest.approx([1, -a1], rel=2e-6)
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
        assert fit.dynamics.static_gain_n == pytest.approx(GAIN_N, rel=gain_within)
        assert fit.delays["first"].delay_s == pytest.approx(USUAL.delay_s, abs=1.5e-3)
        assert fit.accepted
        assert fit.time_constant_std_s < lag_within * LAG_S


def test_a_load_cell_later_than_the_radio_makes_the_delay_positive() -> None:
    bench = replace(USUAL, loadcell_latency_s=0.080)
    fit = fit_transfer([measured(log_spaced(17, 100), bench=bench)])

    assert fit.delays["first"].delay_s == pytest.approx(0.052, abs=1.5e-3)
    assert fit.time_constant_s == pytest.approx(LAG_S, rel=0.01)


def test_a_loop_that_is_off_by_3_in_a_thousand_changes_nothing() -> None:
    bench = replace(USUAL, loop_error=3e-3)
    for stamped in (True, False):
        fit = fit_transfer([measured(log_spaced(17, 100), bench=bench, stamped=stamped)])
        assert fit.sample_s == pytest.approx(0.002 / 1.003, rel=1e-4)
        assert fit.time_constant_s == pytest.approx(LAG_S, rel=0.02)


def test_rotors_whose_thrust_goes_with_the_square_of_speed_give_the_slope_of_their_thrust() -> None:
    truth = RotorTruth()
    rng = np.random.default_rng(3)
    runs = simulate_sines(truth, periods=log_spaced(9, 100), samples=4000, rng=rng)
    fit = fit_transfer([measure("first", align(recorded(runs)))])
    slope = 2 * truth.thrust_ns2_per_rad2 * (381 + 0.0408 * 30000) * 0.0408

    assert fit.dynamics.static_gain_n == pytest.approx(slope, rel=0.005)
    assert fit.time_constant_s == pytest.approx(truth.time_constant_s, rel=0.01)
    assert fit.accepted


def test_coefficients_responses_and_deviations_belong_together() -> None:
    fit = fit_transfer([measured(FIRST_PERIODS)])
    pole = np.exp(-fit.sample_s / fit.time_constant_s)
    omega = np.array([response.frequency_rad_s for response in fit.measured[0].responses])

    assert fit.denominator == pytest.approx([1, -pole])
    assert fit.numerator == pytest.approx([0, fit.dynamics.static_gain_n * (1 - pole)])
    assert fit.std.denominator == pytest.approx(
        [0, pole * fit.sample_s / fit.time_constant_s**2 * fit.time_constant_std_s], rel=1e-3
    )
    assert fit.response(omega, series="first") == pytest.approx(fit.model)
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(
        [fit.std.static_gain_n, fit.time_constant_std_s, fit.delays["first"].after_quickest_std_s]
    )
    assert fit.degrees_of_freedom == 2 * len(omega) - 3


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
    assert sorted(fits["second"].dynamics.lags_s) == pytest.approx([0.012, LAG_S], rel=0.15)
    assert fits["second"].time_constant_s == max(fits["second"].dynamics.lags_s)
    assert fits["second"].delays["first"].delay_s == pytest.approx(USUAL.delay_s, abs=2e-3)


def test_a_model_that_ignores_the_delay_is_rejected() -> None:
    fit = fit_transfer([measured(FIRST_PERIODS)], shape="first")

    assert not fit.accepted
    assert fit.probability < 1e-10
    (finding,) = fit.findings(["tf.numerator", "tf.delay_s"])
    assert (finding.code, finding.severity) == ("transfer-misfit", "rejection")
    assert finding.quantities == ("tf.numerator", "tf.delay_s")
    assert fit.misfit > 0.05


@pytest.mark.parametrize(("misfit", "described"), [(0.029, True), (0.031, False)])
def test_a_misfit_beyond_noise_is_accepted_up_to_3_percent(misfit: float, described: bool) -> None:
    fit = replace(fit_transfer([measured((3, 8))]), chi_squared=1e4, misfit=misfit)

    assert fit.described == described
    assert fit.accepted == described


def test_an_error_that_all_runs_share_is_in_the_delays_uncertainty_as_is_the_mean_latenesss() -> None:
    found = measured(log_spaced(17, 100))
    late = [replace(response, shared_s={"offset": 5e-3}) for response in found.responses]
    fit = fit_transfer([replace(found, responses=tuple(late), mean_lateness_std_s=3e-3)])
    delay = fit.delays["first"]

    assert delay.after_quickest_std_s == pytest.approx(5e-3, rel=0.01)
    assert delay.std_s == pytest.approx(math.hypot(delay.after_quickest_std_s, 3e-3))


def test_corrected_aic_is_that_of_its_formula() -> None:
    fit = fit_transfer([measured((3, 8))])
    two, five = (
        replace(fit, chi_squared=own, degrees_of_freedom=12 - free, covariance=np.eye(free))
        for own, free in ((20.0, 2), (6.0, 5))
    )
    # n = 12 and k parameters: chi-squared + 2 k + 2 k (k + 1)/(n - k - 1), in units of the best chi-squared if above 1.
    best = 20.0 + 4 + 12 / 9, 6.0 + 10 + 60 / 6

    assert corrected_aic({"first": two, "second": five}) == pytest.approx({"first": 0, "second": best[1] - best[0]})


def test_a_gain_within_its_noise_is_rejected() -> None:
    fit = fit_transfer([measured(log_spaced(17, 100))])
    gain_n = fit.dynamics.static_gain_n
    noisy, clear = (replace(fit, std=fit.std._replace(static_gain_n=abs(gain_n) / times)) for times in (4.9, 5.1))

    assert [one.code for one in noisy.findings(KEYS)] == ["transfer-gain-is-noise"]
    assert noisy.findings(KEYS)[0].quantities == KEYS
    assert not noisy.accepted
    assert not clear.findings(KEYS)


def test_a_lag_shorter_than_the_samples_resolve_rejects_what_follows_from_it_and_keeps_gain_and_delay() -> None:
    fit = fit_transfer([measured(log_spaced(17, 100))])
    instant = replace(fit, dynamics=replace(fit.dynamics, lags_s=(0.009 * fit.sample_s,)))
    (finding,) = instant.findings(KEYS)

    assert finding.code == "transfer-no-time-constant"
    assert finding.quantities == ("tf.numerator", "tf.denominator", "tf.time_constant_s")
    assert not instant.accepted


@pytest.mark.parametrize(("chi_squared", "probability"), [(18.307, 0.05), (29.588, 0.001)])
def test_the_probability_is_that_of_tables_of_chi_squared(chi_squared: float, probability: float) -> None:
    fit = replace(fit_transfer([measured((3, 8))]), chi_squared=chi_squared, degrees_of_freedom=10)

    assert fit.probability == pytest.approx(probability, rel=1e-3)
    assert replace(fit, degrees_of_freedom=0).probability == 1


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


def test_two_series_share_their_dynamics_and_keep_their_delays() -> None:
    first = measured(log_spaced(17, 100))
    other = replace(USUAL, loadcell_latency_s=0.010, motor=3)
    second = measured(log_spaced(20, 200), samples=8000, seed=1, bench=other, name="second")
    joint = fit_transfer([first, second])
    each = {own.name: fit_transfer([own]) for own in (first, second)}

    assert joint.time_constant_s == pytest.approx(LAG_S, rel=0.01)
    assert joint.delays["first"].delay_s == pytest.approx(USUAL.delay_s, abs=1.5e-3)
    assert joint.delays["second"].delay_s == pytest.approx(other.delay_s, abs=1.5e-3)
    assert joint.time_constant_std_s < min(fit.time_constant_std_s for fit in each.values())
    assert each["second"].delays.keys() == {"second"}
    assert joint.degrees_of_freedom == 2 * len(first.responses + second.responses) - 4


def test_the_mean_of_two_delays_has_the_error_of_their_dynamics_once() -> None:
    fit = fit_transfer([measured(log_spaced(17, 100), seed=seed, name=str(seed)) for seed in (1, 2)])
    one, other = fit.delays.values()
    mean, alone = fit.mean_delay, math.hypot(one.after_quickest_std_s, other.after_quickest_std_s) / 2
    together = 2 * fit.covariance[-1, -2] / 4

    assert mean.delay_s == pytest.approx((one.delay_s + other.delay_s) / 2)
    assert mean.after_quickest_std_s == pytest.approx(math.sqrt(alone**2 + together))
    assert mean.after_quickest_std_s > alone
    assert mean.std_s > mean.after_quickest_std_s


def test_the_order_of_the_runs_does_not_matter() -> None:
    found = measured(log_spaced(17, 100))
    there, back = fit_transfer([found]), fit_transfer([replace(found, responses=found.responses[::-1])])

    assert there.time_constant_s == pytest.approx(back.time_constant_s, rel=1e-8)


def test_too_few_frequencies_are_refused() -> None:
    found = measured((3, 8))
    with pytest.raises(FitError, match="1 frequency is too few for a transfer function with 3 parameters"):
        fit_transfer([replace(found, responses=found.responses[:1])])
    with pytest.raises(FitError, match="0 frequencies"):
        fit_transfer([replace(found, responses=())])
    assert "second" not in fit_shapes([found])


def test_responses_of_two_forms_are_not_mixed() -> None:
    series = align(recorded(simulated((3, 8, 25))))
    mixed = (respond(series.runs[0]), respond(series.runs[1]), respond(series.runs[2], form="thesis"))
    with pytest.raises(FitError, match="two forms"):
        fit_transfer([MeasuredSeries(name="first", responses=mixed)])
