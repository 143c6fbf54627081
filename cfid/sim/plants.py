"""Simulates the rig's two plants: a pendulum released by hand, and an axis turned by a dropping weight.

Each integrates its own equation of motion; nothing here knows how a parameter is estimated from it.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from cfid.sim.hand import HandRelease, Hands
from cfid.sim.stepping import Array, Indices, Motion, PlantState, Time, integrate

__all__ = ["DroppingWeight", "HandRelease", "Motion", "Pendulum", "drop", "swing"]


@dataclass(frozen=True, kw_only=True)
class Pendulum:
    """A body on the swing's axis (thesis eq. 2.8, its friction in three parts).

    I phi'' = -M_g sin(phi - rest) - c phi' - M_c sgn(phi') - k phi'|phi'| + hand, M_g = m g r.
    """

    axis_inertia_kg_m2: float
    gravity_moment_nm: float
    viscous_nms_per_rad: float = 0.0
    coulomb_nm: float = 0.0
    quadratic_nms2_per_rad2: float = 0.0
    rest_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class DroppingWeight:
    """A weight on a line wound around the axis (thesis eq. 2.12, with the weight's own inertia).

    (I + m r^2) phi'' = m g r - c phi' - M_c(phi) sgn(phi'), M_c(phi) = coulomb + ripple cos(phi), not below
    zero. A ripple makes the speed vary within each turn, as the thesis' 10 g did (figure 2.9). After
    `drop_m` the line is slack and the axis coasts.
    """

    setup_inertia_kg_m2: float
    weight_kg: float
    radius_m: float
    viscous_nms_per_rad: float
    coulomb_nm: float
    ripple_nm: float = 0.0
    gravity_mps2: float = 9.81
    drop_m: float = 1.0


def swing(
    pendulums: Sequence[Pendulum],
    releases: Sequence[HandRelease],
    *,
    duration_s: float,
    step_s: float = 5e-4,
    store_every: int = 2,
) -> Motion:
    """Swing k pendulums at once, each released by its own hand; all hang at rest at time zero.

    Every `store_every`-th step is kept, at 16 bytes per pendulum: use a larger one for thousands of pendulums.
    """
    columns = np.array([astuple(pendulum) for pendulum in pendulums]).T
    hands = Hands.on(releases, axis_inertia_kg_m2=columns[0], rest_rad=columns[-1])
    return integrate(_Swings(columns, hands), duration_s=duration_s, step_s=step_s, store_every=store_every)


def drop(
    weights: Sequence[DroppingWeight],
    *,
    duration_s: float,
    wait_s: float = 0.5,
    step_s: float = 5e-4,
    store_every: int = 1,
) -> Motion:
    """Let k weights fall, each on its own axis, from the first step at or after `wait_s`.

    The angle starts at zero and grows as the weight falls. A weight that friction can hold stays where it is.
    """
    columns = np.array([astuple(weight) for weight in weights]).T
    start_s = wait_s - 1e-6 * step_s  # a step that should begin at wait_s may round to just before
    return integrate(_Drops(columns, start_s), duration_s=duration_s, step_s=step_s, store_every=store_every)


class _Swings:
    """Axes of k pendulums; the columns are the fields of Pendulum, each a row (k,)."""

    _inertia: Array
    _moment: Array
    _viscous: Array
    _coulomb: Array
    _quadratic: Array
    _rest: Array

    def __init__(self, columns: Array, hands: Hands | None) -> None:
        self._columns = columns
        self._hands = hands
        self._inertia, self._moment, self._viscous, self._coulomb, self._quadratic, self._rest = columns

    @property
    def start_rad(self) -> Array:
        return self._rest.copy()

    @property
    def quiet_after_s(self) -> float:
        return self._hands.free_s if self._hands else 0.0

    def left_alone(self) -> "_Swings":
        return _Swings(self._columns, None)

    def select(self, which: Indices) -> "_Swings":
        return _Swings(self._columns[:, which], self._hands.select(which) if self._hands else None)

    def drive_nm(self, time_s: Time, angle_rad: Array, speed_rad_per_s: Array) -> Array:
        gravity = -self._moment * np.sin(angle_rad - self._rest)
        if self._hands is None:
            return gravity
        return gravity + self._hands.torque_nm(time_s, angle_rad, speed_rad_per_s)

    def dry_nm(self, angle_rad: Array) -> Array:
        return self._coulomb

    def acceleration(self, time_s: Time, state: PlantState) -> Array:
        angle, speed, direction = state
        brake = self._viscous * speed + direction * (self._coulomb + self._quadratic * speed * speed)
        torque = self.drive_nm(time_s, angle, speed) - brake
        return np.abs(direction) * torque / self._inertia


class _Drops:
    """Axes of k dropping weights; the columns are the fields of DroppingWeight, each a row (k,)."""

    _setup: Array
    _viscous: Array
    _coulomb: Array
    _ripple: Array

    def __init__(self, columns: Array, start_s: float) -> None:
        self._columns = columns
        self._start_s = start_s
        self._setup, weight, radius, self._viscous, self._coulomb, self._ripple, gravity, fall = columns
        self._pull: Array = weight * gravity * radius
        self._weight_inertia: Array = weight * radius**2
        self._slack_rad: Array = fall / radius

    @property
    def start_rad(self) -> Array:
        return np.zeros_like(self._setup)

    @property
    def quiet_after_s(self) -> float:
        return self._start_s

    def left_alone(self) -> "_Drops":
        return self

    def select(self, which: Indices) -> "_Drops":
        return _Drops(self._columns[:, which], self._start_s)

    def drive_nm(self, time_s: Time, angle_rad: Array, speed_rad_per_s: Array) -> Array:
        return self._pull * (angle_rad < self._slack_rad) * (time_s >= self._start_s)

    def dry_nm(self, angle_rad: Array) -> Array:
        return np.maximum(self._coulomb + self._ripple * np.cos(angle_rad), 0)

    def acceleration(self, time_s: Time, state: PlantState) -> Array:
        angle, speed, direction = state
        inertia = self._setup + self._weight_inertia * (angle < self._slack_rad)
        brake = self._viscous * speed + direction * self.dry_nm(angle)
        return np.abs(direction) * (self.drive_nm(time_s, angle, speed) - brake) / inertia
