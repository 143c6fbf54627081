"""Rotors on a battery, integrated in steps of 0.25 ms, and what a logger shows of them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.records.result import Result

Array = npt.NDArray[np.float64]

STEP_S = 2.5e-4
FULL = 65535
RPM = 30 / np.pi


@dataclass(frozen=True, kw_only=True)
class Plant:
    """A rotor dw/dt = k1 (c - w) + k2 (c^2 - w^2) whose c goes with the voltage, `delay_s` after a command.

    From standstill, it is slower by the factor `start`. The battery's voltage falls by `sag_v` at 2000 rad/s of all
    rotors, and by `empties_v` until the end.
    """

    rising: tuple[float, float] = (4.0, 3.5e-3)
    falling: tuple[float, float] = (3.0, 2.5e-3)
    delay_s: float = 0.012
    start: float = 1.0
    sag_v: float = 0.0
    empties_v: float = 0.0
    steady: Callable[[Array], Array] = lambda u: 300 + 2600 * u - 500 * u**2

    def rate(self, speed: float, *, rising: bool) -> float:
        """Return how fast a small change of a speed fades, in 1/s."""
        k1, k2 = self.rising if rising else self.falling
        return k1 + 2 * k2 * speed

    def driven(self, change_s: Array, commands: Array, long_s: float) -> tuple[Array, Array, Array]:
        """Return times (n,), speeds (n, k) and volts (n,) of k rotors with commands (m, k), 0 to 1, from times (m,)."""
        time_s = np.arange(0.0, long_s, STEP_S)
        place = np.maximum(np.searchsorted(change_s + self.delay_s, time_s, side="right") - 1, 0)
        levels = np.where(commands > 0, self.steady(commands), 0.0).tolist()
        speed, volts = np.empty((len(time_s), len(levels[0]))), np.empty(len(time_s))
        now: list[float] = levels[0]
        starts = [w == 0 for w in now]
        for row, at in enumerate(place.tolist()):  # in floats, since NumPy takes ten times as long for a few numbers
            speed[row] = now
            sag_v = self.sag_v * sum((w / 2000) ** 2 for w in now) / len(now)
            volts[row] = 4.0 - self.empties_v * row / len(time_s) - sag_v
            goals = [level * volts[row] / 4.0 for level in levels[at]]
            starts = [to == 0 or (start and w < 0.97 * to) for to, start, w in zip(goals, starts, now, strict=True)]
            now = [self._after_step(w, to, start) for w, to, start in zip(now, goals, starts, strict=True)]
        return time_s, speed, volts

    def _after_step(self, w: float, to: float, starts: bool) -> float:
        """Return a speed after a step of the midpoint rule towards `to`."""

        def slope(w: float) -> float:
            k1, k2 = self.rising if to > w else self.falling
            return (to - w) * (k1 + k2 * (to + w)) / (self.start if starts and to > w else 1.0)

        return w + STEP_S * slope(w + STEP_S / 2 * slope(w))


def held(change_s: Array, commands: Array, time_s: Array) -> Array:
    """Return the commands (n, ...) that rows at times (n,) show."""
    return np.asarray(commands[np.maximum(np.searchsorted(change_s, time_s + 1e-9, side="right") - 1, 0)])


def red(rng: np.random.Generator, count: int, *, samples: float) -> Array:
    """Return noise (count,) of size 1 that is forgotten in a number of samples."""
    kept = np.exp(-1 / samples)
    drawn, noise = rng.normal(size=count), np.empty(count)
    now = drawn[0]
    for row in range(count):
        now = kept * now + np.sqrt(1 - kept**2) * drawn[row]
        noise[row] = now
    return noise


def write_log(
    path: Path,
    plant: Plant,
    seed: int,
    *,
    rotors: int = 1,
    long_s: float = 10.0,
    row_s: float = 0.002,
    hold_s: tuple[float, float] = (0.15, 0.6),
    noise: float = 3.0,
    volts: bool = True,
) -> pd.DataFrame:
    """Write a vehicle's log of rotors with random commands, changed at any time, and return it."""
    rng = np.random.default_rng(seed)
    change_s = np.append(0.0, np.cumsum(rng.uniform(*hold_s, round(2 * long_s / sum(hold_s)) + 5)))
    commands = rng.uniform(0.25, 0.85, (len(change_s), rotors))
    _, speed, battery = plant.driven(change_s, commands, long_s)
    time_s = np.arange(0.0, long_s, row_s)
    at = np.round(time_s / STEP_S).astype(int)
    shown = np.round(FULL * held(change_s, commands, time_s))
    measured = np.round(RPM * (speed[at] + rng.normal(0, noise, (len(at), rotors))))
    table = {"t": time_s}
    table |= {f"motor.m{motor + 1}": shown[:, motor] for motor in range(rotors)}
    table |= {f"rpm.m{motor + 1}": measured[:, motor] for motor in range(rotors)}
    if volts:
        table["pm.vbat"] = np.round(battery[at] + rng.normal(0, 0.005, len(at)), 3)
    log = pd.DataFrame(table)
    log.to_csv(path, index=False)
    return log


