"""Linear estimates: their covariances agree with the scatter of repetitions, and weights are the stated ones."""

import numpy as np
import pytest

from cfid.errors import FitError
from cfid.estimate.linear import (
    Estimate,
    fit_linear,
    gain_of,
    propagated,
    sandwich,
    std_of,
)
from cfid.estimate.propagation import repeats

DRAWS = 1000
TIME = np.linspace(0, 1, 12)
ROWS = np.stack([np.ones(12), TIME], axis=1)
TRUE = np.array([2.0, -3.0])


def scatter_of(estimates: list[Estimate]) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard deviation of the values over repetitions, and the root mean square of the stated ones."""
    values = np.array([one.values for one in estimates])
    return np.std(values, axis=0), np.sqrt(np.mean([np.diag(one.covariance) for one in estimates], axis=0))


@pytest.mark.parametrize("noise_known", [True, False])
def test_a_fit_scatters_as_far_as_it_states(noise_known: bool) -> None:
    random, unit = np.random.default_rng(5), 1.0 if noise_known else 0.3
    fits = [
        fit_linear(ROWS, ROWS @ TRUE + unit * random.standard_normal(12), noise_known=noise_known) for _ in range(DRAWS)
    ]
    found, stated = scatter_of(fits)
    assert found == pytest.approx(stated, rel=0.1)
    assert np.mean([fit.values for fit in fits], axis=0) == pytest.approx(TRUE, abs=3 * stated.max() / DRAWS**0.5)


def test_correlated_data_weigh_by_their_covariance() -> None:
    """Two readings of one balance count as one; a reading of another with a quarter of the variance counts as four."""
    covariance = np.array([[1.0, 1.0 - 1e-9, 0.0], [1.0 - 1e-9, 1.0, 0.0], [0.0, 0.0, 0.25]])
    gain = gain_of(np.ones((3, 1)), covariance=covariance)
    assert gain[0] == pytest.approx([0.1, 0.1, 0.8], rel=1e-6)


def test_correlated_residuals_widen_a_covariance_to_what_repetition_shows() -> None:
    random, count = np.random.default_rng(8), 400
    rows = np.stack([np.ones(count), np.linspace(-1, 1, count)], axis=1)
    values, stated = [], []
    for _ in range(300):
        white = random.standard_normal(count + 30)
        noise = np.convolve(white, np.full(10, 0.1), mode="valid")[:count]
        fit = fit_linear(rows, noise, noise_known=False)
        values.append(fit.values)
        stated.append(np.diag(sandwich(rows, fit.residual, longest=count // 4)))
    assert np.sqrt(np.mean(stated, axis=0)) == pytest.approx(np.std(values, axis=0), rel=0.15)
    # Taken as white noise, they would lead to a third of it: neighbouring samples share nine of their ten parts.
    assert fit.std[0] < 0.5 * np.std(values, axis=0)[0]


def test_propagation_takes_the_correlation_of_the_inputs_along() -> None:
    covariance = np.array([[0.04, 0.06], [0.06, 0.09]])  # fully correlated: 0.2 and 0.3
    product = propagated(lambda v: np.array([v[0] * v[1], v[0] / v[1]]), np.array([2.0, 3.0]), covariance)
    assert std_of(product) == pytest.approx([2 * 0.3 + 3 * 0.2, 0.0], abs=1e-6)


DAYS = np.linspace(0.0, 5 * 86400.0, 6)


def test_values_within_their_deviations_agree_and_their_mean_is_weighted() -> None:
    found = repeats(time_s=DAYS[:2], value=np.array([1.0, 1.3]), std=np.array([0.1, 0.2]))

    assert found.mean == pytest.approx((1.0 / 0.01 + 1.3 / 0.04) / 125)
    assert found.mean_std == pytest.approx((0.1 / 0.01 + 0.2 / 0.04) / 125)
    assert found.agree


def test_a_drift_is_found_with_an_honest_deviation() -> None:
    rng, inside = np.random.default_rng(1), 0
    for _ in range(400):
        value = 3.0 + 0.02 * np.arange(6) + 0.05 * rng.standard_normal(6)
        found = repeats(time_s=1.7e9 + DAYS, value=value, std=np.full(6, 0.05))
        assert found.drift_per_day is not None
        assert found.drift_std_per_day is not None
        inside += abs(found.drift_per_day - 0.02) < 1.96 * found.drift_std_per_day
    assert 0.94 < inside / 400 <= 1  # scatter widens intervals, and nothing narrows them


@pytest.mark.parametrize("shared", [0.0, 0.6, 1.0])
def test_means_cover_the_truth_whatever_part_of_the_errors_is_shared(shared: float) -> None:
    rng = np.random.default_rng(2)
    own, common = rng.standard_normal((2000, 5)), rng.standard_normal((2000, 1))
    values = 1.0 + 0.1 * (np.sqrt(1 - shared) * own + np.sqrt(shared) * common)
    found = [repeats(time_s=DAYS[:5], value=value, std=np.full(5, 0.1)) for value in values]

    assert np.mean([abs(f.mean - 1.0) < 1.96 * f.mean_std for f in found]) > 0.94
    assert np.mean([f.agree for f in found]) > 0.983


def test_two_times_tell_no_drift_and_one_value_no_repeat() -> None:
    assert repeats(time_s=DAYS[:2], value=np.array([1.0, 2.0]), std=np.ones(2)).drift_per_day is None
    with pytest.raises(FitError, match="1 value does not repeat"):
        repeats(time_s=DAYS[:1], value=np.ones(1), std=np.ones(1))
