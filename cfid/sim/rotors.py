"""Simulates four motors with rotors on a load cell: from command to forces and torques, with the blades' vibration.

Speed is a first-order lag, which thrust and torque follow without delay; the motion of the air is not modelled.
"""

import math
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from cfid.records.rig_file import Number, Positive, Spread
from cfid.sim.stepping import Array
from cfid.sim.wander import Wander
from cfid.wire.app import LARGEST_COMMAND

Four = tuple[Number, Number, Number, Number]
Six = tuple[Number, Number, Number, Number, Number, Number]

WANDER_S = 0.1
NOMINAL_V = 3.7  # of a lithium cell that is half empty
# Crazyflie 2.0, motor 1 to 4, x forward and y left: front right, back right, back left, front left.
_ARMS = np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]]) / math.sqrt(2)
_TURNS_LEFT = np.array([1, -1, 1, -1])  # seen from above
_STANDSTILL_RAD_PER_S = 1e-3
_HELD_S = 0.3  # longer than a sine holds a command, shorter than a staircase does


class RotorTruth(BaseModel):
    """Motors near those of a Crazyflie 2.0 (thesis, tables of chapter 3).

    Above the dead zone a rotor's steady speed is `idle_rad_per_s` + `rad_per_s_per_command` * command, reached
    with `time_constant_s`; below it the rotor stands still. That holds at `nominal_v`: the command chops the supply
    voltage, so half the voltage acts like half the command. A rotor's thrust is `thrust_ns2_per_rad2` w^2, its
    torque `torque_m` times the thrust. Lines at rotor frequency (`unbalance`, a bent or dirty rotor) and at twice
    that (`blade_pass`) act on Fx to Tz with that many N or Nm per newton of thrust; `unbalance_by_motor` multiplies a
    motor's own. A tachometer counts `markers` a turn.

    A rotor takes longer to slow down by the fraction `slower_fall`. The arm is longer than rig.toml's by `arm_error`.
    `thrust_scatter` and `speed_wander` are relative standard deviations: of a rotor's thrust from one held command to
    the next, and of its speed over time, correlated over WANDER_S. The tachometer reads too much by `tachometer_gain`,
    with a relative noise of `tachometer_std`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    rad_per_s_per_command: Positive = 0.0408
    idle_rad_per_s: Spread = 381.0
    dead_below_command: Number = 1000.0
    nominal_v: Positive = NOMINAL_V
    thrust_ns2_per_rad2: Positive = 1.8e-8
    torque_m: Positive = 0.006
    time_constant_s: Positive = 0.06
    arm_m: Positive = 0.046
    markers: Annotated[int, Field(ge=1)] = 2
    slower_fall: Number = 0.0
    arm_error: Number = 0.0
    thrust_scatter: Spread = 0.0
    speed_wander: Spread = 0.0
    tachometer_gain: Number = 0.0
    tachometer_std: Spread = 4e-4  # as the UT372's maker states it
    unbalance: Six = Field(default=(0.6, 0.6, 0.3, 0.006, 0.006, 0.002))
    unbalance_by_motor: Four = Field(default=(1.0, 1.0, 1.0, 1.0))
    blade_pass: Six = Field(default=(0.2, 0.2, 1.2, 0.004, 0.004, 0.003))

    def steady_rad_per_s(self, command: Array, *, volts: Array | float) -> Array:
        """Return the steady speeds of commands of any shape, which saturate at the largest command."""
        felt = np.minimum(command, LARGEST_COMMAND) * (volts / self.nominal_v)
        return np.where(felt < self.dead_below_command, 0.0, self.idle_rad_per_s + self.rad_per_s_per_command * felt)

    def lag_s(self, ahead: Array) -> Array | float:
        """Return the time constants of rotors whose speeds are ahead of (+) or behind (-) the steady ones."""
        if not self.slower_fall:
            return self.time_constant_s
        return self.time_constant_s * np.where(ahead > 0, 1 + self.slower_fall, 1.0)

    def power_w(self, speed_rad_per_s: Array) -> Array:
        """Return the mechanical power that turns rotors at these speeds in air."""
        return self.torque_m * self.thrust_ns2_per_rad2 * speed_rad_per_s**3


# A Crazyflie 2.1 Brushless: 0.36 rpm a unit of command from zero on, so that idle thrust, 7000, gives 2520 rpm.
BRUSHLESS = {
    "rad_per_s_per_command": 0.36 * math.tau / 60,
    "idle_rad_per_s": 0.0,
    "dead_below_command": 0.0,
    "time_constant_s": 0.05,
}


class SimulatedRotors:
    """Four rotors that keep their speed and angle from one call to the next.

    In wind each rad/s of their speeds' sum adds `drag_ns_per_rad` (3,) to the force, in the load cell's frame, whose x
    axis lies `yaw_deg` left of the vehicle's.
    """

    def __init__(
        self,
        truth: RotorTruth,
        rng: np.random.Generator,
        *,
        drag_ns_per_rad: npt.ArrayLike = (0.0, 0.0, 0.0),
        yaw_deg: float = 0.0,
    ) -> None:
        """Start with all rotors at standstill; their vibrations differ by up to 20 % and in phase."""
        self._truth = truth
        self._drag = np.append(drag_ns_per_rad, np.zeros(3))
        self._mixer = _mixer(truth, rng) @ _into_the_cell(yaw_deg)
        self._speed = np.zeros(4)
        self._angle = np.zeros(4)
        self._last_s: float | None = None
        self._rng = rng.spawn(1)[0] if truth.thrust_scatter or truth.speed_wander else None
        self._factor = np.ones(4)
        self._command, self._since_s = np.zeros(4), -math.inf
        self._wander: Wander | None = None
        if truth.speed_wander and self._rng is not None:
            self._wander = Wander([truth.speed_wander] * 4, correlation_s=WANDER_S, rng=self._rng)

    @property
    def speed_rad_per_s(self) -> Array:
        """The rotors' speeds (4,), without their directions."""
        return self._speed.copy()

    def advance(self, time_s: Array, command: Array, *, volts: float | None = None) -> Array:
        """Return the wrench (n, 6) in N and Nm, z up, at times (n,) that do not decrease, within a call or between two.

        `command` (4,) and the supply voltage, nominal by default, hold since the last time of the previous call, for
        which the lag is solved exactly.
        """
        begin_s = time_s[0] if self._last_s is None else self._last_s
        return self.play(time_s, np.atleast_1d(begin_s), command[np.newaxis], volts=volts)

    def play(self, time_s: Array, begin_s: Array, commands: Array, *, volts: float | None = None) -> Array:
        """Return the wrench (n, 6) of commands (m, 4), each of which holds from its beginning (m,) to the next one's.

        The first command begins at the last time of the previous call, and none begins after the last of these times.
        """
        self._last_s = float(time_s[-1])
        steady = self._truth.steady_rad_per_s(commands, volts=self._truth.nominal_v if volts is None else volts)
        if not steady.any() and self._speed.max() < _STANDSTILL_RAD_PER_S:
            self._speed[:] = 0
            return np.zeros((len(time_s), 6))
        bounds_s = np.append(begin_s, self._last_s)
        turned = None if self._wander is None else self._wander.integral(bounds_s)
        holds = [
            self._hold(
                commands[i], steady[i], bounds_s[i], bounds_s[i + 1], None if turned is None else turned[i : i + 2]
            )
            for i in range(len(begin_s))
        ]
        hold = np.searchsorted(begin_s, time_s, side="right") - 1
        ahead, lag_s, angle, factor = (np.array(values)[hold] for values in zip(*holds, strict=True))
        elapsed_s = (time_s - begin_s[hold])[:, np.newaxis]
        lag = np.exp(-elapsed_s / lag_s)
        speed = steady[hold] + ahead * lag
        angle = angle + steady[hold] * elapsed_s + ahead * lag_s * (1 - lag)
        if self._wander is not None and turned is not None:
            angle = angle + steady[hold] * (self._wander.integral(time_s) - turned[hold])
            speed = speed * (1 + self._wander.at(time_s))
        thrust = factor * self._truth.thrust_ns2_per_rad2 * speed**2
        cos, sin = np.cos(angle), np.sin(angle)
        waves = (thrust, thrust * cos, thrust * sin, thrust * (cos**2 - sin**2), thrust * (2 * sin * cos))
        return np.asarray(np.hstack(waves) @ self._mixer + speed.sum(axis=1, keepdims=True) * self._drag)

    def _hold(
        self, command: Array, steady: Array, begin_s: float, end_s: float, turned: Array | None
    ) -> tuple[Array, Array | float, Array, Array]:
        """Hold a command; return how far ahead of it the rotors began, their lags, angles and thrust factors."""
        self._scatter(command, begin_s)
        ahead, angle = self._speed - steady, self._angle
        lag_s, held_s = self._truth.lag_s(ahead), end_s - begin_s
        lag = np.exp(-held_s / lag_s)
        self._speed = steady + ahead * lag
        wandered = 0.0 if turned is None else steady * (turned[1] - turned[0])
        self._angle = (angle + steady * held_s + ahead * lag_s * (1 - lag) + wandered) % (2 * math.pi)
        return ahead, np.full(4, lag_s), angle, self._factor.copy()

    def _scatter(self, command: Array, begin_s: float) -> None:
        """Draw a new thrust factor for rotors whose command changes after it was held."""
        if not self._truth.thrust_scatter or self._rng is None or not (changed := command != self._command).any():
            return
        if begin_s - self._since_s > _HELD_S:
            self._factor[changed] = 1 + self._truth.thrust_scatter * self._rng.standard_normal(int(changed.sum()))
        self._command, self._since_s = command.copy(), begin_s