def write_stand(
    path: Path,
    plant: Plant,
    seed: int,
    *,
    levels: Sequence[float] | None = None,
    hold_s: float = 1.0,
    row_s: float = 0.01,
    noise: float = 4.0,
    step: float = 0.0,
    volts: bool = True,
    repeat: int = 1,
) -> pd.DataFrame:
    """Write a thrust stand's table of one rotor with held commands, its speed rounded to a `step`, and return it."""
    rng = np.random.default_rng(seed)
    if levels is None:
        levels = rng.permutation(np.repeat([0.3, 0.45, 0.6, 0.75, 0.9], 3)).tolist()
    change_s = np.arange(len(levels)) * hold_s + rng.uniform(0, row_s, len(levels))
    change_s[0] = 0.0
    commands = np.array(levels)[:, np.newaxis]
    _, speed, battery = plant.driven(change_s, commands, len(levels) * hold_s)
    time_s = np.arange(0.0, len(levels) * hold_s - STEP_S, row_s)
    at = np.round(time_s / STEP_S).astype(int)
    turning = speed[at, 0] > 1
    shown = np.maximum(speed[at, 0] + turning * rng.normal(0, noise, len(at)), 0.0)
    shown = step * np.round(shown / step) if step else shown
    shown = shown[np.arange(len(shown)) // repeat * repeat]
    table = {"t_s": np.round(time_s, 4), "cmd": np.round(FULL * held(change_s, commands[:, 0], time_s))}
    table["rpm"] = np.round(RPM * shown, 2)
    if volts:
        table["vbat_v"] = battery[at] + rng.normal(0, 0.01, len(at))
    stand = pd.DataFrame(table)
    stand.to_csv(path, index=False)
    return stand


def rates_off(result: Result, plant: Plant, *, widest: float = math.inf) -> list[float]:
    """Return the errors of the rates that a result has, at a speed in the middle, in their standard uncertainties.

    They are at most a fraction `widest` of the rates.
    """
    speed, errors = 1400.0, []
    at = np.array([1.0, 2 * speed])
    for way in ("rising", "falling"):
        if (key := f"dynamics.{way}") not in result.quantities:
            continue
        (covariance,) = (one for one in result.covariances if key in one.of)
        place = 2 * covariance.of.index(key)
        matrix = np.array(covariance.matrix)[place : place + 2, place : place + 2]
        true, std = plant.rate(speed, rising=way == "rising"), math.sqrt(at @ matrix @ at)
        assert std < widest * true
        errors.append(float(at @ result.quantities[key].value - true) / std)
    return errors


def delay_off(result: Result, plant: Plant) -> float:
    """Return the error of the delay in its standard uncertainties."""
    delay = result.quantities["dynamics.delay_s"]
    return float((delay.value - plant.delay_s) / delay.std)
