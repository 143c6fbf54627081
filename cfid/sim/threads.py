"""Simulates a body on two threads that turns about the vertical, by the forces in the threads (Newton, not energies).

Each thread is straight, of constant length and without mass. As the body turns by phi, the lower ends move on a circle,
the threads lean and the body rises. The vertical part of their tension carries the body and accelerates it vertically;
the horizontal part turns the body back.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from cfid.sim.hand import HandRelease, Hands
from cfid.sim.stepping import Array, Indices, Motion, PlantState, Time, integrate


@dataclass(frozen=True, kw_only=True)
class TwoThreads:
    """A body on two threads: its inertia about the vertical through its centre of mass, which lies in their middle.

    `above_m` and `below_m` are the distances between the threads. Air and the threads brake it.
    """

    inertia_kg_m2: float
    mass_kg: float
    gravity_mps2: float
    above_m: float
    below_m: float
    length_m: float
    viscous_nms_per_rad: float = 0.0
    coulomb_nm: float = 0.0
    quadratic_nms2_per_rad2: float = 0.0
    rest_rad: float = 0.0


def twist(
    bodies: Sequence[TwoThreads],
    releases: Sequence[HandRelease],
    *,
    duration_s: float,
    step_s: float = 5e-4,
    store_every: int = 2,
) -> Motion:
    """Turn k bodies at once, each released by its own hand; arguments and result as those of `plants.swing`."""
    columns = np.array([astuple(body) for body in bodies]).T
    hands = Hands.on(releases, axis_inertia_kg_m2=columns[0], rest_rad=columns[-1])
    return integrate(_Twisting(columns, hands), duration_s=duration_s, step_s=step_s, store_every=store_every)


class _Twisting:
    """k bodies; the columns are the fields of TwoThreads, each a row (k,)."""

    _inertia: Array
    _mass: Array
    _gravity: Array
    _viscous: Array
    _coulomb: Array
    _quadratic: Array
    _rest: Array

    def __init__(self, columns: Array, hands: Hands | None) -> None:
        self._columns, self._hands = columns, hands
        self._inertia, self._mass, self._gravity, above, below, length, *others = columns
        self._viscous, self._coulomb, self._quadratic, self._rest = others
        self._above, self._below, self._length = above / 2, below / 2, length

    @property
    def start_rad(self) -> Array:
        return self._rest.copy()

    @property
    def quiet_after_s(self) -> float:
        return self._hands.free_s if self._hands else 0.0

    def left_alone(self) -> "_Twisting":
        return _Twisting(self._columns, None)

    def select(self, which: Indices) -> "_Twisting":
        return _Twisting(self._columns[:, which], self._hands.select(which) if self._hands else None)

    def drive_nm(self, time_s: Time, angle_rad: Array, speed_rad_per_s: Array) -> Array:
        """Return the torque on a body that does not yet accelerate."""
        lever, _ = self._lever(angle_rad)
        return self._hand_nm(time_s, angle_rad, speed_rad_per_s) - self._mass * self._gravity * lever

    def dry_nm(self, angle_rad: Array) -> Array:
        return self._coulomb

    def acceleration(self, time_s: Time, state: PlantState) -> Array:
        """Solve the torque's balance, in which the tension depends on the acceleration sought.

        The body moves up by lever dphi, so its vertical acceleration is lever phi'' + slope phi'^2.
        """
        angle, speed, direction = state
        lever, slope = self._lever(angle)
        weight_n = self._mass * (self._gravity + slope * speed**2)
        brake = self._viscous * speed + direction * (self._coulomb + self._quadratic * speed**2)
        torque = self._hand_nm(time_s, angle, speed) - lever * weight_n - brake
        return np.asarray(np.abs(direction) * torque / (self._inertia + self._mass * lever**2))

    def _hand_nm(self, time_s: Time, angle_rad: Array, speed_rad_per_s: Array) -> Array:
        if self._hands is None:
            return np.zeros_like(angle_rad)
        return self._hands.torque_nm(time_s, angle_rad, speed_rad_per_s)

    def _lever(self, angle_rad: Array) -> tuple[Array, Array]:
        """Return torque over carried force in m, and its derivative with the angle.

        A lower end lies `aside` of its upper end, across the line from there to the vertical; a thread that carries a
        force F and rises by `height` pulls sideways by F aside / height, on the arm of the upper end.
        """
        turned = angle_rad - self._rest
        aside, along = self._below * np.sin(turned), self._below * np.cos(turned)
        lean = aside**2 + (self._above - along) ** 2
        height = np.sqrt(self._length**2 - lean)
        lever = self._above * aside / height
        return lever, (self._above * along + lever**2) / height
