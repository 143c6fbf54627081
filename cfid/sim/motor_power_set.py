"""Simulates the parameters motorPowerSet of stock firmware: commands that override everything and do not expire."""

from functools import lru_cache

import numpy as np

from cfid.sim.crazyflie_params import Parameters
from cfid.sim.propulsion import Four
from cfid.wire.app import LARGEST_COMMAND

_EACH, _FIRST_FOR_ALL, _FIRST_COMPENSATED = 1, 2, 3

# The firmware's model of a Crazyflie 2.1's motors: thrust in N as a cubic in the motor's voltage.
_CUBIC_N = (0.005960923942142, -0.01847364358025878, 0.04724465241828281, -0.014830744918356092)
_LEAST_N, _MOST_N = 0.012817578393224994, 0.12
_LEAST_V = 2.0


def overriding(parameters: Parameters, *, volts: float) -> Four | None:
    """Return the commands of the four motors, None while the parameters are not enabled."""
    enabled = parameters["motorPowerSet.enable"]
    if not enabled:
        return None
    one, two, three, four = (int(parameters[f"motorPowerSet.m{motor}"]) for motor in (1, 2, 3, 4))
    if enabled == _EACH:
        return one, two, three, four
    if enabled == _FIRST_FOR_ALL:
        return one, one, one, one
    if enabled == _FIRST_COMPENSATED:
        command = compensated(one, volts=volts)
        return command, command, command, command
    return None


@lru_cache(maxsize=256)
def compensated(command: int, *, volts: float) -> int:
    """Return the command that gives, at this supply voltage, the fraction command/65535 of the largest thrust."""
    thrust_n = command / LARGEST_COMMAND * _MOST_N
    if volts < _LEAST_V or thrust_n < _LEAST_N:
        return 0
    roots = np.roots([*_CUBIC_N[:3], _CUBIC_N[3] - thrust_n])
    motor_v = float(roots[np.argmin(np.abs(roots.imag))].real)  # the cubic is increasing: exactly one root is real
    return min(int(LARGEST_COMMAND * motor_v / volts), LARGEST_COMMAND)