def _into_the_cell(yaw_deg: float) -> Array:
    """Return the matrix that turns wrenches (n, 6), as row vectors, from the vehicle's frame into the cell's."""
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    turn = np.eye(6)
    for first in (0, 3):
        turn[first : first + 2, first : first + 2] = [[cos, -sin], [sin, cos]]
    return turn


def _mixer(truth: RotorTruth, rng: np.random.Generator) -> Array:
    """Return the wrench of a newton of each rotor (20, 6): steady, then cosine and sine of its angle and twice it."""
    x_m, y_m = truth.arm_m * (1 + truth.arm_error) * _ARMS.T
    steady = np.zeros((4, 6))
    steady[:, 2] = 1
    steady[:, 3] = y_m
    steady[:, 4] = -x_m
    steady[:, 5] = -truth.torque_m * _TURNS_LEFT  # the air holds a rotor back, and the rotor its motor
    waves = [steady]
    for amplitude in (np.outer(truth.unbalance_by_motor, truth.unbalance), np.array(truth.blade_pass)):
        size = amplitude * rng.uniform(0.8, 1.2, (4, 1))
        phase = rng.uniform(0, 2 * math.pi, (4, 6))
        waves += [size * np.cos(phase), -size * np.sin(phase)]
    return np.vstack(waves)
