"""The collocation fit against plants that share no code with it."""

import functools
import itertools
import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import savgol_filter

from cfid.estimate.signals import correlation_inflation, smooth
from cfid.sim.plants import HandRelease, Motion, Pendulum, swing
from cfid.swing.pendulum import OutputError, first_guess, fit_output_error

Array = npt.NDArray[np.float64]
TERMS = ("viscous", "coulomb", "quadratic")
Friction = tuple[float, float, float]

INERTIA, MOMENT = 4e-5, 0.028 * 9.81 * 0.0229
FREQUENCY = MOMENT / INERTIA
SMOOTH: list[Friction] = [(1.5e-5, 0.0, 0.0), (0.0, 0.0, 2e-6), (1.5e-5, 0.0, 2e-6)]
DRY: Friction = (1.5e-5, 4e-5, 0.0)
ALL_THREE: Friction = (1.5e-5, 4e-5, 2e-8)


SWINGS = [  # angle at the release in degrees; viscous, Coulomb and quadratic friction
    *itertools.product((10.0, 40.0, 70.0), SMOOTH),
    *itertools.product((10.0, 40.0, 70.0), [DRY]),
    (40.0, ALL_THREE),
    (60.0, (1.5e-5, 0.0, 2e-6)),
]


@functools.cache
def swung() -> Motion:
    """Return the motion of all swings, simulated at once, which takes no longer than one."""
    pendulums = [
        Pendulum(
            axis_inertia_kg_m2=INERTIA,
            gravity_moment_nm=MOMENT,
            viscous_nms_per_rad=viscous,
            coulomb_nm=coulomb,
            quadratic_nms2_per_rad2=quadratic,
        )
        for _, (viscous, coulomb, quadratic) in SWINGS
    ]
    releases = [HandRelease(angle_rad=math.radians(degrees)) for degrees, _ in SWINGS]
    return swing(pendulums, releases, duration_s=12.0, step_s=1e-3, store_every=1)


def free_swing(degrees: float, friction: Friction) -> tuple[Array, Array]:
    """Return a noiseless record from well after the release down to one degree."""
    time_s, angle = swung().time_s, swung().angle_rad[:, SWINGS.index((degrees, friction))]
    last = time_s[np.abs(angle) > math.radians(1.0)][-1]
    chosen = (time_s > HandRelease(angle_rad=math.radians(degrees)).free_s + 0.1) & (time_s < last)
    return time_s[chosen], angle[chosen]


def fitted(time_s: Array, angle: Array, terms: tuple[str, ...], step_s: float = 0.004) -> OutputError:
    coefficients, trajectory = first_guess(time_s, angle, start_s=float(time_s[0]), step_s=step_s)
    free = np.array([True, *(term in terms for term in TERMS), True, *[False] * 6])
    values = free * np.array([*coefficients, 0.0, 0.0])
    return fit_output_error(time_s, angle, values=values, free=free, trajectory=trajectory)


@pytest.mark.parametrize(("begin_s", "length_s"), [(1.0, 0.5), (2.5, 2.0)])
def test_a_gap_of_several_periods_costs_no_accuracy(begin_s: float, length_s: float) -> None:
    time_s, angle = free_swing(70.0, SMOOTH[0])
    kept = (time_s < time_s[0] + begin_s) | (time_s > time_s[0] + begin_s + length_s)
    fit = fitted(time_s[kept], angle[kept], TERMS)
    assert fit.converged
    assert fit.coefficients.natural_frequency_squared_s2 == pytest.approx(FREQUENCY, rel=1e-5)


@pytest.mark.parametrize("degrees", [10, 40, 70])
@pytest.mark.parametrize(
    ("damping", "terms"),
    list(zip(SMOOTH, [("viscous",), ("quadratic",), ("viscous", "quadratic")], strict=True)),
)
def test_smooth_damping_comes_back_to_a_millionth(degrees: float, damping: Friction, terms: tuple[str, ...]) -> None:
    fit = fitted(*free_swing(degrees, damping), terms)

    assert fit.converged
    assert fit.coefficients.natural_frequency_squared_s2 == pytest.approx(FREQUENCY, rel=1e-6)
    assert INERTIA * np.array(fit.coefficients[1:4]) == pytest.approx(damping, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize(("degrees", "limit"), [(10, 2e-5), (40, 4e-6), (70, 4e-6)])
def test_coulomb_friction_jumps_at_every_turn_and_still_comes_back(degrees: float, limit: float) -> None:
    fit = fitted(*free_swing(degrees, DRY), ("viscous", "coulomb"))

    assert fit.coefficients.natural_frequency_squared_s2 == pytest.approx(FREQUENCY, rel=limit)
    assert INERTIA * fit.coefficients.viscous_per_s == pytest.approx(1.5e-5, rel=2e-3)
    assert INERTIA * fit.coefficients.coulomb_per_s2 == pytest.approx(4e-5, rel=2e-3)


def test_the_jacobian_is_the_derivative_of_the_prediction() -> None:
    time_s, angle = free_swing(40, ALL_THREE)
    fit = fitted(time_s, angle, TERMS)
    held = fit_output_error(time_s, angle, values=fit.values, free=fit.free, trajectory=fit.trajectory)
    disturbed = angle + 1e-6 * held.jacobian @ np.array([3.0, 0.05, 0.2, 0.01, 0.001, 0.002, 0.02])
    moved = fitted(time_s, disturbed, TERMS)

    change = (moved.values - held.values)[held.free]
    assert change == pytest.approx(1e-6 * np.array([3.0, 0.05, 0.2, 0.01, 0.001]), rel=2e-2)


def test_smoothing_equals_the_savitzky_golay_filter() -> None:
    series = np.cumsum(np.random.default_rng(0).normal(size=80))
    smoothed = smooth(series, length=15, step_s=0.01)

    for order in range(3):
        assert smoothed[order] == pytest.approx(savgol_filter(series, 15, 3, deriv=order, delta=0.01), abs=1e-9)


def test_white_noise_is_not_inflated_and_correlated_noise_by_what_theory_says() -> None:
    rng = np.random.default_rng(2)
    white = rng.normal(size=40000)
    correlated = np.empty_like(white)
    correlated[0] = white[0]
    for i in range(1, len(white)):
        correlated[i] = 0.8 * correlated[i - 1] + white[i]

    assert correlation_inflation(white, longest=200) == pytest.approx(1.0, abs=0.1)
    # For a first-order process with coefficient a, theory gives (1 + a) / (1 - a).
    assert correlation_inflation(correlated, longest=200) == pytest.approx(9.0, rel=0.1)
