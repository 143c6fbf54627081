"""Simulates motors, battery, rotors and wind: from commands to speeds, voltage and the wrench on the load cell.

Speed is a first-order lag, which thrust and torque follow without delay; the motion of the air is not modelled.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Annotated, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from cfid.records.rig_file import Number, Positive, RigTable, Spread, Vector
from cfid.sim.stepping import Array
from cfid.sim.wander import Wander
from cfid.wire.app import LARGEST_COMMAND

Four = tuple[int, int, int, int]
OnMotors = Callable[[float, Four], None]  # a time, and the commands from then on
FourNumbers = tuple[Number, Number, Number, Number]
SixNumbers = tuple[Number, Number, Number, Number, Number, Number]

STILL: Four = (0, 0, 0, 0)
WANDER_S = 0.1
NOMINAL_V = 3.7  # of a lithium cell that is half empty

# Crazyflie 2.0, motor 1 to 4, x forward and y left: front right, back right, back left, front left.
_ARMS = np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]]) / math.sqrt(2)
_TURNS_LEFT = np.array([1, -1, 1, -1])  # seen from above
_STANDSTILL_RAD_PER_S = 1e-3
_HELD_S = 0.3  # longer than a sine holds a command, shorter than a staircase does
_SECONDS_AN_HOUR = 3600
_BATTERY_EVERY_S = 0.01  # the rotors' inertia smooths faster changes
_REMEMBERED = 1000  # changes of the commands while the load cell is not read


class BatteryTruth(RigTable):
    """A `supply` holds `volts` under any load; the other keys apply to `lipo` only.

    `open_circuit_v` is the voltage of the unloaded cell at equal steps of charge, from empty to full; `charge` is the
    initial charge. The fraction `efficiency` of the electrical power reaches the rotors; `standby_a` is drawn in
    addition. The currents are near those in Bitcraze's table of the Crazyflie 2.0 (2015).
    """

    kind: Literal["supply", "lipo"] = "supply"
    volts: Positive = NOMINAL_V
    capacity_mah: Positive = 240.0
    charge: Annotated[Number, Field(ge=0, le=1)] = 1.0
    open_circuit_v: Annotated[tuple[Positive, ...], Field(min_length=2)] = (
        3.0, 3.45, 3.6, 3.68, 3.73, 3.77, 3.82, 3.89, 3.97, 4.07, 4.2,
    )  # fmt: skip
    resistance_ohm: Spread = 0.15
    standby_a: Spread = 0.24
    efficiency: Annotated[Number, Field(gt=0, le=1)] = 0.5


class Battery:
    """A supply or a cell; its voltage stays that of the last load until the next."""

    def __init__(self, truth: BatteryTruth) -> None:
        """Begin without a load."""
        self.charge = truth.charge
        self.at_most_v = math.inf  # a worn cell holds no more
        self._truth = truth
        self._steps = np.linspace(0, 1, len(truth.open_circuit_v))
        self._volts = truth.volts
        self.load(power_w=0.0, for_s=0.0)

    @property
    def is_supply(self) -> bool:
        """Whether no load changes its voltage."""
        return self._truth.kind == "supply"

    @property
    def volts(self) -> float:
        """The voltage under the present load."""
        return min(self._volts, self.at_most_v)

    def load(self, *, power_w: float, for_s: float) -> None:
        """Supply the rotors with `power_w` of mechanical power, drawn for the last `for_s` seconds.

        A cell that cannot supply it sags to half its voltage, where its power is largest.
        """
        truth = self._truth
        if truth.kind == "supply":
            return
        unloaded_v = float(np.interp(self.charge, self._steps, truth.open_circuit_v))
        unloaded_v -= truth.resistance_ohm * truth.standby_a
        drawn_w = power_w / truth.efficiency
        self._volts = (unloaded_v + math.sqrt(max(unloaded_v**2 - 4 * truth.resistance_ohm * drawn_w, 0.0))) / 2
        current_a = truth.standby_a + drawn_w / self._volts
        self.charge -= current_a * for_s / (truth.capacity_mah / 1000 * _SECONDS_AN_HOUR)
        self.charge = max(self.charge, 0.0)


class WindTruth(RigTable):
    """A steady wind of `speed_mps` from a fan at `angle_deg` to the vertical and `azimuth_deg` about it.

    Rotors feel `kg_per_rad`, for the body's x, y and z, times their speeds' sum times the velocity relative to the air
    (thesis eq. 4.2, its coefficients of eq. 4.8), the body `body_kg_per_m` times that velocity times its magnitude. The
    load cell's x axis lies `yaw_deg` left of the vehicle's. The anemometer reads too much by `anemometer_gain`.
    """

    speed_mps: Spread = 0.0
    angle_deg: Number = 0.0
    azimuth_deg: Number = 28.46
    yaw_deg: Number = 45.0
    kg_per_rad: Vector = (-9.1785e-7, -9.1785e-7, -10.311e-7)
    body_kg_per_m: Number = -3e-4
    anemometer_gain: Number = 0.0

    @property
    def drag_ns_per_rad(self) -> Array:
        """The force (3,) per rad/s of the rotors, in the load cell's frame."""
        return np.array(self.kg_per_rad) * self._velocity_mps @ _into_the_cell(self.yaw_deg)

    @property
    def body_n(self) -> Array:
        """The force on the body (3,), in the load cell's frame, independent of the rotors."""
        return self.body_kg_per_m * self.speed_mps * self._velocity_mps @ _into_the_cell(self.yaw_deg)

    @property
    def _velocity_mps(self) -> Array:
        """The vehicle's velocity relative to the air (3,), in its own frame."""
        angle, azimuth = math.radians(self.angle_deg), math.radians(self.azimuth_deg)
        across, up = math.sin(angle), math.cos(angle)
        towards = np.array([across * math.cos(azimuth), -across * math.sin(azimuth), up])
        return np.asarray(self.speed_mps * towards)


