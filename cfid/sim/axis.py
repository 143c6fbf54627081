"""Gives an axis' motion at any time: of a pendulum released repeatedly, or a weight dropped repeatedly.

A few experiments are integrated beforehand, all at once, and then repeat in turn, so that no integration is left to do
while a device has to answer.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cfid.sim.plants import DroppingWeight, HandRelease, Motion, Pendulum, drop, swing
from cfid.sim.rig import draw_release
from cfid.sim.threads import TwoThreads, twist

PERIOD_S = 20.0
RELEASES = 16
DROPS = 4

_STEP_S = 2e-3
_STEADIED_S = 0.35  # ends before any hand of `draw_release` lifts
_WOUND_UP_S = 4.0
_FALLS_AFTER_S = 4.5


class Axis:
    """An axis that repeats motions of PERIOD_S each, from time zero on; before that it stands still.

    Each motion starts at zero. At its start the angle that the previous motion left returns to zero within `return_s`,
    as smoothly as by hand: the pendulum is steadied, or the line wound up.
    """

    def __init__(self, motion: Motion, *, return_s: float, offset_rad: float, eccentricity_rad: float = 0.0) -> None:
        """Take k motions (n, k) in equal steps; the encoder's zero and eccentricity are those of EncoderModel."""
        self._angles = motion.angle_rad.T.tolist()  # lists: reading single numbers from them is faster
        self._speeds = motion.speed_rad_per_s.T.tolist()
        self._step_s = float(motion.time_s[1] - motion.time_s[0])
        self._return_s = return_s
        self._offset_rad = offset_rad
        self._eccentricity_rad = eccentricity_rad

    def angle_at(self, time_s: float) -> float:
        """Return the angle in rad that the encoder sees: the cubic through the two nearest steps, plus its error."""
        angle_rad = self._turned(time_s) + self._offset_rad
        return angle_rad + self._eccentricity_rad * math.sin(angle_rad)

    def motion_at(self, time_s: float) -> tuple[float, float, float]:
        """Return angle, speed and acceleration of the body itself, in rad, rad/s and rad/s^2."""
        half_s = self._step_s / 4
        before, angle_rad, after = (self._turned(time_s + shift_s) for shift_s in (-half_s, 0.0, half_s))
        return angle_rad, (after - before) / (2 * half_s), (after - 2 * angle_rad + before) / half_s**2

    def _turned(self, time_s: float) -> float:
        turn, into_s = divmod(max(time_s, 0.0), PERIOD_S)
        which = int(turn) % len(self._angles)
        angle_rad = _between(self._angles[which], self._speeds[which], into_s / self._step_s, self._step_s)
        if turn and into_s < self._return_s:
            left_rad = self._angles[which - 1][-1]  # of the last motion, if this is the first again
            angle_rad += left_rad * _smooth(1 - into_s / self._return_s)
        return angle_rad


def swinging(body: Pendulum | TwoThreads, *, rng: np.random.Generator, eccentricity_rad: float = 0.0) -> Axis:
    """Return the axis of a pendulum, or of a body on threads, that a hand deflects and releases every PERIOD_S.

    Each release differs; after RELEASES of them, about five minutes, they repeat.
    """
    releases: Sequence[HandRelease] = [draw_release(rng) for _ in range(RELEASES)]
    settings: dict[str, Any] = {"duration_s": PERIOD_S, "step_s": _STEP_S, "store_every": 1}
    if isinstance(body, TwoThreads):
        motion = twist([body] * RELEASES, releases, **settings)
    else:
        motion = swing([body] * RELEASES, releases, **settings)
    offset_rad = rng.uniform(0, 2 * math.pi)
    return Axis(motion, return_s=_STEADIED_S, offset_rad=offset_rad, eccentricity_rad=eccentricity_rad)


def dropping(weights: Sequence[DroppingWeight], *, rng: np.random.Generator, eccentricity_rad: float = 0.0) -> Axis:
    """Return the axis that falling weights turn, one after the other; the line is wound up again before each."""
    motion = drop(weights, duration_s=PERIOD_S, wait_s=_FALLS_AFTER_S, step_s=_STEP_S)
    offset_rad = rng.uniform(0, 2 * math.pi)
    return Axis(motion, return_s=_WOUND_UP_S, offset_rad=offset_rad, eccentricity_rad=eccentricity_rad)


def resting(*, offset_rad: float) -> Axis:
    """Return an axis on which nothing hangs."""
    still = Motion(time_s=np.array([0.0, PERIOD_S]), angle_rad=np.zeros((2, 1)), speed_rad_per_s=np.zeros((2, 1)))
    return Axis(still, return_s=_STEADIED_S, offset_rad=offset_rad)


def _between(angles: list[float], speeds: list[float], steps: float, step_s: float) -> float:
    """Return the cubic Hermite polynomial between the two samples around `steps`."""
    i = min(int(steps), len(angles) - 2)
    x = steps - i
    rise = angles[i + 1] - angles[i]
    begin, end = speeds[i] * step_s - rise, rise - speeds[i + 1] * step_s
    return angles[i] + x * (rise + (1 - x) * ((1 - x) * begin + x * end))


def _smooth(x: float) -> float:
    """Return the path of minimum jerk from 0 to 1 at `x`."""
    return x * x * x * (10 + x * (6 * x - 15))
