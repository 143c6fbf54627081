"""Steps on a battery that sags give the motor's time constants, whether or not its speed depends on the voltage."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from cfid.motors.steps.estimation import StepFit, fit_steps
from cfid.motors.steps.model import command_steps
from cfid.motors.steps.rotor_model import RotorModel, fit_rotor_model
from cfid.motors.steps.sag import LoggedBattery

Array = npt.NDArray[np.float64]

LEVELS = (0.0, 0.15, 0.35, 0.6, 0.8, 0.9, 0.8, 0.6, 0.5, 0.9, 0.3)
HOLD_S, STEP_S, A_ROW, FULL_V = 2.0, 1e-3, 20, 16.0
RISING_S, FALLING_S = 0.1, 0.15


def line(command: float) -> float:
    return 200 + 2800 * command


def root(command: float) -> float:
    return 2900 * float(np.sqrt((command + 0.05) / 0.95))


def driven(
    seed: int, *, power: float, resistance: float, steady: Callable[[float], float] = line
) -> tuple[tuple[StepFit, ...], RotorModel]:
    """Fit a rotor whose steady speed depends on a power of a voltage that falls with thrust times `resistance`."""
    speed, speeds, volts = 0.0, [], []
    rising, falling = (-np.expm1(-STEP_S / np.array([RISING_S, FALLING_S]))).tolist()
    for level in LEVELS:
        for row in range(round(HOLD_S / STEP_S)):
            now_v = FULL_V - resistance * 2e-6 * speed**2
            if row % A_ROW == 0:
                speeds.append(speed)
                volts.append(now_v)
            leads_to = steady(level) * (now_v / FULL_V) ** power if level else 0.0
            speed += (leads_to - speed) * (rising if leads_to > speed else falling)
    rng = np.random.default_rng(seed)
    time_s = (np.arange(len(speeds)) * STEP_S * A_ROW).astype(np.float64)
    command = np.repeat(65535 * np.array(LEVELS), len(speeds) // len(LEVELS))
    measured = np.array(speeds) + rng.normal(0, 1.0, len(speeds))
    battery = LoggedBattery(time_s, np.array(volts) + rng.normal(0, 0.01, len(volts)))
    steps = command_steps(time_s=time_s, command=command)
    return (
        fit_steps(time_s=time_s, value=measured, steps=steps, battery=battery),
        fit_rotor_model(time_s=time_s, value=measured, steps=steps, battery=battery),
    )


def errors(steps: tuple[StepFit, ...], model: RotorModel) -> tuple[Array, Array]:
    """Return the errors of time constants and rates in std, and the relative std of the time constants."""
    true_s = np.array([RISING_S if step.rising else FALLING_S for step in steps])
    found_s, std_s = np.array([(step.time_constant_s, step.time_constant_std_s) for step in steps]).T
    rates = np.array([*model.rising, *model.falling]) - [1 / RISING_S, 0.0, 1 / FALLING_S, 0.0]
    std = np.array([*model.rising_std, *model.falling_std])
    free = np.isfinite(std)
    return np.concatenate([(found_s - true_s) / std_s, rates[free] / std[free]]), std_s / true_s


@pytest.mark.parametrize(
    ("power", "resistance"),
    [
        (0.0, 0.2),
        (0.5, 0.06),
        (1.0, 0.0),
        (1.0, 0.2),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in ((0.0, 0.0), (0.0, 0.06), (0.5, 0.0), (0.5, 0.2), (1.0, 0.06))
        ),
    ],
)
def test_time_constants_are_those_of_the_motor_whatever_the_voltage_does_to_its_speed(
    power: float, resistance: float
) -> None:
    off, share = errors(*driven(1, power=power, resistance=resistance))

    assert np.abs(off).max() < 3
    assert np.median(share) < 0.03


@pytest.mark.parametrize("power", [0.0, 1.0])
def test_a_map_that_bends_as_with_a_sag_leaves_open_how_far_speeds_go_with_the_voltage(power: float) -> None:
    off, share = errors(*driven(2, power=power, resistance=0.06, steady=root))

    assert np.abs(off).max() < 3
    assert np.median(share) > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("resistance", [0.06, 0.2])
@pytest.mark.parametrize("power", [0.0, 0.5, 1.0])
def test_intervals_on_a_battery_hold_the_truth(power: float, resistance: float) -> None:
    off = np.concatenate([errors(*driven(seed, power=power, resistance=resistance))[0] for seed in range(17)])
    within = float(np.mean(np.abs(off) < 1.96))
    print(f"power {power:g}, {resistance:g} ohm: {100 * within:.1f} % of {len(off)}")

    assert within > 0.93
