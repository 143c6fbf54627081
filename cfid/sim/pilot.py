"""Flies simulated quadrocopters: plans of manoeuvres, and a cascade of controllers like the firmware's.

Axes are x forward, y left, z up. The controllers know nothing but what sensors show, for n vehicles at once.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cfid.sim.stepping import Array
from cfid.units import FULL_COMMAND, MOTOR_AZIMUTH_DEG, MOTORS, ROTOR_TURNS, USUAL_GRAVITY_MPS2

PLAN_S = 0.01  # between rows of a plan
SPINS = np.array([ROTOR_TURNS[motor] for motor in MOTORS], np.float64)  # 1 is counterclockwise, seen from above
_AZIMUTHS = np.radians([MOTOR_AZIMUTH_DEG[motor] for motor in MOTORS])
HUBS = np.column_stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS), np.zeros(4)])  # over the arm
_MIXER = np.column_stack([np.ones(4), np.sign(HUBS[:, 1]), -np.sign(HUBS[:, 0]), -SPINS])  # thrust, roll, pitch, yaw
_ATTITUDE_S, _RATE_S = 0.004, 0.002
_PER_VELOCITY, _PER_STRAY = np.array([3.5, 3.5, 4.0]), np.array([0.7, 0.7, 3.2])  # 1/s, 1/s^2; x, y, z
_PER_TILT, _PER_LEAN = np.array([6.0, 6.0, 5.0]), np.array([1.0, 1.0, 0.5])  # 1/s, 1/s^2; roll, pitch, yaw
_PER_RATE, _PER_TURN, _PER_JERK = (
    np.array([28.0, 28.0, 10.0]),
    np.array([56.0, 56.0, 20.0]),
    np.array([0.84, 0.84, 0.0]),
)

Held = list[tuple[float, Mapping[int, float]]]  # for how many seconds which columns of a plan have which targets


def manoeuvres(kinds: Sequence[str], seconds: float, rng: np.random.Generator) -> Array:
    """Return a plan (n, 6) of `hover`, `climbs`, `tilts`, `yaw`, `turns` and `squares`, each for an equal time.

    Its columns are roll and pitch in rad, NaN where velocity decides on them, velocity along the world's x, y and z in
    m/s, and the yaw rate in rad/s.
    """
    plan = np.zeros((round(seconds / PLAN_S), 6))
    plan[:, :2] = np.nan
    for part, kind in zip(np.array_split(np.arange(len(plan)), len(kinds)), kinds, strict=True):
        at, end = int(part[0]) + round(1 / PLAN_S), int(part[-1]) + 1  # it hovers for a second before
        while at < end:
            for held_s, targets in _MANOEUVRES[kind](rng):
                until = min(at + round(held_s / PLAN_S), end)
                for column, target in targets.items():
                    plan[at:until, column] = target
                at = until
    return plan


def _tilts(rng: np.random.Generator) -> Held:
    """Return a tilt in roll or pitch, the opposite one for twice as long and the tilt again, and a pause to stop."""
    axis, held_s = int(rng.integers(2)), rng.uniform(0.2, 0.45)
    tilt = math.radians(rng.uniform(10, 25)) * rng.choice([-1, 1])
    there, back = {axis: tilt, 1 - axis: 0.0}, {axis: -tilt, 1 - axis: 0.0}
    return [(held_s, there), (2 * held_s, back), (held_s, there), (rng.uniform(0.6, 1.0), {})]


def _turns(rng: np.random.Generator) -> Held:
    """Return a tilt as in `_tilts` while the vehicle turns one way, and a pause."""
    rate = rng.uniform(2.0, 5.0) * rng.choice([-1, 1])
    *tilted, (pause_s, none) = _tilts(rng)
    return [(0.4, {5: rate}), *((held_s, {**tilt, 5: rate}) for held_s, tilt in tilted), (pause_s, none)]


def _there_and_back(column: int, least: float, most: float) -> Callable[[np.random.Generator], Held]:
    def held(rng: np.random.Generator) -> Held:
        target, held_s = rng.uniform(least, most) * rng.choice([-1, 1]), rng.uniform(0.3, 0.6)
        return [(held_s, {column: target}), (held_s, {column: -target}), (rng.uniform(0.2, 0.5), {})]

    return held


def _squares(rng: np.random.Generator) -> Held:
    speed, held_s = rng.uniform(0.4, 1.2), rng.uniform(0.8, 1.4)
    return [(held_s, {2: speed * x, 3: speed * y}) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1))]


_MANOEUVRES: Mapping[str, Callable[[np.random.Generator], Held]] = {
    "hover": lambda rng: [(1.0, {})],
    "climbs": _there_and_back(4, 0.3, 1.0),
    "tilts": _tilts,
    "yaw": _there_and_back(5, 1.5, 5.0),
    "turns": _turns,
    "squares": _squares,
}


class Controller:
    """Velocity at 100 Hz, attitude at 250 Hz and rate at 500 Hz, each with its integral, and the firmware's mixer.

    `shares` (n, 4) turn demands of acceleration, upwards in m/s^2 and about the axes in rad/s^2, into shares of the
    full command, which are `hover` (n, 1) without demands and never below `least` (n, 1).
    """

    def __init__(self, shares: Array, hover: Array, least: Array) -> None:
        """Begin at rest and level."""
        self._shares, self.hover, self._least = shares, hover, least
        self._climb, self._yaw = np.zeros((2, len(shares), 1))
        self._tilt, self._rates, self._before, self._quicker = np.zeros((4, len(shares), 3))
        self._strayed, self._leant, self._turned = np.zeros((3, len(shares), 3))  # integrals of errors
        self._command = self._mixed(self._before)

    def command(self, targets: Array, velocity: Array, attitude: Array, rates: Array, *, step: int) -> Array:
        """Return whole commands (n, 4) at a millisecond's step, by targets (n, 6) of a plan and by what sensors show.

        These are velocities (n, 3) along the world's axes, the matrices (n, 3, 3) to them, and rates (n, 3).
        """
        if step % round(1e3 * PLAN_S) == 0:
            self._follow(targets, velocity, attitude)
        if step % round(1e3 * _ATTITUDE_S) == 0:
            self._lean(attitude)
        if step % round(1e3 * _RATE_S) == 0:
            self._command = self._mixed(rates)
        return self._command

    def _follow(self, targets: Array, velocity: Array, attitude: Array) -> None:
        error = targets[:, 2:5] - velocity
        self._strayed = np.clip(self._strayed + PLAN_S * error, -3, 3)
        wanted = _PER_VELOCITY * error + _PER_STRAY * self._strayed
        self._climb = wanted[:, 2:]
        self._yaw += PLAN_S * targets[:, 5:]
        forward = attitude[:, :2, 0] / np.hypot(attitude[:, 0, 0], attitude[:, 1, 0])[:, np.newaxis]
        roll = np.sum(wanted[:, :2] * forward[:, ::-1] * np.array([1, -1]), axis=1) / USUAL_GRAVITY_MPS2
        pitch = np.sum(wanted[:, :2] * forward, axis=1) / USUAL_GRAVITY_MPS2
        tilt = np.clip(np.column_stack([roll, pitch]), -0.35, 0.35)
        self._tilt = np.hstack([np.where(np.isnan(targets[:, :2]), tilt, targets[:, :2]), self._yaw])

    def _lean(self, attitude: Array) -> None:
        error = (self._tilt - angles(attitude) + math.pi) % math.tau - math.pi
        self._leant = np.clip(self._leant + _ATTITUDE_S * error, -0.35, 0.35)
        self._rates = _PER_TILT * error + _PER_LEAN * self._leant

    def _mixed(self, rates: Array) -> Array:
        self._quicker = 0.75 * self._quicker + 0.25 * (rates - self._before) / _RATE_S
        self._before = rates
        error = self._rates - rates
        self._turned = np.clip(self._turned + _RATE_S * error, -1, 1)
        wanted = _PER_RATE * error + _PER_TURN * self._turned - _PER_JERK * self._quicker
        shares = self.hover + (self._shares * np.hstack([self._climb, wanted])) @ _MIXER.T
        shares -= np.maximum(np.max(shares, axis=1, keepdims=True) - 1, 0)  # attitude goes before thrust
        return np.asarray(np.floor(FULL_COMMAND * np.clip(shares, self._least, 1)))


def angles(attitude: Array) -> Array:
    """Return roll, pitch and yaw (n, 3) in rad of matrices (n, 3, 3) that turn a vehicle's axes to the world's."""
    roll = np.arctan2(attitude[:, 2, 1], attitude[:, 2, 2])
    return np.column_stack([roll, -np.arcsin(attitude[:, 2, 0]), np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])])
