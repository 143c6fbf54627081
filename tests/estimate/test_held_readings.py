"""Rows that repeat a reading are distinguished from those of a sensor with coarse steps, whatever it measures."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from cfid.estimate.held_readings import first_rows, rows_a_reading

Array = npt.NDArray[np.float64]

RATE_HZ, SECONDS, LONGEST = 100, 30, 30


def new_rows(readings: Array, *, longest: float) -> npt.NDArray[np.bool_]:
    return first_rows(readings, rows=rows_a_reading(readings, longest=longest))


def following(*, tau_s: float) -> Array:
    """Return a speed with a lag behind a command that steps every second."""
    begin, speed, since_s = 1000.0, [], np.arange(RATE_HZ) / RATE_HZ
    for level in np.random.default_rng(1).uniform(500, 2000, SECONDS):
        speed.append(level + (begin - level) * np.exp(-since_s / tau_s))
        begin = level
    return np.concatenate(speed)


def noisy(speed: Array, seed: int, *, noise: float) -> Array:
    return speed + np.random.default_rng(seed).normal(0, noise, len(speed))


SENSORS: dict[str, Callable[[Array], Array]] = {
    "fine": lambda speed: noisy(speed, 3, noise=2.0),
    "fine, without noise": lambda speed: speed,
    "steps of its noise": lambda speed: 5 * np.round(noisy(speed, 3, noise=5.0) / 5),
    "coarse": lambda speed: 10 * np.round(noisy(speed, 3, noise=2.0) / 10),
    "coarse, without noise": lambda speed: 10 * np.round(speed / 10),
    "counted time": lambda speed: 4e6 / np.round(4e6 / np.maximum(noisy(speed, 3, noise=1.0), 1)),
}


@pytest.mark.parametrize("tau_s", [0.002, 0.02, 0.1])
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensor_with_a_reading_in_each_row_loses_none(sensor: str, tau_s: float) -> None:
    speed = following(tau_s=tau_s)
    assert new_rows(SENSORS[sensor](speed), longest=LONGEST).all()


@pytest.mark.parametrize("rows", [2, 5, 10])
@pytest.mark.parametrize("sensor", SENSORS)
def test_of_readings_that_rows_repeat_the_first_rows_are_new(sensor: str, rows: int) -> None:
    speed = following(tau_s=0.1)
    place = np.arange(len(speed))
    new = new_rows(SENSORS[sensor](speed)[place // rows * rows], longest=LONGEST)

    assert np.all(place[new] % rows == 0)
    assert np.count_nonzero(new) > 0.95 * len(speed) / rows


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_a_row_is_new_where_any_axis_of_a_sensor_changes(rows: int) -> None:
    axes = np.column_stack([SENSORS["coarse"](following(tau_s=tau_s)) for tau_s in (0.02, 0.1)])
    axes = np.column_stack([axes, np.zeros(len(axes))])  # one axis is dead
    place = np.arange(len(axes))
    new = new_rows(axes[place // rows * rows], longest=LONGEST)

    assert np.all(place[new] % rows == 0)
    assert np.count_nonzero(new) > 0.95 * len(axes) / rows
