"""Simulates motors, battery and rotors together: from commands to speeds, voltage and the wrench on the load cell.

The vehicle runs ahead: it changes commands up to now, while the load cell is read at earlier times.
"""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.sim.battery import Battery, BatteryTruth
from cfid.sim.rotors import RotorTruth, SimulatedRotors
from cfid.sim.stepping import Array

Four = tuple[int, int, int, int]
OnMotors = Callable[[float, Four], None]  # a time, and the commands from then on

STILL: Four = (0, 0, 0, 0)

_BATTERY_EVERY_S = 0.01  # the rotors' inertia smooths faster changes
_REMEMBERED = 1000  # changes of the commands while the load cell is not read


class _Change(NamedTuple):
    time_s: float
    command: Array
    volts: float


class Propulsion:
    """Four rotors that obey `commands` from `begin_s` on, until they get other commands."""

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
        self._rotors.advance(np.array([begin_s]), np.zeros(4))
        self._commands = commands
        self._speed = np.zeros(4)
        self._since_s = self._begin_s = begin_s
        self._steps = 0
        self._acting = _Change(begin_s, np.array(commands, dtype=np.float64), self.battery.volts)
        self._felt = self._acting  # by the load cell, up to its last reading
        self._changes: deque[_Change] = deque(maxlen=_REMEMBERED)

    def command(self, commands: Four, time_s: float) -> None:
        """Apply other commands from a time on, which is not before that of the last call."""
        self.advance(time_s)
        self._commands = commands
        self._go_on(time_s)

    def advance(self, time_s: float) -> None:
        """Advance the battery under the rotors' load, in steps of its own, however often this is called."""
        last = int((time_s - self._begin_s) / _BATTERY_EVERY_S)
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
        pieces = []
        begin = 0
        while self._changes and self._changes[0].time_s < time_s[-1]:
            change = self._changes.popleft()
            end = int(np.searchsorted(time_s, change.time_s))
            rows = self._advance(np.append(time_s[begin:end], change.time_s))
            pieces.append(rows[:-1])
            begin, self._felt = end, change
        pieces.append(self._advance(time_s[begin:]))
        return np.vstack(pieces)

    def _advance(self, time_s: Array) -> Array:
        return self._rotors.advance(time_s, self._felt.command, volts=self._felt.volts)

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
