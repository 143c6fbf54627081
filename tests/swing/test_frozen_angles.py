"""Encoders whose reading stands still for part of a swing, and those where it only seems to."""

import functools
import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.sim.plants import HandRelease, Motion, Pendulum, swing
from tests.swing.fitting import fitted

Array = npt.NDArray[np.float64]

PENDULUM = Pendulum(axis_inertia_kg_m2=3.1e-5, gravity_moment_nm=6.28e-3, viscous_nms_per_rad=1.5e-5, coulomb_nm=4e-5)
STEPS = {"fine": 0.0, "13 bits": 2 * math.pi / 8192, "1 degree": math.radians(1)}
EVERY_MS = 5


@functools.cache
def swung() -> Motion:
    return swing([PENDULUM], [HandRelease(angle_rad=0.9)], duration_s=12.0, step_s=1e-3, store_every=1)


def read(steps: str) -> Array:
    """Return readings (n,) every millisecond, with noise of 0.3 mrad and an encoder's steps."""
    angle = swung().angle_rad[:, 0] + 3e-4 * np.random.default_rng(1).standard_normal(len(swung().time_s))
    return np.asarray(STEPS[steps] * np.floor(angle / STEPS[steps]) if STEPS[steps] else angle)


@pytest.mark.parametrize("steps", ["fine", "13 bits"])
@pytest.mark.parametrize("for_s", [0.1, 1.0])
@pytest.mark.parametrize("at_s", [3.0, 3.06, 3.12, 3.18])  # an eighth of a period apart
def test_readings_that_stand_still_while_the_body_swings_are_rejected(steps: str, for_s: float, at_s: float) -> None:
    time_s, angle = swung().time_s[::EVERY_MS].copy(), read(steps)[::EVERY_MS].copy()
    first, count = round(1e3 * at_s / EVERY_MS), round(1e3 * for_s / EVERY_MS)
    angle[first : first + count] = angle[first]

    assert "swing-waveform-distorted" in [finding.code for finding in fitted(time_s, angle).findings]


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("repeated", [1, 5, 20])
def test_a_coarse_or_slow_encoder_does_not_stand_still(steps: str, repeated: int) -> None:
    time_s, angle = swung().time_s, np.repeat(read(steps)[::repeated], repeated)[: len(swung().time_s)]

    assert fitted(time_s, angle).accepted


def test_a_body_that_is_held_before_it_is_released_does_not_stand_still() -> None:
    angle = read("13 bits")
    held = np.concatenate([np.full(2000, angle[0]), angle])
    time_s: Array = 1e-3 * np.arange(len(held), dtype=np.float64)

    assert fitted(time_s, held).accepted
