"""Integrates many turning axes at once through dry friction in fixed steps; knows no rig and no device.

Dry friction jumps when an axis reverses. A step across the jump would chatter about standstill and creep, so the
direction of friction is constant within a step, and the step in which an axis comes to standstill is split there:
the axis then sticks, or moves in the other direction.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Time = float | Array

_NEWTON_STEPS = 3  # the speed is almost a straight line within a step: two reach the last digit


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """The motion of k axes: `time_s` (n,), `angle_rad` (n, k), `speed_rad_per_s` (n, k)."""

    time_s: Array
    angle_rad: Array
    speed_rad_per_s: Array


class PlantState(NamedTuple):
    """Angles, speeds and the directions that friction acts against (+1, -1, 0 where it sticks), each (k,)."""

    angle_rad: Array
    speed_rad_per_s: Array
    direction: Array


class Axes(Protocol):
    """The torques on k axes. All arrays have shape (k,)."""

    @property
    def start_rad(self) -> Array:
        """The axes' angles at time zero, at standstill."""

    @property
    def quiet_after_s(self) -> float:
        """The time from which the torques no longer depend on time."""

    def left_alone(self) -> Self:
        """Return the same axes after that time, cheaper to integrate."""

    def select(self, which: Indices) -> Self:
        """Return some of the axes."""

    def drive_nm(self, time_s: Time, angle_rad: Array, speed_rad_per_s: Array) -> Array:
        """Return the torque without the bearing's friction."""

    def dry_nm(self, angle_rad: Array) -> Array:
        """Return the level of dry friction at rest."""

    def acceleration(self, time_s: Time, state: PlantState) -> Array:
        """Return the acceleration in rad/s^2, zero for an axis that sticks."""


def integrate(axes: Axes, *, duration_s: float, step_s: float, store_every: int) -> Motion:
    """Integrate from standstill with the classical Runge-Kutta method.

    Every `store_every`-th step is kept, 16 bytes per axis each. The relative phase error of a free swing of
    angular frequency w is (w step_s)^4 / 120.
    """
    steps = round(duration_s / step_s)
    kept = steps // store_every + 1
    start = axes.start_rad
    state = PlantState(start, np.zeros_like(start), np.zeros_like(start))
    angle_rad = np.empty((kept, start.size))
    speed_rad_per_s = np.zeros((kept, start.size))
    angle_rad[0] = start
    alone = False
    for i in range(1, steps + 1):
        begin_s = (i - 1) * step_s
        if not alone:
            state = _start_moving(axes, state, begin_s)
            if begin_s > axes.quiet_after_s:
                axes, alone = axes.left_alone(), True
        state = _step(axes, state, begin_s, step_s)
        row, between = divmod(i, store_every)
        if not between:
            angle_rad[row] = state.angle_rad
            speed_rad_per_s[row] = state.speed_rad_per_s
            if alone and not np.count_nonzero(state.direction):  # all at rest for good
                angle_rad[row:] = state.angle_rad
                break
    time_s = step_s * store_every * np.arange(kept, dtype=np.float64)
    return Motion(time_s=time_s, angle_rad=angle_rad, speed_rad_per_s=speed_rad_per_s)


def _start_moving(axes: Axes, state: PlantState, time_s: float) -> PlantState:
    """Release axes that stick and are now driven by more torque than friction can hold."""
    stuck = np.flatnonzero(state.direction == 0)
    if not stuck.size:
        return state
    some = axes.select(stuck)
    direction = state.direction.copy()
    direction[stuck] = _way_out(some, time_s, state.angle_rad[stuck])
    return state._replace(direction=direction)


def _way_out(axes: Axes, time_s: Time, angle_rad: Array) -> Array:
    """Return the direction in which axes at standstill start: +1, -1, or 0 where friction holds them."""
    drive_nm = axes.drive_nm(time_s, angle_rad, np.zeros_like(angle_rad))
    held = np.abs(drive_nm) <= axes.dry_nm(angle_rad)
    return np.where(held, 0.0, np.sign(drive_nm))


def _step(axes: Axes, state: PlantState, time_s: float, step_s: float) -> PlantState:
    after = _runge_kutta(axes, state, time_s, step_s)
    back = after.speed_rad_per_s * state.direction < 0
    if np.count_nonzero(back):  # checked at every step, and quicker than flatnonzero
        turned = np.flatnonzero(back)
        before = PlantState(*(column[turned] for column in state))
        over = _step_over_standstill(axes.select(turned), before, time_s, step_s)
        for whole, part in zip(after, over, strict=True):
            whole[turned] = part
    return after


def _step_over_standstill(axes: Axes, before: PlantState, time_s: float, step_s: float) -> PlantState:
    """Return the state after one step that is split at standstill."""
    stop_s, angle_rad = _standstill(axes, before, time_s, step_s)
    direction = _way_out(axes, time_s + stop_s, angle_rad)
    still = PlantState(angle_rad, np.zeros_like(angle_rad), direction)
    after = _runge_kutta(axes, still, time_s + stop_s, step_s - stop_s)
    # Only a hand can turn an axis twice within a step: the axis stops here, and the next step starts from standstill.
    twice = after.speed_rad_per_s * direction < 0
    return PlantState(after.angle_rad, np.where(twice, 0.0, after.speed_rad_per_s), np.where(twice, 0.0, direction))


def _standstill(axes: Axes, before: PlantState, time_s: float, step_s: float) -> tuple[Array, Array]:
    """Return the time after the step's start at which the speed is zero, by Newton's method, and the angle there."""
    fall = -axes.acceleration(time_s, before) * before.direction
    stop_s = _ratio(before.speed_rad_per_s * before.direction, fall).clip(0, step_s)
    for _ in range(_NEWTON_STEPS):
        at = _runge_kutta(axes, before, time_s, stop_s)
        change = _ratio(at.speed_rad_per_s, axes.acceleration(time_s + stop_s, at))
        stop_s = (stop_s - change).clip(0, step_s)
    return stop_s, _runge_kutta(axes, before, time_s, stop_s).angle_rad


def _ratio(above: Array, below: Array) -> Array:
    return np.divide(above, below, out=np.zeros_like(above), where=below != 0)


def _runge_kutta(axes: Axes, state: PlantState, time_s: Time, step_s: Time) -> PlantState:
    angle, speed, direction = state
    half_s = 0.5 * step_s
    middle_s = time_s + half_s
    first = axes.acceleration(time_s, state)
    speed_2 = speed + half_s * first
    second = axes.acceleration(middle_s, PlantState(angle + half_s * speed, speed_2, direction))
    speed_3 = speed + half_s * second
    third = axes.acceleration(middle_s, PlantState(angle + half_s * speed_2, speed_3, direction))
    speed_4 = speed + step_s * third
    fourth = axes.acceleration(time_s + step_s, PlantState(angle + step_s * speed_3, speed_4, direction))
    middle = second + third
    return PlantState(
        angle + step_s * (speed + (step_s / 6) * (first + middle)),
        speed + (step_s / 6) * (first + 2 * middle + fourth),
        direction.copy(),
    )
