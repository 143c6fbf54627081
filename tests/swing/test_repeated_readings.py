"""Encoders that take readings less often than rows are sent, that stand still, and those that only seem to."""

import functools
import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.sim.plants import HandRelease, Motion, Pendulum, swing
from cfid.swing.estimation import SwingFit, fit_swing
from cfid.swing.window import swing_in
from tests.recordings.made import made_angle

Array = npt.NDArray[np.float64]

PENDULUM = Pendulum(axis_inertia_kg_m2=3.1e-5, gravity_moment_nm=6.28e-3, viscous_nms_per_rad=1.5e-5, coulomb_nm=4e-5)
FREQUENCY_S2 = PENDULUM.gravity_moment_nm / PENDULUM.axis_inertia_kg_m2
STEPS_RAD = {"fine": 1e-9, "13 bits": 2 * math.pi / 8192, "1 degree": math.radians(1)}
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


def fitted(time_s: Array, angle_rad: Array) -> SwingFit:
    return fit_swing(swing_in(made_angle(time_s, angle_rad)))


def codes(fit: SwingFit) -> list[str]:
    return [finding.code for finding in fit.findings]


def once_each(every_ms: int, first_ms: int) -> float:
    """Return W of the same readings, each at its own time."""
    time_s, angle = read(every_ms, "13 bits", first_ms=first_ms)
    rows = np.arange(-(-first_ms // ROW_MS), len(time_s)) * ROW_MS
    new = rows[np.flatnonzero(np.diff((rows - first_ms) // every_ms, prepend=-1))] // ROW_MS
    return fitted(time_s[new], angle[new]).coefficients.natural_frequency_squared_s2


@pytest.mark.parametrize(("every_ms", "first_ms"), [(20, 1), (20, 16), (21, 0)])  # 21 ms are now ten, now eleven rows
def test_readings_that_rows_repeat_are_named_and_count_once_each(every_ms: int, first_ms: int) -> None:
    fit = fitted(*read(every_ms, "13 bits", first_ms=first_ms))

    assert fit.accepted
    assert "swing-angle-repeated" in codes(fit)
    assert fit.coefficients.natural_frequency_squared_s2 == pytest.approx(once_each(every_ms, first_ms), rel=6e-5)
    assert abs(fit.coefficients.natural_frequency_squared_s2 - FREQUENCY_S2) < 2.5 * fit.std[0]


def test_a_coarse_sensor_that_is_read_for_every_row_repeats_nothing() -> None:
    time_s, angle_rad = read(ROW_MS, "1 degree")
    kept = np.random.default_rng(2).random(len(time_s)) > 0.05  # lost lines look like steps
    time_s, angle_rad = time_s[kept], angle_rad[kept]
    angle_rad[::100] += 0.03  # and so do single wrong readings

    assert "swing-angle-repeated" not in codes(fitted(time_s, angle_rad))


@pytest.mark.parametrize("steps", STEPS_RAD)
@pytest.mark.parametrize("every_ms", [2, 10, 20])
def test_a_coarse_or_slow_encoder_does_not_stand_still(steps: str, every_ms: int) -> None:
    assert fitted(*read(every_ms, steps)).accepted


@pytest.mark.parametrize("steps", ["fine", "13 bits"])
@pytest.mark.parametrize("for_s", [0.1, 1.0])
@pytest.mark.parametrize("at_s", [3.0, 3.06, 3.12, 3.18])  # an eighth of a period apart
def test_readings_that_stand_still_while_the_body_swings_are_rejected(steps: str, for_s: float, at_s: float) -> None:
    time_s, angle = (values[:6000] for values in read(ROW_MS, steps))
    standing = (time_s >= at_s) & (time_s < at_s + for_s)
    angle[standing] = angle[standing][0]

    assert "swing-waveform-distorted" in codes(fitted(time_s, angle))
