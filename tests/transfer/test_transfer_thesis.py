"""C.2.5 as published: its coefficients from clean data, its constants, and its error from ignored latencies."""

from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.sim.link import RadioTruth
from cfid.transfer.alignment import RecordedSine, Sign, align
from cfid.transfer.estimation import fit_transfer, measure
from cfid.transfer.thesis import (
    FIRST_SERIES,
    SECOND_SERIES,
    Complex,
    ThesisSettings,
    fit_all,
    fit_thesis,
    least_squares,
    thesis_response,
)
from tests.offline.sine_bench import Bench
from tests.transfer.sine_recordings import FIRST_PERIODS, LAG_S, SHAKEN, STILL, exact, recorded, simulated

EQUATIONS = [(6.0705967e-8, 0.9745210), (7.2345374e-8, 0.9695404)]
DIVIDING = (2, 4, 5, 8, 10, 16, 20, 25, 32, 40, 50, 80, 100)


def thrust(runs: list[RecordedSine]) -> list[RecordedSine]:
    """Give the load cell's torque the sign of thrust, as the minus in C.2.5 does."""
    return [replace(run, force_n=-run.force_n) for run in runs]


@pytest.mark.parametrize(("b0", "a1"), EQUATIONS)
@pytest.mark.parametrize(("samples", "settings"), [(4000, FIRST_SERIES), (8000, SECOND_SERIES)])
def test_clean_data_give_the_coefficients_where_every_l_divides_n(
    b0: float, a1: float, samples: int, settings: ThesisSettings
) -> None:
    fit = fit_thesis(exact(b0, a1, periods=DIVIDING, samples=samples, cut=False), settings)

    assert fit.function.numerator == pytest.approx([b0], rel=1e-6)
    assert fit.function.denominator == pytest.approx([1, -a1], rel=1e-6)
    assert not fit.findings


@pytest.mark.parametrize(("periods", "taken"), [(1, 3500), (2, 2000), (12, 3330), (64, 3465), (100, 3480)])
def test_whole_periods_are_transformed_each_rounded_to_samples(periods: int, taken: int) -> None:
    response = thesis_response(exact(*EQUATIONS[0], periods=[periods], samples=4000)[0])

    assert response.fft_samples == taken
    assert response.samples == 4000
    assert response.omega_rad == pytest.approx(2 * np.pi * periods / 4000)
    assert not response.elsewhere


def test_n_is_what_the_stamps_say_and_the_bias_that_of_the_first_thousand_samples() -> None:
    run = exact(*EQUATIONS[0], periods=[10], samples=4000)[0]
    stamps_s = run.reports.host_s.copy()
    stamps_s[-1] += 0.0075
    late = replace(run, reports=run.reports._replace(host_s=stamps_s), force_n=run.force_n + 3.0)

    assert thesis_response(late).samples == 4004
    assert thesis_response(late).omega_rad == pytest.approx(2 * np.pi * 10 / 4004)
    same = replace(late, force_n=run.force_n)
    assert thesis_response(late).value == pytest.approx(thesis_response(same).value)


def test_weights_enter_squared() -> None:
    value: Complex = np.array([1.0, 0.8 - 0.3j, 0.4 - 0.5j, 0.2 - 0.4j])
    omega = np.array([0.01, 0.03, 0.06, 0.1])
    twice = ThesisSettings()
    weighted = least_squares(value, omega, np.array([2.0, 1.0, 1.0, 1.0]), twice)
    repeated = least_squares(value[[0, 0, 0, 0, 1, 2, 3]], omega[[0, 0, 0, 0, 1, 2, 3]], np.ones(7), twice)

    assert weighted[0] == pytest.approx(repeated[0])
    assert weighted[1] == pytest.approx(repeated[1])
    fit = fit_thesis(exact(*EQUATIONS[0], periods=[4, 15, 16, 40], samples=4000))
    assert fit.weights.tolist() == [2, 2, 0.5, 0.5]
    fit = fit_thesis(exact(*EQUATIONS[0], periods=[50, 51, 200, 201], samples=8000), SECOND_SERIES)
    assert fit.weights.tolist() == [2.5, 0.5, 0.5]


@pytest.mark.parametrize(("numerator", "denominator"), [([2.0], [1, -0.9]), ([1, 0.5, -0.2], [1, -1.2, 0.4])])
def test_any_a_and_b_are_solved_for(numerator: list[float], denominator: list[float]) -> None:
    omega = np.linspace(0.01, 2.0, 12)
    z = np.exp(1j * omega)
    value = np.asarray(np.polyval(numerator[::-1], 1 / z) / np.polyval(denominator[::-1], 1 / z), dtype=np.complex128)
    settings = ThesisSettings(numerator=len(numerator), denominator=len(denominator))
    found = least_squares(value, omega, np.ones(12), settings)

    assert found[0] == pytest.approx(numerator)
    assert found[1] == pytest.approx(denominator)


