"""Simulates the rig's two plants: a pendulum released by hand, and an axis turned by a dropping weight.

Each integrates its own equation of motion; nothing here knows how a parameter is estimated from it.
"""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import numpy.typing as npt

from cfid.sim.hand import HandRelease, Hands
from cfid.sim.stepping import Array, Indices, Motion, PlantState, Time, integrate

STRIBECK_RAD_PER_S = 0.5  # the speed at which a bearing's static friction has fallen to a third

__all__ = ["DroppingWeight", "HandRelease", "Motion", "Pendulum", "drop", "swing"]


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
    return integrate(_SwingingAxes(columns, hands), duration_s=duration_s, step_s=step_s, store_every=store_every)


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


class _SwingingAxes:
    """Axes of k pendulums; the columns are the fields of Pendulum, each a row (k,)."""

    _inertia: Array
    _moment: Array
    _viscous: Array
    _coulomb: Array
    _quadratic: Array
    _spring: Array
    _stribeck: Array
    _ripple: Array
    _rest: Array

    def __init__(self, columns: Array, hands: Hands | None) -> None:
        self._columns = columns
        self._hands = hands
        self._inertia, self._moment, self._viscous, self._coulomb, self._quadratic, *others = columns
        self._spring, self._stribeck, self._ripple, self._rest = others
        self._upward, self._sprung = -self._moment, bool(self._spring.any())
        self._even = not (self._stribeck.any() or self._ripple.any())

    @property
    def start_rad(self) -> Array:
        return self._rest.copy()

    @property
    def quiet_after_s(self) -> float:
        return self._hands.free_s if self._hands else 0.0

    def left_alone(self) -> "_SwingingAxes":
        return _SwingingAxes(self._columns, None)

    def select(self, which: Indices) -> "_SwingingAxes":
        return _SwingingAxes(self._columns[:, which], self._hands.select(which) if self._hands else None)

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
