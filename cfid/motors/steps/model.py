"""A rotor that follows steps of its command, by the rotor model, and what a measurement of it would show."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import exprel, roots_jacobi

from cfid.errors import FitError
from cfid.estimate.signals import block_means
from cfid.motors.steps.rounding import rounding_step

Array = npt.NDArray[np.float64]

BEFORE = 0.1  # share of the previous command's time that shows where a step begins
_FEWEST = 8  # samples of a step
_FINEST_S = 2e-3  # more frequent samples are averaged: rotors take many times longer
_RATES_AT = (0.211, 0.789)  # of a step: the line through these is nearest to a rate that is a parabola over the speed
_TIMES = 6  # correlation times that are tried
# A straight line through phases weights speeds with a parabola; these are Gauss' nodes and weights for that.
_NODES, _WEIGHTS = roots_jacobi(6, 1, 1)


class CommandStep(NamedTuple):
    """A command that holds from `at_s` until `until_s`, and the one before it, which held from `since_s` on."""

    since_s: float
    at_s: float
    until_s: float
    command_from: float
    command_to: float


def command_steps(*, time_s: Array, command: Array) -> tuple[CommandStep, ...]:
    """Return the steps of a command (n,) that was sampled at times (n,)."""
    changes = np.flatnonzero(np.diff(command)) + 1
    at_s = [float(time_s[0]), *time_s[changes].tolist(), float(time_s[-1])]
    values = [float(command[0]), *command[changes].tolist()]
    return tuple(CommandStep(*at_s[i : i + 3], *values[i : i + 2]) for i in range(len(changes)))


def followed(steps: Sequence[CommandStep], *, time_s: Array, value: Array) -> tuple[CommandStep, ...]:
    """Return the steps with enough values (n,) at times (n,): a step to standstill shows little vibration."""
    measured_s = time_s[np.isfinite(value)]
    return tuple(
        step for step in steps if np.count_nonzero((measured_s >= step.at_s) & (measured_s < step.until_s)) >= _FEWEST
    )


class Sag(NamedTuple):
    """The `part` of its final value by which a command's speed falls from standstill to there, with its uncertainty.

    The fall goes with the power `load` of the speed, as does that of the voltage, which falls by the part `fell`.
    Speeds go with the power `power` of the voltage.
    """

    part: float
    part_std: float
    load: float
    fell: float
    power: float
    power_std: float


class Lag(NamedTuple):
    """A step that follows the rotor model; a plain lag has a quadratic coefficient of zero."""

    delay_s: float
    begin: float
    end: float
    linear: float
    quadratic: float

    def speed(self, time_s: Array) -> Array:
        """Solve the rotor model in closed form: the inverse of the gap to the end obeys a linear equation."""
        gap, rate = self.end - self.begin, self.linear + 2 * self.quadratic * self.end
        passed_s = np.maximum(time_s - self.delay_s, 0.0)
        decay = np.minimum(rate * passed_s, 500.0)
        # exprel is exact also where the rate vanishes: a rotor that runs out may head there.
        return np.asarray(self.end - gap / (np.exp(decay) - self.quadratic * gap * passed_s * exprel(decay)))

    def sagging(self, sag: Sag | None) -> "Lag":
        """Return the lag of the same rotor on a battery: the speed it heads for falls with a power of speed, to `end`.

        From standstill to `end`, the speed it heads for falls by a part of `end`. The rates of this lag are the motor's
        own; a line approximates those on the battery.
        """
        if sag is None or self.end == self.begin or self.end <= 0:
            return self
        speed = self.begin + (self.end - self.begin) * np.array(_RATES_AT)
        part = np.maximum(speed / self.end, 0.0)
        leads_to = self.end * (1 + sag.part * (1 - part**sag.load))
        nearer = (leads_to - speed) / (self.end - speed)
        rate = nearer * (self.linear + self.quadratic * (leads_to + speed))
        quadratic = float((rate[1] - rate[0]) / (speed[1] - speed[0]))
        return self._replace(linear=float(rate[0]) - quadratic * float(self.end + speed[0]), quadratic=quadratic)


class Part(NamedTuple):
    """Samples (n,) about one step, their times counted from it."""

    step: CommandStep
    time_s: Array
    value: Array

    @property
    def interval_s(self) -> float:
        """The usual time between two samples."""
        return float(np.median(np.diff(self.time_s)))


class StepData:
    """The measured speeds, cut into steps, and how a lag would have shown in them."""

    def __init__(self, time_s: Array, value: Array, steps: Sequence[CommandStep], blur_s: float) -> None:
        """Cut speeds (n,) at times (n,) into steps; see `fit_steps`. Raises FitError for none, or one too short."""
        if not steps:
            raise FitError("no step of the command: there is nothing that a rotor could have followed.")
        self._blur_s = blur_s
        self._sizes = np.sort(np.abs(value[np.isfinite(value)]))
        self.parts = [_part(time_s, value, step) for step in steps]

    def shown(self, part: Part, lag: Lag) -> Array:
        """Return the speeds (n,) that a lag would have shown at the times of a step."""
        if self._blur_s == 0:
            return lag.speed(part.time_s)
        return np.asarray(_WEIGHTS @ lag.speed(part.time_s + self._blur_s / 2 * _NODES[:, np.newaxis]) / _WEIGHTS.sum())

    def rounding_step(self, part: Part) -> float:
        """Return the increment to which the values of a step are rounded, almost 0 where they are not."""
        return rounding_step(part.value, sizes=self._sizes)

    def correlations(self, time_s: Array) -> Iterator[Array]:
        """Yield the correlation (n, n) of the values at times (n,) for noise of each of several correlation times."""
        apart = np.abs(np.subtract.outer(time_s, time_s))[..., np.newaxis]
        shift, weight = np.zeros(1), np.ones(1)
        if self._blur_s > 0:
            apart = np.subtract.outer(time_s, time_s)[..., np.newaxis]
            shift = self._blur_s / 2 * np.subtract.outer(_NODES, _NODES).ravel()
            weight = np.outer(_WEIGHTS, _WEIGHTS).ravel()
        shortest = self._blur_s / 5 or 2 * float(np.median(np.diff(time_s)))
        for each_s in np.geomspace(shortest, max(float(np.ptp(time_s)) / 2, 2 * shortest), _TIMES):
            found = np.exp(-np.abs(apart + shift) / each_s) @ weight
            yield found / found[0, 0]


def _part(time_s: Array, value: Array, step: CommandStep) -> Part:
    before_s = BEFORE * (step.at_s - step.since_s)
    inside = (time_s >= step.at_s - before_s) & (time_s < step.until_s) & np.isfinite(value)
    time, own = time_s[inside] - step.at_s, value[inside]
    if np.count_nonzero(time >= 0) < _FEWEST:
        raise FitError(f"the step at {step.at_s:.2f} s has fewer than {_FEWEST} samples: no lag can be fitted to it.")
    length = max(int(_FINEST_S / np.median(np.diff(time))), 1)
    return Part(step, block_means(time, length=length), block_means(own, length=length))
