"""One rotor model for steps and for commands that change in every row: a plant with known rates, and public stands."""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

from cfid.estimate.held_readings import once_each
from cfid.recordings.stand import read_stand, stand_of
from cfid.units import FULL_COMMAND
from tests.motors.one_rotor import RotorFit, fit_rotor, recording
from tests.places import DATA

Array = npt.NDArray[np.float64]

STEPS, RAMP = (DATA / "bitcraze_2021" / name for name in ("cf21_stock2.csv", "cf2.1-stock-prop.csv"))
RISING, FALLING, DELAY_S = (2.0, 0.0022), (1.0, 0.0015), 0.012


def simulated(held_s: float, rng: np.random.Generator) -> RotorFit:
    """Fit a rotor whose equation an adaptive integrator solves, with noise of 10 rad/s, in rows of 5 ms."""
    commands = np.concatenate([[0.5], rng.uniform(0.3, 0.9, 30)])
    at_s: Array = held_s * np.arange(len(commands), dtype=np.float64)
    targets = 300 + 2000 * commands

    def slope(now_s: float, speed: Array) -> Array:
        target = float(targets[max(int(np.searchsorted(at_s + DELAY_S, now_s, side="right")) - 1, 0)])
        first, second = RISING if target > speed[0] else FALLING
        return np.asarray(first * (target - speed) + second * (target**2 - speed**2))

    time_s = np.arange(0.0, at_s[-1] + held_s, 0.005)
    course = solve_ivp(slope, (0.0, time_s[-1]), targets[:1], t_eval=time_s, rtol=1e-8, max_step=0.002)
    speed = course.y[0] + 10 * rng.standard_normal(len(time_s))
    return fit_rotor([recording(time_s=time_s, speed=speed, command_s=at_s, command=commands)])


@pytest.mark.parametrize("held_s", [0.2, 0.6])
def test_the_rates_do_not_depend_on_how_long_commands_are_held(held_s: float) -> None:
    fit = simulated(held_s, np.random.default_rng(3))

    for way, (first, second) in ((True, RISING), (False, FALLING)):
        lag_s, std_s = fit.time_constant(1300.0, rising=way)
        true_s = 1 / (first + 2 * second * 1300)
        assert lag_s == pytest.approx(true_s, abs=4 * std_s)
        assert std_s < 0.03 * true_s
    assert fit.values[7] == pytest.approx(DELAY_S, abs=4 * fit.std[7])


def of_stand(path: Path) -> RotorFit:
    stand = stand_of(read_stand(path))
    time_s, speed = np.asarray(stand.time_s), np.asarray(stand.square_mean_speed_rad_s)
    counts, readings = once_each(time_s, speed)
    return fit_rotor(
        [
            recording(
                time_s=time_s,
                speed=np.where(counts, speed, np.nan),
                command_s=time_s,
                command=np.asarray(stand.command) / FULL_COMMAND,
                volts=None if stand.vbat_v is None else (time_s, np.asarray(stand.vbat_v)),
                row_s=float(np.median(np.diff(time_s))),
                age_s=readings.age_s,
            )
        ]
    )


@pytest.mark.skipif(not STEPS.exists(), reason="the public stand recordings are not here")
def test_a_ramp_and_steps_of_one_propeller_have_the_same_rotor() -> None:
    """The commands of the ramp change ten times a second; `cfid fit dynamics` refuses it."""
    steps, ramp = of_stand(STEPS), of_stand(RAMP)

    for speed in (1600.0, 2000.0):
        steps_s, steps_std_s = steps.time_constant(speed, rising=True)
        ramp_s, ramp_std_s = ramp.time_constant(speed, rising=True)
        assert abs(steps_s - ramp_s) < 1.96 * math.hypot(steps_std_s, ramp_std_s)
        assert steps_std_s < 0.2 * steps_s
        assert ramp_std_s < 0.35 * ramp_s