@pytest.mark.parametrize(("latency_s", "excess"), [(0.010, 0.2), (0.023, 0.6)])
def test_a_latency_that_it_ignores_makes_its_time_constant_too_long(latency_s: float, excess: float) -> None:
    bench = Bench(radio=RadioTruth(latency_s=0.0, jitter_s=0.0), loadcell_latency_s=latency_s)
    runs = recorded(simulated(FIRST_PERIODS, truth=STILL, bench=bench))
    ignored = fit_thesis(thrust(runs)).function.time_constant_s
    joint = fit_transfer([measure("first", align(runs))])

    assert ignored is not None
    found = joint.time_constant_s / LAG_S
    print(f"latency {1e3 * latency_s:.1f} ms: thesis {ignored / LAG_S - 1:+.1%}, joint {found - 1:+.2%}")
    assert ignored / LAG_S - 1 > excess
    assert joint.time_constant_s == pytest.approx(LAG_S, rel=0.01)


def test_with_the_radio_late_and_rotors_shaking_it_is_off_where_the_default_is_not() -> None:
    runs = recorded(simulated(FIRST_PERIODS, truth=SHAKEN))
    thesis = fit_thesis(thrust(runs))
    joint = fit_transfer([measure("first", align(runs))])

    assert thesis.function.time_constant_s is not None
    assert abs(thesis.function.time_constant_s / LAG_S - 1) > 0.05
    assert abs(joint.time_constant_s / LAG_S - 1) < 0.01
    elsewhere = [one for one in thesis.findings if one.code == "thesis-peak-elsewhere"]
    assert len(elsewhere) == sum(response.elsewhere for response in thesis.responses) > 3


def test_a_run_without_a_whole_period_after_the_first_samples_is_refused() -> None:
    (run,) = exact(*EQUATIONS[0], periods=[4], samples=4000)
    with pytest.raises(DataError, match="no whole period is left"):
        thesis_response(run, settle_samples=3500)


def test_a_pole_that_does_not_decay_has_no_time_constant_and_is_rejected() -> None:
    fit = fit_thesis(exact(*EQUATIONS[0], periods=[4, 8], samples=4000))
    grows = replace(fit, function=replace(fit.function, denominator=np.array([1.0, -1.1])))

    assert grows.function.time_constant_s is None
    assert [(one.code, one.quantities) for one in grows.rejections(["tf.numerator"])] == [
        ("thesis-pole-no-decay", ("tf.numerator",))
    ]
    assert not fit.rejections(["tf.numerator"])
    assert fit.function.static_gain_n == pytest.approx(6.0705967e-8 / (1 - 0.9745210), rel=1e-4)


@pytest.mark.parametrize(("elsewhere", "codes"), [(2, []), (3, ["thesis-peaks-elsewhere"])])
def test_largest_peaks_away_from_the_sine_in_most_runs_reject_the_fit(elsewhere: int, codes: list[str]) -> None:
    fit = fit_thesis(exact(*EQUATIONS[0], periods=[4, 8, 10, 20], samples=4000))
    away = [replace(own, elsewhere=place < elsewhere) for place, own in enumerate(fit.responses)]

    assert [one.code for one in replace(fit, responses=tuple(away)).rejections(["tf.numerator"])] == codes


def test_series_have_the_settings_of_their_n_and_their_joint_fit_keeps_their_weights() -> None:
    series = {
        "first": exact(*EQUATIONS[0], periods=[4, 16, 40], samples=4000),
        "second": exact(*EQUATIONS[0], periods=[8, 32, 80], samples=8000),
    }
    found = fit_all(series)

    assert found.each["first"].weights.tolist() == [2, 0.5, 0.5]
    assert found.each["second"].weights.tolist() == [2.5, 2.5, 0.5]
    assert found.joint.weights.tolist() == [2, 0.5, 0.5, 2.5, 2.5, 0.5]
    assert found.joint.function.denominator == pytest.approx([1, -0.9745210], rel=1e-3)


@pytest.mark.parametrize(("sign", "factor"), [("auto", 1), ("+", -1), ("-", 1)])
def test_force_is_turned_to_the_sign_of_thrust(sign: Sign, factor: int) -> None:
    runs = exact(*EQUATIONS[0], periods=[4, 16, 40], samples=4000)
    upward = fit_thesis(runs)
    turned = fit_all({"first": thrust(runs)}, sign=sign).joint

    assert turned.function.numerator == pytest.approx(factor * upward.function.numerator)
