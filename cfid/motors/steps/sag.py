"""How far the battery's voltage falls with a rotor's speed, and by how much the speed of a command falls with it.

A motor draws more power the faster it turns, and the battery's inner resistance lets its voltage fall. At a constant
command, the speed that the rotor heads for may therefore fall on the way, and the rotor gets there sooner than with a
supply.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import fit_linear
from cfid.estimate.voltage_power import voltage_power
from cfid.motors.steps.model import CommandStep, Lag, Sag

Array = npt.NDArray[np.float64]

_BEFORE_S = 0.5
_SUREST = 1e-6  # of the largest speed: a sensor that hangs would leave no noise
_SETTLED, _LOOKS = 5.0, 20  # time constants; speeds that are averaged over half a step
_NOTABLE = 0.001  # of the voltage: what changes less may be the noise of its reading
_LOADS = np.arange(1.5, 4.1, 0.25)  # powers of the speed: a rotor's torque goes with 2, its power with 3
_EXACT = 1e-4  # of the voltage: the part that no such law explains
_LATE = 0.1  # of a sag: a cell's voltage also falls over seconds, and is read ten times a second


class LoggedBattery(NamedTuple):
    """A battery's volts (m,) at times (m,)."""

    time_s: Array
    volts: Array

    def mean(self, from_s: float, until_s: float) -> float:
        """Return the mean of the readings between two times, NaN where there is none."""
        inside = self.volts[(self.time_s >= from_s) & (self.time_s < until_s) & np.isfinite(self.volts)]
        return float(inside.mean()) if len(inside) else float("nan")


def sags(
    battery: LoggedBattery | None, steps: Sequence[CommandStep], lags: Sequence[Lag], end_std: Array
) -> list[Sag | None]:
    """Return how far speeds and voltage fall within steps with these lags, whose ends have standard uncertainties (n,).

    It is None for a step where the voltage hardly changed with the load, where none was measured, and at command 0,
    where no battery feeds a rotor.
    """
    if battery is None:
        return [None] * len(steps)
    begin, end = (np.maximum([getattr(lag, name) for lag in lags], 0.0) for name in ("begin", "end"))
    begin[[step.command_from == 0 for step in steps]] = 0.0
    before = np.array([_before(battery, step, lag) for step, lag in zip(steps, lags, strict=True)])
    within = np.array([battery.mean((step.at_s + step.until_s) / 2, step.until_s) for step in steps])
    seen = np.maximum([_late_speed(step, lag) for step, lag in zip(steps, lags, strict=True)], 0.0)
    command = np.array([step.command_to for step in steps])
    driven = (command > 0) & (end > 0)
    read = driven & np.isfinite(within)
    speed, volts = np.concatenate([begin, seen]), np.concatenate([before, within])
    at_s, known = np.array([[step.at_s, step.until_s] for step in steps]).T.ravel(), np.isfinite(volts)
    if not read.any() or np.count_nonzero(known) < 2:
        return [None] * len(steps)
    largest = float(max(speed.max(), end.max()))
    drop_v, load, unsure = _load(at_s[known], speed[known] / largest, volts[known])
    within -= drop_v * ((end / largest) ** load - (seen / largest) ** load)  # a short step ends before its speed does
    usual_v = np.where(read, within, float(np.mean(within[read])))  # where it was not read it fell all the same
    fell = np.where(driven, drop_v * (end / largest) ** load / usual_v, 0.0)
    if fell.max() < _NOTABLE or not np.all(within[read] > 0):  # the latter: its readings follow no law of a load
        return [None] * len(steps)
    sure = np.maximum(end_std, _SUREST * largest)
    power, std = voltage_power(command=command[read], volts=within[read], speed=end[read], std=sure[read])
    part = (1 + fell) ** power - 1
    part_std = np.hypot(np.log1p(fell) * std, math.hypot(unsure, _LATE) * part)
    each = zip(part.tolist(), part_std.tolist(), fell.tolist(), driven, strict=True)
    return [Sag(one, one_std, load, down, power, std) if on else None for one, one_std, down, on in each]


def _before(battery: LoggedBattery, step: CommandStep, lag: Lag) -> float:
    """Return the volts before a step, NaN where the command before was too short for its speed to settle."""
    settled = step.at_s - step.since_s > _SETTLED / lag.linear
    return battery.mean(max(step.since_s, step.at_s - _BEFORE_S), step.at_s) if settled else math.nan


def _late_speed(step: CommandStep, lag: Lag) -> float:
    """Return a lag's mean speed in the second half of its step."""
    hold_s = step.until_s - step.at_s
    return float(lag.speed(np.linspace(hold_s / 2, hold_s, _LOOKS)).mean())


def _load(time_s: Array, speed: Array, volts: Array) -> tuple[float, float, float]:
    """Return how far volts (n,) fell at speed 1, with which power of speeds (n,), and how uncertain their product is.

    The product of the two is how steeply the volts fall there, which decides how much sooner a rotor gets to its speed.
    In addition, the battery may run down.
    """
    down = [(time_s - time_s.mean()) / max(float(np.ptp(time_s)), 1e-9)] * (len(volts) > 4)
    drops, stds, likely = np.zeros((3, len(_LOADS)))
    for place, power in enumerate(_LOADS):
        rows = np.column_stack([np.ones(len(volts)), -(speed**power), *down])
        found = fit_linear(rows, volts, noise_known=False)
        left = float(found.residual @ found.residual) + (_EXACT * float(volts.mean())) ** 2
        drops[place], likely[place] = found.values[1], -max(found.degrees_of_freedom, 1) / 2 * math.log(left)
        stds[place] = found.std[1] if found.degrees_of_freedom > 0 else 0.0
    weights = np.exp(likely - likely.max())
    weights /= weights.sum()
    slopes = drops * _LOADS
    slope, load = float(weights @ slopes), float(weights @ _LOADS)
    if slope <= 0:
        return 0.0, load, 0.0
    variance = float(weights @ ((slopes - slope) ** 2 + (stds * _LOADS) ** 2))
    return slope / load, load, float(np.sqrt(variance)) / slope