def _into_the_cell(yaw_deg: float) -> Array:
    """Return the matrix that turns row vectors (n, 3) from the vehicle's frame into the cell's."""
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


class RotorTruth(RigTable):
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
    unbalance: SixNumbers = Field(default=(0.6, 0.6, 0.3, 0.006, 0.006, 0.002))
    unbalance_by_motor: FourNumbers = Field(default=(1.0, 1.0, 1.0, 1.0))
    blade_pass: SixNumbers = Field(default=(0.2, 0.2, 1.2, 0.004, 0.004, 0.003))

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
        turn = _into_the_cell(yaw_deg)
        mixer = _mixer(truth, rng)
        self._mixer = np.hstack((mixer[:, :3] @ turn, mixer[:, 3:] @ turn))
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

    def play(self, time_s: Array, begin_s: Array, commands: Array, *, volts: Array | float | None = None) -> Array:
        """Return the wrench (n, 6) of commands (m, 4), each of which holds from its beginning (m,) to the next one's.

        The first command begins at the last time of the previous call, and none begins after the last of these times.
        The supply voltage is nominal by default, the same for all commands, or one for each of them (m, 1).
        """
        self._last_s = float(time_s[-1])
        steady = self._truth.steady_rad_per_s(commands, volts=self._truth.nominal_v if volts is None else volts)
        if not steady.any() and self._speed.max() < _STANDSTILL_RAD_PER_S:
            self._speed[:] = 0
            return np.zeros((len(time_s), 6))
        bounds_s = np.append(begin_s, self._last_s)
        turned = None if self._wander is None else self._wander.integral(bounds_s)
        held_s = np.diff(bounds_s)[:, np.newaxis]
        ahead, lag_s, factors = self._hold(commands, steady, begin_s, held_s)
        passed = steady * held_s + ahead * lag_s * (1 - np.exp(-held_s / lag_s))
        if turned is not None:
            passed = passed + steady * np.diff(turned, axis=0)
        angles = self._angle + np.vstack((np.zeros(4), np.cumsum(passed, axis=0)))
        self._angle = angles[-1] % (2 * math.pi)
        hold = np.searchsorted(begin_s, time_s, side="right") - 1
        ahead, lag_s, angle, factor = ahead[hold], lag_s[hold], angles[hold], factors[hold]
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

    def _hold(self, commands: Array, steady: Array, begin_s: Array, held_s: Array) -> tuple[Array, Array, Array]:
        """Hold commands (m, 4) in turn; return how far ahead of them the rotors began, their lags and thrust factors.

        A loop over the commands alone costs little, also where a sine changes them 500 times a second.
        """
        ahead, lag_s, factors = np.empty_like(steady), np.empty_like(steady), np.empty_like(steady)
        for i in range(len(steady)):
            self._scatter(commands[i], float(begin_s[i]))
            ahead[i] = self._speed - steady[i]
            lag_s[i], factors[i] = self._truth.lag_s(ahead[i]), self._factor
            self._speed = steady[i] + ahead[i] * np.exp(-held_s[i] / lag_s[i])
        return ahead, lag_s, factors

    def _scatter(self, command: Array, begin_s: float) -> None:
        """Draw a new thrust factor for rotors whose command changes after it was held."""
        if not self._truth.thrust_scatter or self._rng is None or not (changed := command != self._command).any():
            return
        if begin_s - self._since_s > _HELD_S:
            self._factor[changed] = 1 + self._truth.thrust_scatter * self._rng.standard_normal(int(changed.sum()))
        self._command, self._since_s = command.copy(), begin_s


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


