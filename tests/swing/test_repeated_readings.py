"""Encoders that take readings less often than rows are sent."""

import functools
import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.sim.plants import HandRelease, Motion, Pendulum, swing
from cfid.swing.estimation import SwingFit
from tests.swing.fitting import fitted

Array = npt.NDArray[np.float64]

PENDULUM = Pendulum(axis_inertia_kg_m2=3.1e-5, gravity_moment_nm=6.28e-3, viscous_nms_per_rad=1.5e-5, coulomb_nm=4e-5)
FREQUENCY_S2 = PENDULUM.gravity_moment_nm / PENDULUM.axis_inertia_kg_m2
STEPS_RAD = {"13 bits": 2 * math.pi / 8192, "1 degree": math.radians(1)}
ROW_MS = 2


@functools.cache
def swung() -> Motion:
    return swing([PENDULUM], [HandRelease(angle_rad=0.6)], duration_s=25.0, step_s=1e-3, store_every=1)


def read(every_ms: int, steps: str, *, first_ms: int = 0) -> tuple[Array, Array]:
    """Return rows at 500 Hz, each with the latest reading of a sensor with noise of 0.3 mrad."""
    count = len(swung().time_s)
    latest = np.maximum((np.arange(count) - first_ms) // every_ms * every_ms + first_ms, 0)
    angle = swung().angle_rad[latest, 0] + 3e-4 * np.random.default_rng(1).standard_normal(count)[latest]
    return swung().time_s[::ROW_MS], (STEPS_RAD[steps] * np.floor(angle / STEPS_RAD[steps]))[::ROW_MS]


def once_each(every_ms: int, first_ms: int = 0) -> float:
    """Return W of the same readings, each at its own time."""
    time_s, angle = read(every_ms, "13 bits", first_ms=first_ms)
    rows = np.arange(-(-first_ms // ROW_MS), len(time_s)) * ROW_MS
    new = rows[np.flatnonzero(np.diff((rows - first_ms) // every_ms, prepend=-1))] // ROW_MS
    return fitted(time_s[new], angle[new]).coefficients.natural_frequency_squared_s2


def repeated(fit: SwingFit) -> list[str]:
    return [one.text for one in fit.findings if one.code == "swing-angle-repeated"]


@pytest.mark.parametrize("first_ms", [1, 7, 16])
def test_repeated_readings_of_a_slow_sensor_are_named_and_bias_nothing(first_ms: int) -> None:
    fit = fitted(*read(20, "13 bits", first_ms=first_ms))

    assert fit.accepted
    (text,) = repeated(fit)
    assert "repeated in about 10 rows: 500 rows a second show 50 readings" in text
    assert fit.coefficients.natural_frequency_squared_s2 == pytest.approx(once_each(20, first_ms), rel=6e-5)
    assert abs(fit.coefficients.natural_frequency_squared_s2 - FREQUENCY_S2) < 2.5 * fit.std[0]


def test_readings_that_are_repeated_now_ten_and_now_eleven_times_count_once_each() -> None:
    fit = fitted(*read(21, "13 bits"))

    assert repeated(fit)
    assert fit.coefficients.natural_frequency_squared_s2 == pytest.approx(once_each(21), rel=6e-5)
    assert abs(fit.coefficients.natural_frequency_squared_s2 - FREQUENCY_S2) < 2.5 * fit.std[0]


def test_repeated_readings_of_a_coarse_sensor_are_named() -> None:
    fit = fitted(*read(20, "1 degree"))

    assert repeated(fit)
    assert abs(fit.coefficients.natural_frequency_squared_s2 - FREQUENCY_S2) < 2.5 * fit.std[0]


@pytest.mark.parametrize("steps", STEPS_RAD)
def test_a_coarse_sensor_that_is_read_for_every_row_repeats_nothing(steps: str) -> None:
    time_s, angle_rad = read(ROW_MS, steps)
    kept = np.random.default_rng(2).random(len(time_s)) > 0.05  # lost lines look like steps
    time_s, angle_rad = time_s[kept], angle_rad[kept]
    angle_rad[::100] += 0.03  # and so do single wrong readings

    assert repeated(fitted(time_s, angle_rad)) == []
