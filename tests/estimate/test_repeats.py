"""Repeated values of one quantity: their mean, agreement and drift."""

import numpy as np
import pytest

from cfid.errors import FitError
from cfid.estimate.propagation import repeats

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
