"""Simulates the rig's plants: bodies on an axis or on threads, released by hand, and an axis turned by a weight.

Each integrates its own equation of motion; nothing here knows how a parameter is estimated from it.
"""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from cfid.sim.stepping import Array, Indices, Motion, PlantState, Time, integrate

STRIBECK_RAD_PER_S = 0.5  # the speed at which a bearing's static friction has fallen to a third
# A grip of two fingers follows at this rate: far above any swing (about 14 rad/s), far below 1/step_s.
GRIP_RAD_PER_S = 250.0

_KEPT = 2  # times of a step that are needed again

__all__ = ["DroppingWeight", "HandRelease", "Motion", "Pendulum", "TwoThreads", "drop", "swing"]


@dataclass(frozen=True, kw_only=True)
class HandRelease:
    """A hand that waits, deflects the pendulum by `angle_rad` from rest, holds it trembling, and releases it.

    The lift has minimum jerk (T. Flash and N. Hogan, J. Neurosci. 5, 1985); the grip is a stiff spring and
    damper that fades smoothly within `let_go_s`. Raises ValueError for a lift or a fade without duration.
    """

    angle_rad: float
    wait_s: float = 0.5
    lift_s: float = 0.6
    hold_s: float = 0.8
    tremor_rad: float = 0.003
    tremor_hz: float = 9.0
    tremor_phase_rad: float = 0.0
    let_go_s: float = 0.02

    def __post_init__(self) -> None:
        """Reject a hand that would have to be infinitely fast."""
        if not (self.lift_s > 0 and self.let_go_s > 0):
            raise ValueError("a hand needs time: lift_s and let_go_s are above zero")

    @property
    def free_s(self) -> float:
        """The time from which the hand no longer acts on the pendulum."""
        return self.wait_s + self.lift_s + self.hold_s + self.let_go_s


class Hands:
    """The hands of k pendulums, as torques on their axes. All arrays have shape (k,)."""

    def __init__(self, columns: Array) -> None:
        """Take inertia, rest and the fields of HandRelease, each a row (k,)."""
        self._columns = columns
        inertia, self._rest, self._angle, self._wait, self._lift, hold, *others = columns
        self._tremor, tremor_hz, self._phase, self._let_go = others
        self._rate = 2 * math.pi * tremor_hz
        self._fades = self._wait + self._lift + hold
        self._begins, self._takes = np.array([self._wait, self._fades]), np.array([self._lift, self._let_go])
        self._stiffness = inertia * GRIP_RAD_PER_S**2
        self._damping = 2 * inertia * GRIP_RAD_PER_S  # no overshoot
        self._latest: dict[float, tuple[Array, Array, Array]] = {}

    @classmethod
    def on(cls, releases: Sequence[HandRelease], *, axis_inertia_kg_m2: Array, rest_rad: Array) -> Self:
        """Put a hand on each axis; its grip's stiffness is proportional to the axis' inertia."""
        columns = np.array([astuple(release) for release in releases]).T
        return cls(np.vstack((axis_inertia_kg_m2, rest_rad, columns)))

    @property
    def free_s(self) -> float:
        """The time at which the last hand has released its pendulum."""
        return float(np.max(self._fades + self._let_go))

    def select(self, which: Indices) -> "Hands":
        """Return some of the hands."""
        return Hands(self._columns[:, which])

    def torque_nm(self, time_s: Time, angle_rad: Array, speed_rad_per_s: Array) -> Array:
        """Return the torque on each axis."""
        target, target_speed, grip = self._at(time_s)
        pull = self._stiffness * (target - angle_rad) + self._damping * (target_speed - speed_rad_per_s)
        return np.asarray(grip * pull)

    def _at(self, time_s: Time) -> tuple[Array, Array, Array]:
        """Return the angles and speeds that the hands follow, and how firm their grips are, from 0 to 1.

        A step of the integration needs its middle twice, and the next step needs the end of this one again.
        """
        if not isinstance(time_s, float):
            return self._course(time_s)
        if time_s not in self._latest:
            if len(self._latest) == _KEPT:
                del self._latest[next(iter(self._latest))]
            self._latest[time_s] = self._course(time_s)
        return self._latest[time_s]

    def _course(self, time_s: Time) -> tuple[Array, Array, Array]:
        (lifted, let_go), (lifting, _) = _minimum_jerk((time_s - self._begins) / self._takes)
        phase = self._rate * time_s + self._phase
        held = self._angle + self._tremor * np.sin(phase)
        target = self._rest + lifted * held
        target_speed = lifting / self._lift * held + lifted * self._tremor * self._rate * np.cos(phase)
        return target, target_speed, 1 - let_go


