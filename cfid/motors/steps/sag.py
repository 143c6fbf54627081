"""How far the battery's voltage falls with a rotor's speed, within each step of the command.

A motor draws power like the cube of its speed, and the battery's voltage falls by its inner resistance. At a constant
command the speed that the rotor is heading for therefore falls on its way: it gets there sooner than with a supply.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.motors.steps.model import CommandStep, Lag

Array = npt.NDArray[np.float64]

_BEFORE_S = 0.5
_NOTABLE = 0.003  # of the voltage: what changes less may be the noise of its reading
_OTHER = 0.1  # of the largest command times voltage, from where others tell how speeds go with it
_APART = 0.5  # of the cube of the larger speed: what changes the load by less shows too little of its sag


class LoggedBattery(NamedTuple):
    """A battery's volts (m,) at times (m,)."""

    time_s: Array
    volts: Array

    def mean(self, from_s: float, until_s: float) -> float:
        """Return the mean of its readings between two times, NaN where there is none."""
        inside = self.volts[(self.time_s >= from_s) & (self.time_s < until_s) & np.isfinite(self.volts)]
        return float(inside.mean()) if len(inside) else float("nan")


def sags(battery: LoggedBattery | None, steps: Sequence[CommandStep], lags: Sequence[Lag]) -> Array:
    """Return by which part of its final value the speed (n,) falls that each step leads to, from standstill to there.

    Zero where voltage or load hardly changed, where none was measured, and at command 0, which no battery feeds.
    """
    found = np.zeros(len(steps))
    if battery is None:
        return found
    before = np.array([battery.mean(max(step.since_s, step.at_s - _BEFORE_S), step.at_s) for step in steps])
    within = np.array([battery.mean((step.at_s + step.until_s) / 2, step.until_s) for step in steps])
    begin, end = (np.maximum([getattr(lag, name) for lag in lags], 0.0) for name in ("begin", "end"))
    command = np.array([step.command_to for step in steps])
    fell, cubes = before / within - 1, end**3 - begin**3
    known = (np.abs(fell) > _NOTABLE) & (np.abs(cubes) > _APART * np.maximum(begin, end) ** 3) & (command > 0)
    found[known] = (_felt(command * within, end) * fell * end**3)[known] / cubes[known]
    return np.maximum(found, 0.0)


def _felt(driven: Array, speed: Array) -> Array:
    """Return how far speeds (n,) go with the voltage, by a line over command times voltage (n,); without one, fully."""
    used = np.isfinite(driven) & (driven > 0)
    if not used.any() or np.ptp(driven[used]) < _OTHER * driven[used].max():
        return np.ones(len(speed))
    standing = np.polynomial.polynomial.polyfit(driven[used], speed[used], 1)[0]
    return np.asarray(np.clip(1 - standing / np.maximum(speed, 1e-9), 0.5, 1.0))