class _Change(NamedTuple):
    time_s: float
    command: Array
    volts: float


class Propulsion:
    """Four rotors and their battery, which obey `commands` from `begin_s` on, until they get other commands.

    The vehicle runs ahead: it changes commands up to now, while the load cell is read at earlier times.
    """

    def __init__(
        self,
        rotors: RotorTruth,
        battery: BatteryTruth,
        *,
        rng: np.random.Generator,
        begin_s: float,
        commands: Four = STILL,
        drag_ns_per_rad: npt.ArrayLike = (0.0, 0.0, 0.0),
        yaw_deg: float = 0.0,
    ) -> None:
        """Start with all rotors at standstill."""
        self.battery = Battery(battery)
        self._truth = rotors
        self._rotors = SimulatedRotors(rotors, rng, drag_ns_per_rad=drag_ns_per_rad, yaw_deg=yaw_deg)
        self._commands = commands
        self._speed = np.zeros(4)
        self._since_s = self._begin_s = begin_s
        self._steps = 0
        self._acting = _Change(begin_s, np.array(commands, dtype=np.float64), self.battery.volts)
        self._felt = self._acting  # by the load cell, at its last reading
        self._read_s = begin_s
        self._changes: deque[_Change] = deque(maxlen=_REMEMBERED)

    def command(self, commands: Four, time_s: float) -> None:
        """Apply other commands from a time on, which is not before that of the last call."""
        self.advance(time_s)
        self._commands = commands
        self._go_on(time_s)

    def advance(self, time_s: float) -> None:
        """Advance the battery under the rotors' load, in steps of its own, however often this is called."""
        last = int((time_s - self._begin_s) / _BATTERY_EVERY_S)
        if self.battery.is_supply and self.battery.volts == self._acting.volts:
            self._steps = last
            return
        driven = any(self._commands)
        for step in range(self._steps + 1 if driven else max(self._steps + 1, last), last + 1):
            self._go_on(self._begin_s + step * _BATTERY_EVERY_S)
            self._steps = step

    def speed_rad_per_s(self, time_s: float) -> Array:
        """Return the rotors' speeds (4,) at a time; before the last change, those at that change."""
        steady = self._truth.steady_rad_per_s(self._acting.command, volts=self._acting.volts)
        ahead = self._speed - steady
        return np.asarray(steady + ahead * np.exp(-max(time_s - self._since_s, 0.0) / self._truth.lag_s(ahead)))

    def wrench_at(self, time_s: Array) -> Array:
        """Return the wrench (n, 6) in N and Nm at times (n,) that do not decrease, none after the last `advance`."""
        holds = [self._felt._replace(time_s=self._read_s)]
        while self._changes and self._changes[0].time_s < time_s[-1]:
            self._felt = self._changes.popleft()
            holds.append(self._felt)
        self._read_s = float(time_s[-1])
        begin_s, commands, volts = zip(*holds, strict=True)
        return self._rotors.play(time_s, np.array(begin_s), np.array(commands), volts=np.array(volts)[:, np.newaxis])

    def _go_on(self, time_s: float) -> None:
        """Load the battery with the power of the driven rotors, and continue with the resulting voltage."""
        self._speed = self.speed_rad_per_s(time_s)
        power_w = float(self._truth.power_w(self._speed) @ (self._acting.command > 0))
        self.battery.load(power_w=power_w, for_s=time_s - self._since_s)
        self._since_s = time_s
        acting = _Change(time_s, np.array(self._commands, dtype=np.float64), self.battery.volts)
        if acting.volts != self._acting.volts or (acting.command != self._acting.command).any():
            self._acting = acting
            self._changes.append(acting)
