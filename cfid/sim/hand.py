"""Simulates a hand that deflects a pendulum and releases it; `plants` swings it."""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Self

import numpy as np

from cfid.sim.stepping import Array, Indices, Time

# A grip of two fingers follows at this rate: far above any swing (about 14 rad/s), far below 1/step_s.
GRIP_RAD_PER_S = 250.0
_KEPT = 2  # times of a step that are needed again


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
