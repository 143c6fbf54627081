"""The 95 % intervals of a lag from an ever-changing command contain the true value as often as they claim."""

import numpy as np
import numpy.typing as npt
import pytest

from cfid.motors.lag.estimation import fit_lag
from cfid.motors.lag.model import LogSegment, Signal
from tests.coverage_rows import Row

Array = npt.NDArray[np.float64]

RISING_S, FALLING_S, DELAY_S = 0.055, 0.085, 0.012
LONG_S, STEP_S, RATE_HZ = 25.0, 2.5e-4, 100.0


def flown(count: int, seed: int, *, noise: float, red: float, sag: float = 0.0) -> tuple[Array, Array, Array]:
    """Return times (n,), commands (count, 1, n) of 0 to 1, and the noisy speeds (count, n) that they cause.

    The simulation takes steps of 0.25 ms; commands change every 20 to 90 ms. The steady speed at a command falls by the
    fraction `sag` until the end, as with an unlogged battery.
    """
    draw = np.random.default_rng(seed)
    rows = round(LONG_S * RATE_HZ)
    hold = draw.integers(2, 10, (count, 1, rows)).cumsum(axis=-1)
    levels = draw.uniform(0.35, 0.85, (count, 1, rows))
    command = np.array(
        [
            [level[np.searchsorted(at, np.arange(rows), side="right")] for at, level in zip(*pair, strict=True)]
            for pair in zip(hold, levels, strict=True)
        ]
    )
    a_row, late = round(1 / RATE_HZ / STEP_S), round(DELAY_S / STEP_S)
    target = 400 + 2600 * command - 500 * command**2
    step = np.arange(rows * a_row)
    held, left = np.maximum(step - late, 0) // a_row, 1 - sag * step / len(step)
    seen = np.array([[followed(one[held] * left, float(one[0]))[::a_row] for one in each] for each in target])
    white = draw.standard_normal((2, count, rows))
    slow = np.zeros((count, rows))
    for row in range(1, rows):
        slow[:, row] = 0.95 * slow[:, row - 1] + np.sqrt(1 - 0.95**2) * white[1, :, row]
    return np.arange(rows) / RATE_HZ, command, seen[:, 0] + noise * white[0] + red * slow


def followed(targets: Array, speed: float) -> list[float]:
    """Return the speed at the start of each step in which it follows a target."""
    rising, falling = np.expm1(-STEP_S / np.array([RISING_S, FALLING_S])).tolist()
    course = []
    for to in targets.tolist():
        course.append(speed)
        speed += (speed - to) * (rising if to > speed else falling)
    return course


def fitted(time_s: Array, commands: Array, values: Array) -> list[Row]:
    """Fit every log, and return the coverage rows of the two time constants and the delay."""
    found, std = [], []
    for command, value in zip(commands, values, strict=True):
        fit = fit_lag([LogSegment(Signal(time_s, command[0]), Signal(time_s, value))])
        assert fit.accepted, fit.findings
        found.append(fit.lag)
        std.append(fit.std_s)
    truth = (RISING_S, FALLING_S, DELAY_S)
    errors, stds = np.array(found) - truth, np.array(std)
    names = ("rising", "falling", "delay")
    return [Row(f"speed, {name}", errors[:, i], stds[:, i], truth[i]) for i, name in enumerate(names)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "seed", "noise", "red"),
    [
        (200, 18, 15.0, 0.0),
        (200, 18, 5.0, 15.0),
        (500, 77, 5.0, 15.0),
    ],
)
def test_intervals_hold_the_truth(count: int, seed: int, noise: float, red: float) -> None:
    for row in fitted(*flown(count, seed, noise=noise, red=red)):
        print(row, f"red {red}")
        assert row.covers(), row


def test_a_battery_that_sags_moves_no_time_constant() -> None:
    rising, falling, delay = fitted(*flown(24, 18, noise=5.0, red=0.0, sag=0.1))
    for row in (rising, falling, delay):
        print(row)
        assert np.all(np.abs(row.error) < 4 * row.std)
    for row in (rising, falling):
        assert np.all(np.abs(row.error) < 0.015 * row.scale)
        assert abs(np.mean(row.error)) < 0.003 * row.scale
