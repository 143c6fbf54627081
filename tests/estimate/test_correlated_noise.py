"""Noise that is correlated in time widens a covariance to the scatter of repetitions, even if a fit follows it."""

import numpy as np
import pytest

from cfid.estimate.linear import gain_of, noise_covariance, sandwich
from tests.coverage_rows import reaches_93_percent

TIME_S = np.arange(60) * 0.025
TRIED_S = (0.05, 0.1, 0.2, 0.4)
CORRELATIONS = [np.exp(-np.abs(np.subtract.outer(TIME_S, TIME_S)) / each_s) for each_s in TRIED_S]
# Level and size of a rise that takes 60 ms of 1.5 s, and its change with its time constant.
ROWS = np.stack([np.ones(60), np.exp(-TIME_S / 0.06), TIME_S / 0.06 * np.exp(-TIME_S / 0.06)], axis=1)


def drawn(covariance: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(np.random.default_rng(5).multivariate_normal(np.zeros(60), covariance, size=count))


@pytest.mark.parametrize("count", [200, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise", [CORRELATIONS[1], 0.5 * CORRELATIONS[2] + 0.5 * np.eye(60), np.eye(60)])
def test_the_uncertainty_of_a_short_rise_is_that_of_repetition(noise: np.ndarray, count: int) -> None:
    gain, held, by_sandwich = gain_of(ROWS), [], []
    for data in drawn(noise, count):
        residual = data - ROWS @ (gain @ data)
        own = gain @ noise_covariance(ROWS, residual, CORRELATIONS) @ gain.T
        error = float((gain @ data)[2])
        held.append(abs(error) < 1.96 * np.sqrt(own[2, 2]))
        by_sandwich.append(abs(error) < 1.96 * np.sqrt(sandwich(ROWS, residual, longest=15)[2, 2]))
    print(f"{100 * np.mean(held):.0f} % (sandwich: {100 * np.mean(by_sandwich):.0f} %)")

    assert reaches_93_percent(held)
    assert count < 1000 or np.mean(held) >= 0.93
    assert np.mean(by_sandwich) < np.mean(held)
