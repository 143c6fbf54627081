"""Encoders whose reading stands still for part of a swing, and those where it only seems to."""

import functools
import math
import re

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError
from cfid.sim.plants import HandRelease, Motion, Pendulum, swing
from cfid.swing.estimation import SwingFit
from tests.swing.fitting import fitted

Array = npt.NDArray[np.float64]

PENDULUM = Pendulum(axis_inertia_kg_m2=3.1e-5, gravity_moment_nm=6.28e-3, viscous_nms_per_rad=1.5e-5, coulomb_nm=4e-5)
FREQUENCY_S2 = PENDULUM.gravity_moment_nm / PENDULUM.axis_inertia_kg_m2
STEPS = {"fine": 0.0, "13 bits": 2 * math.pi / 8192, "1 degree": math.radians(1)}
EVERY_MS = 5


@functools.cache
def swung() -> Motion:
    return swing([PENDULUM], [HandRelease(angle_rad=0.9)], duration_s=12.0, step_s=1e-3, store_every=1)


def read(steps: str) -> Array:
    """Return readings (n,) every millisecond, with noise of 0.3 mrad and an encoder's steps."""
    angle = swung().angle_rad[:, 0] + 3e-4 * np.random.default_rng(1).standard_normal(len(swung().time_s))
    return np.asarray(STEPS[steps] * np.floor(angle / STEPS[steps]) if STEPS[steps] else angle)


def frozen(fit: SwingFit) -> list[str]:
    return [one.text for one in fit.findings if one.code == "swing-angle-frozen"]


def error_in_std(fit: SwingFit) -> float:
    return (fit.coefficients.natural_frequency_squared_s2 - FREQUENCY_S2) / fit.std.natural_frequency_squared_s2


@pytest.mark.parametrize("steps", ["fine", "13 bits"])
@pytest.mark.parametrize("for_s", [0.05, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("at_s", [3.0, 3.06, 3.12, 3.18])  # an eighth of a period apart
def test_readings_that_stand_still_while_the_body_swings_are_left_out_and_named(
    steps: str, for_s: float, at_s: float
) -> None:
    time_s, angle = swung().time_s[::EVERY_MS].copy(), read(steps)[::EVERY_MS].copy()
    first, count = round(1e3 * at_s / EVERY_MS), round(1e3 * for_s / EVERY_MS)
    angle[first : first + count] = angle[first]
    fit = fitted(time_s, angle)

    assert fit.accepted
    assert abs(error_in_std(fit)) < 3
    (text,) = frozen(fit)
    assert f"after {at_s:.3g} s" in text or steps != "fine"  # at a turning point, earlier readings may be the same
    rows = int(re.findall(r"(\d+) rows are left out", text)[0])
    assert count - 1 <= rows <= (count - 1 if steps == "fine" else count + 2)


def slowly_damped() -> tuple[Array, Array]:
    body = Pendulum(axis_inertia_kg_m2=3.2e-5, gravity_moment_nm=6.29e-3, viscous_nms_per_rad=1.5e-6, coulomb_nm=1e-7)
    motion = swing([body], [HandRelease(angle_rad=1.0)], duration_s=20.0, step_s=1e-3, store_every=EVERY_MS)
    return motion.time_s, motion.angle_rad[:, 0] + 1e-3 * np.random.default_rng(1).standard_normal(len(motion.time_s))


def test_a_second_that_stands_still_in_a_slowly_damped_swing_costs_no_accuracy() -> None:
    time_s, angle = slowly_damped()
    whole = fitted(time_s, angle).coefficients.natural_frequency_squared_s2
    angle[1600:1800] = angle[1600]
    fit = fitted(time_s, angle)

    assert fit.accepted
    assert fit.coefficients.natural_frequency_squared_s2 == pytest.approx(whole, rel=2e-5)
    assert abs(fit.coefficients.natural_frequency_squared_s2 - 6.29e-3 / 3.2e-5) < 2 * fit.std[0]


def test_an_angle_that_stands_still_for_most_of_a_swing_is_named_where_the_rest_is_refused() -> None:
    time_s, angle = slowly_damped()
    angle[600:3200] = angle[600]

    with pytest.raises(DataError, match=r"the angle stands still for 13 s, after 3 s, .* Nothing was recorded"):
        fitted(time_s, angle)


def test_segments_that_stand_still_are_counted() -> None:
    time_s, angle = swung().time_s[::EVERY_MS].copy(), read("13 bits")[::EVERY_MS].copy()
    for first in (500, 700):
        angle[first : first + 20] = angle[first]
    fit = fitted(time_s, angle)
    (text,) = frozen(fit)

    assert fit.accepted
    assert "stands still 2 times, for up to 0.095 s, the first time after 2.5 s, while the body swings" in text
    assert "38 rows are left out" in text


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("repeated", [1, 5, 20])
def test_a_coarse_or_slow_encoder_does_not_stand_still(steps: str, repeated: int) -> None:
    time_s, angle = swung().time_s, np.repeat(read(steps)[::repeated], repeated)[: len(swung().time_s)]

    assert frozen(fitted(time_s, angle)) == []


def test_a_body_that_is_held_before_it_is_released_does_not_stand_still() -> None:
    angle = read("13 bits")
    held = np.concatenate([np.full(2000, angle[0]), angle])
    time_s: Array = 1e-3 * np.arange(len(held), dtype=np.float64)

    assert frozen(fitted(time_s, held)) == []
