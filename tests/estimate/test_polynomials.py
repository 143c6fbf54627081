"""Polynomials through points: MATLAB's numbers, coverage of intervals, wild points, and the order that points allow."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import FitError
from cfid.estimate.polynomials import fit_polynomial
from tests.coverage_rows import reaches_93_percent

Array = npt.NDArray[np.float64]

COMMANDS = np.arange(2000.0, 64001.0, 2000.0)
EQ_3_3 = (2.130295e-11, 1.032633e-6, 5.484560e-4)
EQ_3_4 = ((0.03950236, 420.9420, 599.6187), (0.04076521, 380.8359, 471.0714))  # slope, level, norm of the residuals


@pytest.mark.parametrize(("slope", "level", "printed"), EQ_3_4)
def test_the_thesis_residual_norms_are_of_this_definition(slope: float, level: float, printed: float) -> None:
    """One of 32 points (C.2.3) is command 0 at zero, so the line's level alone is a residual of 381 or 421 rad/s.

    The rest of the norm is then 67 or 69 rad/s per point, in a range of 3000 rad/s. If the norm were an rms, each
    residual would be a fifth of the range.
    """
    commands = np.concatenate([[0.0], np.arange(4000.0, 64001.0, 2000.0)])
    rows = np.vander(commands, 2)
    across = np.eye(32) - rows @ np.linalg.pinv(rows)
    standing = -level / across[0, 0] * across[0]  # the smallest residual that starts with minus the level
    noise = across @ np.random.default_rng(1).standard_normal(32)
    noise -= noise[0] / across[0, 0] * across[0]
    noise *= math.sqrt(printed**2 - standing @ standing) / np.linalg.norm(noise)
    speeds = slope * commands + level + standing + noise
    fit = fit_polynomial(commands, speeds, order=1)

    assert abs(speeds[0]) < 1e-9
    assert np.linalg.norm(standing) < printed < 2 * np.linalg.norm(standing)
    assert fit.residual_norm == pytest.approx(printed, rel=1e-9)
    assert f"{fit.coefficients[0]:.8f} {fit.coefficients[1]:.4f}" == f"{slope:.8f} {level:.4f}"


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_coefficients_are_those_of_polyfit_in_plain_powers(order: int) -> None:
    rng = np.random.default_rng(order)
    thrust = np.polyval(EQ_3_3, COMMANDS) + 1e-3 * rng.standard_normal(len(COMMANDS))
    std = rng.uniform(1e-3, 3e-3, len(COMMANDS))

    assert fit_polynomial(COMMANDS, thrust, order=order).coefficients == pytest.approx(
        np.polyfit(COMMANDS, thrust, order), rel=1e-6
    )
    weighted = fit_polynomial(COMMANDS, thrust, order=order, std=std)
    assert weighted.coefficients == pytest.approx(np.polyfit(COMMANDS, thrust, order, w=1 / std), rel=1e-6)


def test_points_farther_apart_than_stated_widen_the_covariance_and_closer_ones_do_not_narrow_it() -> None:
    x = np.arange(20.0)
    y = 3 * x + np.random.default_rng(4).standard_normal(20)
    close, right, far = (fit_polynomial(x, y, order=1, std=np.full(20, std)) for std in (10.0, 1.0, 0.1))
    scatter = right.residual_norm / math.sqrt(18)

    assert close.inflation == 1
    assert close.std == pytest.approx(10 * right.std / (right.inflation or math.nan))
    assert far.inflation == pytest.approx(scatter / 0.1)
    assert far.std == pytest.approx(fit_polynomial(x, y, order=1).std)
    assert close.quantile == pytest.approx(1.95996, abs=1e-4)
    assert far.quantile == pytest.approx(2.10092, abs=1e-4)


def coverage(*, count: int, stated: float | None, robust: bool = False, wild: bool = False) -> tuple[float, float]:
    """Return how often the bands contain the true curve and another point, over 1000 simulated thrust maps."""
    rng = np.random.default_rng(20261121)
    x = np.linspace(2000, 64000, count)
    truth = np.polyval(EQ_3_3, x)
    std: Array = np.full(count, 3e-4) if stated is None else np.asarray(1e-4 + 3e-3 * truth)
    held, held_points = [], []
    for _ in range(1000):
        y = truth + std * rng.standard_normal(count)
        if wild:
            y[rng.integers(count)] += 20 * std.mean()
        fit = fit_polynomial(x, y, order=2, std=None if stated is None else np.asarray(stated * std), robust=robust)
        held.append(np.abs(fit.at(x) - truth) <= fit.confidence(x))
        another = truth + std * rng.standard_normal(count)
        held_points.append(np.abs(fit.at(x) - another) <= fit.prediction(x))
    return float(np.mean(held)), float(np.mean(held_points))


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("stated", [None, pytest.param(1.0, marks=pytest.mark.slow), 0.5])
def test_bands_hold_curve_and_points_93_to_97_times_in_100(stated: float | None, robust: bool) -> None:
    curve, points = coverage(count=31, stated=stated, robust=robust)
    print(f"deviations {stated}, robust {robust}: curve {curve:.3f}, another point {points:.3f}")

    assert 0.93 <= curve <= 0.97
    assert 0.93 <= points <= 0.97


@pytest.mark.parametrize("grows", [False, True])
def test_intervals_of_points_that_state_nothing_hold_whether_they_scatter_alike_or_in_proportion(grows: bool) -> None:
    rng, x = np.random.default_rng(4), np.arange(4000.0, 64001.0, 4000.0)
    true = np.array([0.0407, 380.8])
    speed = np.polyval(true, x)
    fits = [
        fit_polynomial(x, speed + 0.005 * (speed if grows else 2000) * rng.standard_normal(16), order=1, robust=True)
        for _ in range(300)
    ]
    held = np.array([np.abs(fit.coefficients - true) < 1.96 * fit.std for fit in fits])

    assert reaches_93_percent(held[:, 0])
    assert reaches_93_percent(held[:, 1])


def test_with_a_wild_point_the_robust_band_holds_the_curve_as_often_as_it_says() -> None:
    assert 0.93 <= coverage(count=31, stated=1.0, robust=True, wild=True)[0] <= 0.97


@pytest.mark.parametrize(
    ("x", "std", "said"),
    [
        ([1.0, 2.0], None, "2 points are too few for a polynomial of order 2, which has 3 coefficients"),
        ([1.0, 1.0, 2.0, 2.0], None, "4 points at 2 different places do not determine 3 coefficients"),
        ([0.0, 0.0, 0.0], None, "3 points at 1 different places"),
        ([1.0, 2.0, 3.0, 4.0], [1.0, 1.0, 0.0, 1.0], "the standard uncertainty of point 3 is 0"),
        ([1.0, 2.0, 3.0, 4.0], [1.0, math.nan, 1.0, 1.0], "the standard uncertainty of point 2 is nan"),
        ([1.0, 2.0, 3.0, math.nan], None, "no finite number"),
    ],
)
def test_points_that_determine_nothing_are_refused(x: list[float], std: list[float] | None, said: str) -> None:
    with pytest.raises(FitError, match=said):
        fit_polynomial(np.array(x), np.array(x) * 2, order=2, std=None if std is None else np.array(std))


def test_errors_that_points_share_widen_the_band_as_much_as_they_move_the_curve() -> None:
    """Neighbouring points share a tare: bands cover the curve, but would not if errors were taken as independent."""
    x = np.arange(1.0, 21.0)
    tares = 0.5 * (np.eye(20, 21) + np.eye(20, 21, 1))  # half the tare before, half the tare after
    std = np.sqrt(0.3**2 + np.sum(tares**2, axis=1))
    rng = np.random.default_rng(7)
    held = []
    for _ in range(500):
        y = 2 * x + 0.3 * rng.standard_normal(20) + tares @ rng.standard_normal(21)
        held.append(
            [
                np.mean(np.abs(fit.at(x) - 2 * x) <= fit.confidence(x))
                for fit in (
                    fit_polynomial(x, y, order=1, std=std, shared=tares),
                    fit_polynomial(x, y, order=1, std=std),
                )
            ]
        )
    shared, apart = np.mean(held, axis=0).tolist()

    assert 0.93 <= shared <= 0.98
    assert apart < 0.9


def test_points_exactly_on_a_curve_are_fitted_robustly_too() -> None:
    """Rounding errors are no scatter: earlier, their scale fell to zero, and weights were not finite."""
    x = np.repeat(np.arange(5000.0, 70000.0, 5000.0), 2)
    found = fit_polynomial(x, np.repeat(np.arange(380.0, 2541.0, 180.0), 2), order=1, robust=True)
    assert found.coefficients == pytest.approx([0.036, 200.0], rel=1e-10)
    assert np.all(np.isfinite(found.covariance))
