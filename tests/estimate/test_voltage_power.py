"""The power of the voltage that speeds follow, from levels repeated at another voltage, or else from a straight map."""

import numpy as np
import pytest

from cfid.estimate.voltage_power import voltage_power


def found(power: float, *, emptier: float) -> tuple[float, float]:
    """Return the power and its std from four levels of a bent map, measured again on a battery that is emptier."""
    command = np.tile([0.2, 0.5, 0.8, 0.9], 2)
    without = 2900 * np.sqrt(command + 0.05)
    volts = 16 * (1 - emptier * np.repeat([0, 1], 4) - 0.06 * (without / 2900) ** 3)
    draw = np.random.default_rng(4)
    speed = without * (volts / 16) ** power + draw.normal(0, 0.3, 8)
    volts = volts + draw.normal(0, 0.001, 8)
    return voltage_power(command=65535 * command, volts=volts, speed=speed, std=np.full(8, 0.3))


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0])
def test_levels_repeated_at_another_voltage_show_it_whatever_the_map(power: float) -> None:
    mean, std = found(power, emptier=0.02)

    assert abs(mean - power) < 3 * std
    assert std < 0.03


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0])
def test_levels_of_a_map_that_bends_leave_it_open(power: float) -> None:
    mean, std = found(power, emptier=0.0)

    assert abs(mean - power) < 2 * std
    assert std > 0.25
