"""First-order lag of a rotor, with one time constant upwards and one downwards, behind a command that is held."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Signal(NamedTuple):
    """Values (n,) at increasing times (n,) in s; those of a command hold until the next."""

    time_s: Array
    value: Array

    def between(self, from_s: float, to_s: float) -> "Signal":
        """Return its part from one time until before another."""
        inside = (self.time_s >= from_s) & (self.time_s < to_s)
        return Signal(self.time_s[inside], self.value[inside])


class InputLag(NamedTuple):
    """dw/dt = (c - w) / tau, tau being `rising_s` where c > w and `falling_s` elsewhere, c from `delay_s` before."""

    rising_s: float
    falling_s: float
    delay_s: float

    def follow(self, target: Signal, time_s: Array) -> Array:
        """Return what follows a target from its first value on, at times (n,): exact, whatever the two clocks."""
        begin_s = target.time_s + self.delay_s
        every_s = np.concatenate([begin_s, time_s])
        order = np.argsort(every_s, kind="stable")
        at_s = every_s[order]
        held = target.value[np.maximum(np.searchsorted(begin_s, at_s[:-1], side="right") - 1, 0)]
        step_s = np.diff(at_s)
        rising, falling = np.exp(-step_s / self.rising_s), np.exp(-step_s / self.falling_s)
        now = float(target.value[0])
        course = [now]
        for to, left_rising, left_falling in zip(held.tolist(), rising.tolist(), falling.tolist(), strict=True):
            now = to + (now - to) * (left_rising if to > now else left_falling)
            course.append(now)
        return np.array(course)[order >= len(begin_s)]
