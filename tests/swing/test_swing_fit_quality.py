"""How the default fit of a swing judges itself: damping, rejections, standard uncertainties."""

import functools
import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.sim.plants import HandRelease, Motion, Pendulum, swing
from cfid.swing.estimation import fit_swing
from cfid.swing.window import FreeSwing, find_swing

Array = npt.NDArray[np.float64]

INERTIA, MOMENT = 3.1e-5, 6.28e-3


@functools.cache
def swung(degrees: float, **damping: float) -> Motion:
    pendulum = Pendulum(axis_inertia_kg_m2=INERTIA, gravity_moment_nm=MOMENT, **damping)
    return swing([pendulum], [HandRelease(angle_rad=math.radians(degrees))], duration_s=9.0, step_s=1e-3)


def recorded(
    *, noise_rad: float = 5e-4, extra: Array | float = 0.0, degrees: float = 50, **damping: float
) -> tuple[Array, Array]:
    motion = swung(degrees, **damping)
    noise = np.random.default_rng(4).normal(0, noise_rad, len(motion.time_s))
    return motion.time_s, motion.angle_rad[:, 0] + noise + extra


def found(**kinds: float) -> FreeSwing:
    return find_swing(*recorded(**kinds))


@pytest.mark.parametrize(
    "damping",
    [
        {"viscous_nms_per_rad": 2.5e-5},
        {"coulomb_nm": 1e-4},
        {"viscous_nms_per_rad": 1.5e-5, "coulomb_nm": 6e-5},
    ],
)
def test_the_damping_that_acted_lies_within_the_uncertainties_of_what_is_found(damping: dict[str, float]) -> None:
    fit = fit_swing(found(**damping))
    acted = [damping.get(name, 0.0) / INERTIA for name in ("viscous_nms_per_rad", "coulomb_nm", "quadratic")]

    for value, true, std in zip(fit.coefficients[1:4], acted, fit.std[1:4], strict=True):
        assert abs(value - true) <= 3 * std + 2e-3 * abs(true)
    assert min(fit.coefficients[1:3]) >= 0
    assert fit.accepted


def test_a_second_motion_on_top_is_rejected() -> None:
    time_s = recorded(viscous_nms_per_rad=1.5e-5)[0]
    arm = 0.012 * np.sin(2 * math.pi * 7.3 * time_s)
    fit = fit_swing(find_swing(*recorded(viscous_nms_per_rad=1.5e-5, extra=arm)))

    assert not fit.accepted
    assert "swing-waveform-distorted" in [finding.code for finding in fit.findings]


def test_a_pendulum_whose_frequency_drifts_is_rejected() -> None:
    time_s, angle = recorded(viscous_nms_per_rad=1.5e-5)
    slowed = time_s * (1 + 0.004 * np.maximum(time_s - 2.0, 0))
    fit = fit_swing(find_swing(slowed, angle))

    assert "swing-frequency-drift" in {finding.code for finding in fit.findings}


def test_correlated_noise_widens_the_standard_uncertainty_and_white_noise_does_not() -> None:
    time_s, clean = recorded(viscous_nms_per_rad=1.5e-5, noise_rad=0.0)
    rng = np.random.default_rng(7)
    white = rng.normal(0, 1e-3, len(time_s))
    kernel = np.ones(40) / math.sqrt(40)  # same variance, each value shared by forty neighbours
    correlated = np.convolve(rng.normal(0, 1e-3, len(time_s) + 39), kernel, mode="valid")
    first, second = (fit_swing(find_swing(time_s, clean + noise)) for noise in (white, correlated))

    ratio = second.std.natural_frequency_squared_s2 / first.std.natural_frequency_squared_s2
    assert 4 < ratio < 9  # sqrt(40) = 6.3
    assert first.residual_rms_rad == pytest.approx(second.residual_rms_rad, rel=0.1)


def test_the_stated_uncertainty_of_the_zero_is_its_scatter_over_noise() -> None:
    time_s, clean = recorded(viscous_nms_per_rad=1.5e-5, noise_rad=0.0)
    rng = np.random.default_rng(12)
    swings = [find_swing(time_s, clean + rng.normal(0, 1e-3, len(time_s)), peaks=6) for _ in range(24)]
    fits = [fit_swing(one) for one in swings]
    values = np.array([one.rest_rad + fit.coefficients.zero_rad for one, fit in zip(swings, fits, strict=True)])
    stated = np.array([fit.std.zero_rad for fit in fits])

    # A standard deviation of 24 values is uncertain by 15 %.
    assert 0.55 < values.std(ddof=1) / stated.mean() < 1.45
    assert abs(values.mean()) < 3 * stated.mean() / np.sqrt(24)
