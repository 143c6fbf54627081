"""The simulated plants against closed forms and an independent, adaptive, event-based integration."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.special import ellipk

from cfid.sim.plants import DroppingWeight, HandRelease, Motion, Pendulum, drop, swing

Array = npt.NDArray[np.float64]

CRAZYFLIE = Pendulum(axis_inertia_kg_m2=3.1e-5, gravity_moment_nm=6.3e-3)
OMEGA_RAD_PER_S = math.sqrt(CRAZYFLIE.gravity_moment_nm / CRAZYFLIE.axis_inertia_kg_m2)
DEGREES = (10, 20, 30, 40, 50, 60, 70)
STEP_S = 5e-4


def _quick_hand(angle_rad: float) -> HandRelease:
    return HandRelease(angle_rad=angle_rad, wait_s=0.05, lift_s=0.3, hold_s=0.1)


@pytest.fixture(scope="module")
def undamped() -> Motion:
    return swing([CRAZYFLIE] * len(DEGREES), [_quick_hand(math.radians(d)) for d in DEGREES], duration_s=7.5)


def _free_from(motion: Motion, release: HandRelease) -> int:
    return int(np.searchsorted(motion.time_s, release.free_s + 2 * STEP_S))


def _energy(motion: Motion) -> Array:
    """Return energy over gravity moment, which is 1 - cos(amplitude) for a free swing."""
    swinging = (motion.speed_rad_per_s / OMEGA_RAD_PER_S) ** 2 / 2
    return np.asarray(1 - np.cos(motion.angle_rad) + swinging)


def _zero_crossings(motion: Motion, column: int, begin: int) -> Array:
    spline = CubicHermiteSpline(
        motion.time_s[begin:], motion.angle_rad[begin:, column], motion.speed_rad_per_s[begin:, column]
    )
    return np.asarray(spline.roots(extrapolate=False))


def test_a_free_swing_has_the_period_of_the_elliptic_integral(undamped: Motion) -> None:
    begin = _free_from(undamped, _quick_hand(1))
    amplitude_rad = np.arccos(1 - _energy(undamped)[begin])
    expected_s = 4 / OMEGA_RAD_PER_S * ellipk(np.sin(amplitude_rad / 2) ** 2)
    for column, period_s in enumerate(expected_s):
        upward_s = _zero_crossings(undamped, column, begin)[::2]
        assert (upward_s[-1] - upward_s[0]) / (upward_s.size - 1) == pytest.approx(period_s, rel=1e-9)


def test_a_free_swing_without_damping_keeps_its_energy(undamped: Motion) -> None:
    energy = _energy(undamped)[_free_from(undamped, _quick_hand(1)) :]
    assert np.ptp(energy, axis=0) / energy[0] == pytest.approx(0, abs=1e-9)


def _slope(pendulum: Pendulum, direction: float) -> Callable[[float, Array], list[float]]:
    def slope(_: float, state: Array) -> list[float]:
        angle, speed = state
        torque = -pendulum.gravity_moment_nm * math.sin(angle - pendulum.rest_rad)
        torque -= pendulum.viscous_nms_per_rad * speed + direction * pendulum.coulomb_nm
        torque -= direction * pendulum.quadratic_nms2_per_rad2 * speed**2
        return [speed, torque / pendulum.axis_inertia_kg_m2]

    return slope


def _stops(_: float, state: Array) -> float:
    return float(state[1])


_stops.terminal = True  # type: ignore[attr-defined]


def _strokes(pendulum: Pendulum, begin_s: float, state: Array) -> Iterator[tuple[float, float, object]]:
    """Yield strokes between standstills: friction keeps its direction within each, so the solver sees no jump."""
    direction = np.sign(state[1])
    while True:
        _stops.direction = -direction  # type: ignore[attr-defined]
        solution = solve_ivp(
            _slope(pendulum, direction),
            (begin_s, begin_s + 5),
            state,
            method="DOP853",
            rtol=1e-11,
            atol=1e-12,
            events=_stops,
            dense_output=True,
        )
        begin_s, state = solution.t[-1], np.array([solution.y[0, -1], 0.0])
        yield solution.t[0], begin_s, solution.sol
        pull_nm = pendulum.gravity_moment_nm * math.sin(state[0] - pendulum.rest_rad)
        if abs(pull_nm) <= pendulum.coulomb_nm:
            return
        direction = -np.sign(pull_nm)


def _reference(pendulum: Pendulum, motion: Motion, begin: int) -> tuple[Array, float]:
    """Return angles at the motion's times, nan where no stroke reaches, and the end of the last stroke."""
    start = np.array([motion.angle_rad[begin, 0], motion.speed_rad_per_s[begin, 0]])
    angle_rad = np.full(motion.time_s.size, np.nan)
    for stroke_s, end_s, solution in _strokes(pendulum, motion.time_s[begin], start):
        inside = (motion.time_s >= stroke_s) & (motion.time_s <= end_s)
        assert callable(solution)
        if inside.any():
            angle_rad[inside] = solution(motion.time_s[inside])[0]
        if end_s > motion.time_s[-1]:
            break
    return angle_rad, end_s


