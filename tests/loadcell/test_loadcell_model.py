"""The forces and torques that a hung weight applies to a load cell, and the gains that known loads give back."""

import numpy as np
import pytest

from cfid.loadcell.estimation import AXES, AxisFit, Loads, applied_wrench, fit_axes, place_error
from cfid.records.run import Pull

AT_M, AT_STD_M = np.array([0.046, -0.02, 0.01]), 1e-3
SIZES_N = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


@pytest.mark.parametrize("pull", ["x", "-y", "-z"])
def test_an_uncertain_place_makes_the_torques_uncertain_as_draws_of_it_scatter(pull: Pull) -> None:
    rng = np.random.default_rng(4)
    drawn = [applied_wrench(weight_n=0.981, pull=pull, at_m=AT_M + rng.normal(0, AT_STD_M, 3)) for _ in range(4000)]
    stated = place_error(load=applied_wrench(weight_n=0.981, pull=pull, at_m=AT_M), std_m=AT_STD_M)

    assert stated == pytest.approx(np.std(drawn, axis=0), rel=0.05, abs=1e-12)


def fz_of(reading_n: np.ndarray[tuple[int, ...], np.dtype[np.float64]], std_n: float) -> AxisFit:
    """Return the fit of Fz to readings (n,) under pulls along z."""
    load, reading = np.zeros((len(SIZES_N), 6)), np.zeros((len(SIZES_N), 6))
    load[:, 2], reading[:, 2] = SIZES_N, reading_n
    std, exact = np.full_like(load, std_n), np.zeros((len(load), len(load)))
    orientation = np.zeros(len(load), dtype=np.intp)
    return fit_axes(Loads(load=load, reading=reading, std=std, of_weights=exact, orientation=orientation))[AXES[2]]


def test_gain_and_linearity_scatter_and_covary_as_stated() -> None:
    rng = np.random.default_rng(5)
    gain, linearity, noise_n = 1.0, 0.5, 2e-3
    true_n = 0.3 + gain * (SIZES_N + linearity * SIZES_N**2)
    found = [fz_of(true_n + rng.normal(0, noise_n, len(SIZES_N)), noise_n) for _ in range(2000)]
    exact = fz_of(true_n, noise_n)

    assert exact.values == pytest.approx([gain, linearity])
    spread = np.cov([one.values for one in found], rowvar=False)
    assert np.sqrt(np.diag(exact.covariance)) == pytest.approx(np.sqrt(np.diag(spread)), rel=0.06)
    assert exact.covariance[0, 1] == pytest.approx(spread[0, 1], rel=0.1)