def _minimum_jerk(x: Array) -> tuple[Array, Array]:
    """Return the smooth path from 0 to 1 while x goes from 0 to 1, and its slope."""
    x = np.minimum(np.maximum(x, 0), 1)  # four times as fast as clip on few axes
    slope = x * (1 - x)
    return x * x * x * (10 + x * (6 * x - 15)), 30 * slope * slope


@dataclass(frozen=True, kw_only=True)
class Pendulum:
    """A body on the swing's axis (thesis eq. 2.8, its friction in three parts).

    I phi'' = -M_g sin(phi - rest) - s (phi - rest) - c phi' - M_c sgn(phi') - k phi'|phi'| + hand, M_g = m g r.
    `spring_nm_per_rad`, s, is that of a cable. Dry friction is M_c + ripple cos(phi) + stribeck exp(-(phi'/w)^2), with
    w = STRIBECK_RAD_PER_S, and not below zero.
    """

    axis_inertia_kg_m2: float
    gravity_moment_nm: float
    viscous_nms_per_rad: float = 0.0
    coulomb_nm: float = 0.0
    quadratic_nms2_per_rad2: float = 0.0
    spring_nm_per_rad: float = 0.0
    stribeck_nm: float = 0.0
    ripple_nm: float = 0.0
    rest_rad: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TwoThreads:
    """A body on two threads: its inertia about the vertical through its centre of mass, which lies in their middle.

    `above_m` and `below_m` are the distances between the threads. Air and the threads brake it. Threads are straight,
    of constant length and without mass: as the body turns by phi, the lower ends move on a circle, the threads lean and
    the body rises. The vertical part of their tension carries the body and accelerates it vertically; the horizontal
    part turns the body back. These are the forces (Newton), not the energies.
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


@dataclass(frozen=True, kw_only=True)
class DroppingWeight:
    """A weight on a line wound around the axis (thesis eq. 2.12, with the weight's own inertia).

    (I + m r^2) phi'' = m g r - c phi' - M_c(phi) sgn(phi'), M_c(phi) = coulomb + ripple cos(phi), not below
    zero. A ripple makes the speed vary within each turn, as the thesis' 10 g did (figure 2.9). After
    `drop_m` the line is slack and the axis coasts.

    A line of `line_diameter_m` pulls at half of that beyond the axis' radius. With `turns_per_layer` it was wound in
    layers of that many turns, each a diameter further out, and the outermost unwinds first.
    """

    setup_inertia_kg_m2: float
    weight_kg: float
    radius_m: float
    viscous_nms_per_rad: float
    coulomb_nm: float
    ripple_nm: float = 0.0
    gravity_mps2: float = 9.81
    drop_m: float = 1.0
    line_diameter_m: float = 0.0
    turns_per_layer: float = 0.0


def swing(
    bodies: Sequence[Pendulum | TwoThreads],
    releases: Sequence[HandRelease],
    *,
    duration_s: float,
    step_s: float = 5e-4,
    store_every: int = 2,
) -> Motion:
    """Swing k pendulums, or k bodies on threads, each released by its own hand; all hang at rest at time zero.

    Every `store_every`-th step is kept, at 16 bytes per body: use a larger one for thousands of bodies.
    """
    columns = np.array([astuple(body) for body in bodies]).T
    hands = Hands.on(releases, axis_inertia_kg_m2=columns[0], rest_rad=columns[-1])
    axes = _Twisting(columns, hands) if isinstance(bodies[0], TwoThreads) else _Swinging(columns, hands)
    return integrate(axes, duration_s=duration_s, step_s=step_s, store_every=store_every)


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


class _HandSwung:
    """Axes of k bodies, of which each column has the fields and ends with the angle at rest, each a row (k,)."""

    _rest: Array

    def __init__(self, columns: Array, hands: Hands | None) -> None:
        self._columns, self._hands = columns, hands
        self._rest = columns[-1]

    @property
    def start_rad(self) -> Array:
        return self._rest.copy()

    @property
    def quiet_after_s(self) -> float:
        return self._hands.free_s if self._hands else 0.0

    def left_alone(self) -> Self:
        return type(self)(self._columns, None)

    def select(self, which: Indices) -> Self:
        return type(self)(self._columns[:, which], self._hands.select(which) if self._hands else None)


class _Swinging(_HandSwung):
    """Axes of k pendulums."""

    _inertia: Array
    _moment: Array
    _viscous: Array
    _coulomb: Array
    _quadratic: Array
    _spring: Array
    _stribeck: Array
    _ripple: Array

    def __init__(self, columns: Array, hands: Hands | None) -> None:
        super().__init__(columns, hands)
        self._inertia, self._moment, self._viscous, self._coulomb, self._quadratic, *others = columns
        self._spring, self._stribeck, self._ripple, _ = others
        self._upward, self._sprung = -self._moment, bool(self._spring.any())
        self._even = not (self._stribeck.any() or self._ripple.any())

    def drive_nm(self, time_s: Time, angle_rad: Array, speed_rad_per_s: Array) -> Array:
        deflection = angle_rad - self._rest
        back = self._upward * np.sin(deflection)
        if self._sprung:
            back = back - self._spring * deflection
        if self._hands is None:
            return back
        return back + self._hands.torque_nm(time_s, angle_rad, speed_rad_per_s)

    def dry_nm(self, angle_rad: Array) -> Array:
        return self._dry_nm(angle_rad, 0.0)

    def _dry_nm(self, angle_rad: Array, speed_rad_per_s: Array | float) -> Array:
        if self._even:  # saves half of the integration's time
            return self._coulomb
        stribeck = self._stribeck * np.exp(-((speed_rad_per_s / STRIBECK_RAD_PER_S) ** 2))
        return np.asarray(np.maximum(self._coulomb + self._ripple * np.cos(angle_rad) + stribeck, 0))

    def acceleration(self, time_s: Time, state: PlantState) -> Array:
        angle, speed, direction = state
        brake = self._viscous * speed + direction * (self._dry_nm(angle, speed) + self._quadratic * speed * speed)
        torque = self.drive_nm(time_s, angle, speed) - brake
        return np.abs(direction) * torque / self._inertia


class _Twisting(_HandSwung):
    """k bodies on threads."""

    _inertia: Array
    _mass: Array
    _gravity: Array
    _viscous: Array
    _coulomb: Array
    _quadratic: Array

    def __init__(self, columns: Array, hands: Hands | None) -> None:
        super().__init__(columns, hands)
        self._inertia, self._mass, self._gravity, above, below, length, *others = columns
        self._viscous, self._coulomb, self._quadratic, self._rest = others
        self._above, self._below, self._length = above / 2, below / 2, length

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


class _Drops:
    """Axes of k dropping weights; the columns are the fields of DroppingWeight, each a row (k,)."""

    _setup: Array
    _viscous: Array
    _coulomb: Array
    _ripple: Array
    _weight: Array
    _pull_n: Array

    def __init__(self, columns: Array, start_s: float) -> None:
        self._columns = columns
        self._start_s = start_s
        self._setup, weight, radius, self._viscous, self._coulomb, self._ripple, gravity, fall, line, turns = columns
        self._winding = _Winding(radius + line / 2, line, 2 * math.pi * turns, fall)
        self._weight, self._pull_n = weight, weight * gravity
        self._even = not self._ripple.any()

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
        return self._pull_nm(time_s, *self._winding.at(angle_rad))

    def _pull_nm(self, time_s: Time, radius_m: Array, taut: npt.NDArray[np.bool_]) -> Array:
        return np.asarray(self._pull_n * radius_m * taut * (time_s >= self._start_s))

    def dry_nm(self, angle_rad: Array) -> Array:
        if self._even:
            return self._coulomb
        return np.maximum(self._coulomb + self._ripple * np.cos(angle_rad), 0)

    def acceleration(self, time_s: Time, state: PlantState) -> Array:
        angle, speed, direction = state
        radius, taut = self._winding.at(angle)
        inertia = self._setup + self._weight * radius**2 * taut
        brake = self._viscous * speed + direction * self.dry_nm(angle)
        return np.abs(direction) * (self._pull_nm(time_s, radius, taut) - brake) / inertia


class _Winding:
    """Lines of a length wound around k axes, in layers of `layer_rad` or, where that is zero, in one; each (k,)."""

    def __init__(self, radius_m: Array, line_m: Array, layer_rad: Array, length_m: Array) -> None:
        self._radius_m, self._line_m, self._layer_rad = radius_m, line_m, layer_rad
        self._layered = bool((line_m * layer_rad).any())
        # n full layers hold layer_rad (n r + d n (n - 1) / 2); the outermost layer begins within the length.
        with np.errstate(divide="ignore", invalid="ignore"):
            lever = radius_m / line_m - 0.5
            full = np.floor(-lever + np.sqrt(lever**2 + 2 * length_m / (layer_rad * line_m)))
        full = np.where(line_m * layer_rad > 0, full, 0.0)
        wound_m = layer_rad * (full * radius_m + line_m * full * (full - 1) / 2)
        self._slack_rad = full * layer_rad + (length_m - wound_m) / (radius_m + full * line_m)

    def at(self, angle_rad: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Return the radius in m at which each line pulls, and whether it is still taut."""
        taut = angle_rad < self._slack_rad
        if not self._layered:
            return self._radius_m, taut
        left = np.maximum(self._slack_rad - angle_rad, 0.0)
        below = np.divide(left, self._layer_rad, out=np.zeros_like(left), where=self._layer_rad > 0)
        return self._radius_m + self._line_m * np.floor(below), taut
