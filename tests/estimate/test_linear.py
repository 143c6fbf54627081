"""Linear estimates: their covariances agree with the scatter of repetitions, and weights are the stated ones."""

import numpy as np
import pytest

from cfid.estimate.linear import (
    Estimate,
    fit_linear,
    gain_of,
    mean_of,
    propagated,
    sandwich,
    sandwich_std,
    slopes,
    std_of,
    weighted_mean,
)

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


def test_without_a_residual_the_noise_is_unknown() -> None:
    fit = fit_linear(ROWS[:2], np.array([1.0, 2.0]), noise_known=False)
    assert fit.degrees_of_freedom == 0
    assert np.isnan(fit.std).all()
    assert fit.residual == pytest.approx([0, 0], abs=1e-14)


def test_correlated_data_weigh_by_their_covariance() -> None:
    """Two readings of one balance count as one; a reading of another with a quarter of the variance counts as four."""
    covariance = np.array([[1.0, 1.0 - 1e-9, 0.0], [1.0 - 1e-9, 1.0, 0.0], [0.0, 0.0, 0.25]])
    gain = gain_of(np.ones((3, 1)), covariance=covariance)
    assert gain[0] == pytest.approx([0.1, 0.1, 0.8], rel=1e-6)


def test_columns_of_very_different_size_are_solved_alike() -> None:
    scaled = fit_linear(ROWS * (1e-9, 1e9), ROWS @ TRUE, noise_known=True)
    assert scaled.values * (1e-9, 1e9) == pytest.approx(TRUE, rel=1e-12)


def test_dependent_columns_share_their_part() -> None:
    twice = fit_linear(np.stack([TIME, TIME], axis=1), 4 * TIME, noise_known=True)
    assert twice.values == pytest.approx([2, 2], rel=1e-12)


def test_a_mean_is_as_uncertain_as_its_scatter_over_the_root_of_the_count() -> None:
    mean = mean_of(np.array([1.0, 2.0, 6.0]))
    assert mean.values == pytest.approx([3.0])
    assert mean.std == pytest.approx([np.sqrt(7.0 / 3)])  # variance (4 + 1 + 9) / 2
    assert mean.residual == pytest.approx([-2, -1, 3])


def test_a_weighted_mean_trusts_a_value_by_its_inverse_variance() -> None:
    mean = weighted_mean(np.array([10.0, 20.0]), std=np.array([1.0, 3.0]))
    assert mean.values == pytest.approx([11.0])
    assert mean.std == pytest.approx([np.sqrt(0.9)])
    assert mean.gain[0] == pytest.approx([0.9, 0.1])
    assert mean.residual == pytest.approx([-1, 9])


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


def test_few_residuals_without_correlation_state_what_a_fit_of_unknown_noise_does() -> None:
    mean = mean_of(np.array([1.0, 2.0, 6.0, 3.0]))
    assert sandwich(np.ones((4, 1)), mean.residual, longest=1) == pytest.approx(mean.covariance)


def test_propagation_takes_the_correlation_of_the_inputs_along() -> None:
    covariance = np.array([[0.04, 0.06], [0.06, 0.09]])  # fully correlated: 0.2 and 0.3
    product = propagated(lambda v: np.array([v[0] * v[1], v[0] / v[1]]), np.array([2.0, 3.0]), covariance)
    assert std_of(product) == pytest.approx([2 * 0.3 + 3 * 0.2, 0.0], abs=1e-6)


def test_slopes_are_central_differences_also_about_zero() -> None:
    found = slopes(lambda v: np.array([v[0] ** 2, np.sin(v[1])]), np.array([3.0, 0.0]))
    assert found == pytest.approx(np.array([[6.0, 0.0], [0.0, 1.0]]), abs=1e-6)


@pytest.mark.parametrize("place", [0, 1, -1])
def test_one_estimate_of_a_sandwich_is_as_uncertain_as_beside_all_others(place: int) -> None:
    rng = np.random.default_rng(3)
    rows, residual = rng.normal(size=(500, 3)), np.convolve(rng.normal(size=504), np.ones(5), mode="valid")

    alone = sandwich_std(gain_of(rows), residual, place, longest=20)

    assert alone == pytest.approx(std_of(sandwich(rows, residual, longest=20))[place], rel=1e-12)
