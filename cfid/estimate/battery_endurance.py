"""Estimate how long a lithium cell drives motors: charge from its open-circuit voltage, current from Bitcraze's table.

The currents are those of a Crazyflie 2.0 with its standard propellers (Bitcraze's thrust table of 2015), as a function
of the commands; within 5 % of the table from 12 to 94 %. The cell is the vehicle's standard one, of 240 mAh.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cfid.units import FULL_COMMAND, MOTORS

CELL_MAH = 240.0

_CHARGE_V = (3.3, 3.61, 3.69, 3.73, 3.77, 3.8, 3.84, 3.87, 3.95, 4.02, 4.11, 4.2)  # of a lithium cell without load
_CHARGE = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
_FULL_V = 4.35  # a higher voltage is not that of a single cell
_STANDBY_A, _LINEAR_A, _SQUARE_A = 0.24, 2.2, 2.2


class Held(NamedTuple):
    """A command that a number of motors hold for some seconds."""

    command: int
    motors: int
    seconds: float


class Endurance(NamedTuple):
    """The remaining share of the charge, the time that it drives a plan's mean current, and the plan's duration."""

    charge: float
    lasts_s: float
    takes_s: float

    @property
    def enough(self) -> bool:
        """Whether the charge lasts for the plan."""
        return self.lasts_s >= self.takes_s


def endurance(volts: float, plan: Sequence[Held]) -> Endurance | None:
    """Return how long a cell at `volts` without load lasts for a plan; None if it is not a single cell."""
    if not 0 < volts <= _FULL_V:
        return None
    charge = float(np.interp(volts, _CHARGE_V, _CHARGE))
    takes_s = sum(part.seconds for part in plan)
    mean_a = sum(part.seconds * _current_a(part) for part in plan) / takes_s
    return Endurance(charge, charge * CELL_MAH * 3.6 / mean_a, takes_s)


def _current_a(held: Held) -> float:
    duty = held.command / FULL_COMMAND
    return _STANDBY_A + held.motors / len(MOTORS) * (_LINEAR_A * duty + _SQUARE_A * duty**2)