@pytest.mark.parametrize(
    "pendulum",
    [
        replace(CRAZYFLIE, viscous_nms_per_rad=1e-5, coulomb_nm=4e-5),
        replace(CRAZYFLIE, coulomb_nm=1e-4, quadratic_nms2_per_rad2=5e-8, rest_rad=0.3),
        replace(CRAZYFLIE, coulomb_nm=6e-4),
    ],
    ids=["viscous and dry", "dry and quadratic, rest aside", "very dry"],
)
def test_a_braked_swing_follows_an_adaptive_solver_that_stops_at_every_reversal(pendulum: Pendulum) -> None:
    release = _quick_hand(math.radians(55))
    motion = swing([pendulum], [release], duration_s=7.5)
    begin = _free_from(motion, release)
    expected_rad, _ = _reference(pendulum, motion, begin)
    moving = np.isfinite(expected_rad)
    assert motion.angle_rad[moving, 0] == pytest.approx(expected_rad[moving], abs=2e-9)
    if not moving[-1]:  # the body stays at its last standstill
        assert np.all(motion.speed_rad_per_s[moving.nonzero()[0][-1] + 1 :] == 0)


@pytest.mark.parametrize("step_s", [5e-4, 2e-3])
def test_dry_friction_brings_a_swing_to_rest_off_its_rest_and_there_it_stays(step_s: float) -> None:
    pendulum = replace(CRAZYFLIE, coulomb_nm=3e-4, rest_rad=-0.1)
    release = _quick_hand(math.radians(50))
    motion = swing([pendulum], [release], duration_s=6.0, step_s=step_s, store_every=1)
    _, expected_s = _reference(pendulum, motion, _free_from(motion, release))
    last_motion_s = motion.time_s[np.flatnonzero(motion.speed_rad_per_s[:, 0])[-1]]
    resting_rad = motion.angle_rad[motion.time_s > expected_s + step_s, 0]
    assert last_motion_s == pytest.approx(expected_s, abs=2 * step_s)
    assert np.ptp(resting_rad) == 0
    off_rest_rad = abs(resting_rad[0] - pendulum.rest_rad)
    held_within_rad = math.asin(pendulum.coulomb_nm / pendulum.gravity_moment_nm)
    assert 0.001 < off_rest_rad <= held_within_rad


# Dropping weights

WAIT_S = 0.5
FIFTY_GRAMS = DroppingWeight(
    setup_inertia_kg_m2=4e-7,
    weight_kg=0.05,
    radius_m=2e-3,
    viscous_nms_per_rad=1.2e-6,
    coulomb_nm=2.5e-4,
)


def test_the_speed_rises_as_the_exponential_with_the_weights_own_inertia() -> None:
    motion = drop([FIFTY_GRAMS], duration_s=1.3, wait_s=WAIT_S)
    falling = (motion.time_s >= WAIT_S) & (motion.angle_rad[:, 0] < 499)
    since_s = motion.time_s[falling] - WAIT_S
    inertia_kg_m2 = 4e-7 + 0.05 * 2e-3**2
    steady_rad_per_s = (0.05 * 9.81 * 2e-3 - 2.5e-4) / 1.2e-6
    expected = steady_rad_per_s * (1 - np.exp(-since_s * 1.2e-6 / inertia_kg_m2))
    assert since_s[-1] > 0.7
    assert motion.speed_rad_per_s[falling, 0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_slack_line_lets_the_axis_coast_down_on_friction_alone() -> None:
    motion = drop([FIFTY_GRAMS], duration_s=3.0, wait_s=WAIT_S)
    slack = int(np.searchsorted(motion.angle_rad[:, 0], FIFTY_GRAMS.drop_m / FIFTY_GRAMS.radius_m)) + 1
    since_s = motion.time_s[slack:] - motion.time_s[slack]
    dry_rad_per_s = 2.5e-4 / 1.2e-6
    start_rad_per_s = motion.speed_rad_per_s[slack, 0]
    expected = (start_rad_per_s + dry_rad_per_s) * np.exp(-since_s * 1.2e-6 / 4e-7) - dry_rad_per_s
    assert start_rad_per_s > 300
    assert motion.speed_rad_per_s[slack:, 0] == pytest.approx(np.maximum(expected, 0), abs=1e-6)
    assert np.ptp(motion.angle_rad[-100:, 0]) == 0
