"""A rotor that follows its command, dw/dt = k1 (c - w) + k2 (c^2 - w^2), and how its speed changes with each parameter.

c is the speed that the command leads to: k1 and k2 are those of rising speed where c > w, and of falling speed
elsewhere. The first term is the motor's own (its back-EMF), the second the propeller's drag. While a command holds, the
equation is solved in closed form: the inverse of the gap c - w obeys a linear equation.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dtbtrs
from scipy.sparse import csc_array
from scipy.special import roots_jacobi

from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]

RESTS_S = 0.25  # a command that is held for longer shows its speed
FORGOTTEN = 12.0  # time constants after which a change no longer shows
_SETTLED = 1e-9  # of the largest speed: a change this small ends the solution
# Speeds that were read from a window are means weighted with a parabola; these are Gauss' nodes and weights for that.
_NODES, _WEIGHTS = roots_jacobi(5, 1, 1)


class Signal(NamedTuple):
    """Values (n,) at increasing times (n,) in s."""

    time_s: Array
    value: Array

    @property
    def known(self) -> "Signal":
        """The values that are numbers."""
        known = np.isfinite(self.value)
        return Signal(self.time_s[known], self.value[known])

    def between(self, from_s: float, to_s: float) -> "Signal":
        """Return the part of the signal from one time to another."""
        inside = (self.time_s >= from_s) & (self.time_s <= to_s)
        return Signal(self.time_s[inside], self.value[inside])

    def without(self, wrong: Mask) -> "Signal":
        """Return the signal with nan in place of wrong values (n,)."""
        return Signal(self.time_s, np.where(wrong, np.nan, self.value))


@dataclass(frozen=True, kw_only=True, eq=False)
class RotorRecord:
    """Speeds (n,) of a rotor in rad/s, NaN where unknown, and its commands (m,), as parts of the largest,
    `full`, that hold from `begin_s` (m,) on.

    `first` (m,) are the commands before which the record was broken. `volts` is the voltage without the rotor's own
    load, which adds `sag_v` per square of its speed, and `at_v` the mean while the rotor was driven. Where commands are
    known from rows alone, these are `row_s` apart, and each is taken to hold from the middle between two rows on, its
    mean; a command that changes in most rows is `moving`, and `straight` between rows that are far apart. Speeds may be
    older than their rows by up to `age_s`, whose mean is corrected, and are means over `blur_s`.
    """

    time_s: Array
    speed_rad_s: Array
    begin_s: Array
    command: Array
    first: Mask
    full: float = FULL_COMMAND
    volts: Signal | None = None
    sag_v: float = 0.0
    at_v: float = 1.0
    row_s: float = 0.0
    age_s: float = 0.0
    blur_s: float = 0.0
    moving: bool = False
    straight: bool = False

    @property
    def commands(self) -> tuple[float, float]:
        """The lowest and the highest command above 0."""
        driven = self.command[self.command > 0]
        return self.full * float(driven.min()), self.full * float(driven.max())

    @property
    def steps(self) -> list[tuple[float, float]]:
        """The different steps between commands that rest, from and to, in their order."""
        changes = np.flatnonzero(np.append(True, (np.diff(self.command) != 0) | self.first[1:]))
        held_s = np.diff(self.begin_s[changes], append=self.time_s[-1])
        command = np.round(self.full * self.command[changes], 6)
        there = (np.diff(command) != 0) & ~self.first[changes[1:]] & (held_s[1:] > RESTS_S)
        return list(dict.fromkeys((float(command[i]), float(command[i + 1])) for i in np.flatnonzero(there)))


class Rates(NamedTuple):
    """The rates k1 in 1/s and k2 in 1/rad of rising and of falling speed, each for all intervals or for each (m,)."""

    rising: tuple[Array, Array]
    falling: tuple[Array, Array]

    def towards(self, target: Array, speed: Array) -> tuple[Array, Array]:
        """Return k1 and k2 (m,) on the way from speeds (m,) to targets (m,)."""
        rises = target > speed
        return np.where(rises, self.rising[0], self.falling[0]), np.where(rises, self.rising[1], self.falling[1])


class Passed(NamedTuple):
    """Speeds (n,) after some time under a target, and their derivatives by what they depend on."""

    speed: Array
    by_speed: Array
    by_target: Array
    by_k1: Array
    by_k2: Array
    by_time: Array


def pass_time(speed: Array, target: Array, time_s: Array, k1: Array, k2: Array) -> Passed:
    """Return what becomes of speeds (n,) after times (n,) under targets (n,)."""
    gap, rate = target - speed, k1 + 2 * k2 * target
    keep = np.exp(-rate * time_s)
    reach = np.where(rate * time_s < 1e-8, time_s, (1 - keep) / np.maximum(rate, 1e-300))
    bend = 1 - k2 * gap * reach
    left = gap * keep / bend
    reach_by_rate = np.where(rate * time_s < 1e-4, -(time_s**2) / 2, (time_s * keep - reach) / np.maximum(rate, 1e-300))
    by_rate = left * (-time_s + k2 * gap * reach_by_rate / bend)
    by_speed = keep / bend**2
    now = target - left
    return Passed(
        speed=now,
        by_speed=by_speed,
        by_target=1 - by_speed - 2 * k2 * by_rate,
        by_k1=-by_rate,
        by_k2=-(2 * target * by_rate + left * gap * reach / bend),
        by_time=left * (k1 + k2 * (target + now)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Course:
    """A rotor's speeds (m,) at the beginnings (m,) of intervals in s, each under a target (m,) with rates k1, k2 (m,).

    `kept` (m,) is how much of a small deviation is left after each interval, 0 at the end of a piece. `first` (m,) are
    the intervals that begin a piece, with a speed of its own.
    """

    begin_s: Array
    speed: Array
    target: Array
    k1: Array
    k2: Array
    length_s: Array
    kept: Array
    first: Mask

    def at(self, time_s: Array) -> tuple[Indices, Passed]:
        """Return the intervals (n,) of times (n,), and what the speeds are by then."""
        place = np.maximum(np.searchsorted(self.begin_s, time_s, side="right") - 1, 0)
        since_s = np.maximum(time_s - self.begin_s[place], 0.0)
        return place, pass_time(self.speed[place], self.target[place], since_s, self.k1[place], self.k2[place])

    def summed(self, added: Array) -> Array:
        """Return deviations (m, p) at the beginnings, where each interval adds some (m, p) to what it keeps."""
        before = np.vstack([np.zeros((1, added.shape[1])), added[:-1]])
        return _bidiagonal(self.kept[:-1], np.where(self.first[:, np.newaxis], 0.0, before), self.first)

    @property
    def jump(self) -> Array:
        """By how much (m,) in rad/s^2 the acceleration before each change of the target exceeds that after it."""
        before = np.append(self.target[0], self.target[:-1])
        k1, k2 = np.append(self.k1[0], self.k1[:-1]), np.append(self.k2[0], self.k2[:-1])
        old = (before - self.speed) * (k1 + k2 * (before + self.speed))
        return np.asarray(old - (self.target - self.speed) * (self.k1 + self.k2 * (self.target + self.speed)))

    @property
    def forgotten(self) -> Array:
        """How much (m,), as a logarithm, of a deviation at the very beginning is forgotten at each beginning."""
        steps = -np.log(np.maximum(np.where(self.kept > 0, self.kept, np.exp(-4 * FORGOTTEN)), 1e-300))
        return np.append(0.0, np.cumsum(steps[:-1]))


def follow(begin_s: Array, target: Array, rates: Rates, first: Mask, first_speed: Array) -> Course:
    """Return the course of a rotor under targets (m,), each from its beginning (m,) on.

    The intervals `first` (m,) begin with speeds of their own (k,). Newton's method over all intervals at once: the
    equations of neighbours are linear once the slopes are known.
    """
    length_s = np.append(np.diff(begin_s), 0.0)
    last = np.append(first[1:], True)
    own = np.zeros(len(target))
    own[first] = first_speed
    speed = np.where(first, own, np.append(target[0], target[:-1]))
    while True:
        k1, k2 = rates.towards(target, speed)
        passed = pass_time(speed, target, length_s, k1, k2)
        kept = np.where(last, 0.0, passed.by_speed)
        right = np.where(first, own, np.append(0.0, (passed.speed - passed.by_speed * speed)[:-1]))
        now = _bidiagonal(kept[:-1], right[:, np.newaxis], first)[:, 0]
        if np.abs(now - speed).max() <= _SETTLED * max(np.abs(target).max(), np.abs(now).max()):
            break
        speed = now
    return Course(begin_s=begin_s, speed=now, target=target, k1=k1, k2=k2, length_s=length_s, kept=kept, first=first)


def _bidiagonal(kept: Array, right: Array, first: Mask) -> Array:
    """Return x (m, p) with x_0 = right_0 and x_i = kept_(i-1) x_(i-1) + right_i, where no `first` keeps anything."""
    band = np.ones((2, len(right)), order="F")
    band[1] = np.append(np.where(first[1:], 0.0, -kept), 0.0)
    return np.asarray(dtbtrs(band, np.asfortranarray(right), uplo="L", diag="U")[0])


def windows(time_s: Array, blur_s: float) -> list[tuple[Array, float]]:
    """Return the times (n,) at which a model is read, each with its weight, for speeds that are means over `blur_s`."""
    if blur_s == 0:
        return [(time_s, 1.0)]
    return [
        (time_s + blur_s / 2 * node, weight) for node, weight in zip(_NODES, _WEIGHTS / _WEIGHTS.sum(), strict=True)
    ]


def lasting(course: Course, time_s: Array, at: Indices, size: Array) -> csc_array:
    """Return how speeds (n,) at times (n,) change with deviations at the beginnings of some intervals (k,): (n, k).

    `size` (k,) is that of each deviation, which the rotor forgets.
    """
    place, passed = course.at(time_s)
    forgotten = course.forgotten
    seen = forgotten[place] - np.log(np.maximum(passed.by_speed, 1e-300))
    first = np.searchsorted(time_s, course.begin_s[at])
    last = np.maximum(np.searchsorted(np.maximum.accumulate(seen), forgotten[at] + FORGOTTEN), first)
    rows = [np.arange(begin, end) for begin, end in zip(first, last, strict=True)]
    value = [one * np.exp(forgotten[i] - seen[row]) for one, i, row in zip(size, at, rows, strict=True)]
    return _columns(rows, value, len(time_s))


def held(course: Course, time_s: Array, hold: Indices, wanted: Indices) -> csc_array:
    """Return how speeds (n,) at times (n,) change with the targets of some holds (k,) of the command: (n, k).

    `hold` (m,) is the number of each interval's hold, which lasts for one interval or for several.
    """
    place, passed = course.at(time_s)
    whole = pass_time(course.speed, course.target, course.length_s, course.k1, course.k2)
    begins = np.append(True, np.diff(hold) != 0)
    before = np.append(0.0, np.where(begins[1:], 0.0, whole.by_target[:-1]))
    inside = _bidiagonal(course.kept[:-1], before[:, np.newaxis], begins)[:, 0]
    value = passed.by_speed * inside[place] + passed.by_target
    rows = [np.arange(*np.searchsorted(hold[place], [number, number + 1])) for number in wanted]
    during = _columns(rows, [value[row] for row in rows], len(time_s))
    last = np.searchsorted(hold, wanted, side="right") - 1
    left = np.where(course.kept[last] > 0, course.kept[last] * inside[last] + whole.by_target[last], 0.0)
    return csc_array(during + lasting(course, time_s, np.minimum(last + 1, len(hold) - 1), left))


def _columns(rows: list[Indices], value: list[Array], count: int) -> csc_array:
    """Return a matrix (count, k) whose columns have values in some rows each."""
    ends = np.append(0, np.cumsum([len(row) for row in rows]))
    return csc_array(
        (np.concatenate([*value, np.zeros(0)]), np.concatenate([*rows, np.zeros(0, np.intp)]), ends),
        shape=(count, len(rows)),
    )
