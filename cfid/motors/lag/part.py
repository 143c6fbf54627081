"""A part of a log: what drove each rotor, and the segments without a break in which it ran."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.held_readings import Readings
from cfid.motors.lag.gaps import gaps
from cfid.motors.lag.model import LogSegment, Signal
from cfid.motors.lag.search import SETTLING_S
from cfid.motors.lag.voltage import volts_at
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]

BREAK_S = 0.1  # without a row, after which the rotors' state is unknown
_OWN_STEPS = 0.5  # share of rows in which a command differs from the row before: below, rows show its own steps
_UNSEEN, _UNSEEN_S = 5, 0.25  # usual intervals, and seconds, up to which a voltage is taken from its neighbour


@dataclass(frozen=True, kw_only=True, eq=False)
class LogPart:
    """Commands by motor, 0 to 65535, with speeds in rad/s by motor, and volts.

    Each has its own times, in seconds since the log's first row of a command. Drives are for the voltage `at_v`, 1
    where no voltage was logged. `readings` are those of the speeds, by motor; each counts once.
    """

    commands: Mapping[int, Signal]
    speeds: Mapping[int, Signal]
    readings: Mapping[int, Readings]
    volts: Signal | None = None
    volts_readings: Readings | None = None
    at_v: float = 1.0

    @property
    def row_s(self) -> float:
        """The interval between rows of the commands, 0 for fewer than two rows."""
        time_s, _ = self.commands[min(self.commands)]
        return float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0

    def moving(self, motor: int) -> bool:
        """Whether a motor's command changes in most rows, which then do not show its steps."""
        return moves(self.commands[motor].value)

    def of_speed(self, motor: int, *, by: int | None = None) -> list[LogSegment]:
        """Return the segments in which one rotor runs, with its speed; `by` is the motor whose command drives it."""
        return list(self._segments(by or motor, self.speeds[motor]))

    def driven_volts(self, motor: int) -> Array:
        """Return the battery's volts (n,) at the commands that drive a motor, none where they are unknown."""
        time_s, command = self.commands[motor]
        return np.zeros(0) if self.volts is None else np.interp(time_s[command > 0], *self.volts)

    @property
    def mean_v(self) -> float:
        """The battery's mean voltage at the commands that drive motors, 1 where it was not logged."""
        driven_v = np.concatenate([self.driven_volts(motor) for motor in self.commands])
        return float(np.mean(driven_v)) if len(driven_v) else 1.0

    def _segments(self, motor: int, measured: Signal) -> Iterator[LogSegment]:
        """Yield the segments without a break that are long enough to be used."""
        time_s, command = self.commands[motor]
        runs = command > 0
        runs &= self.volts is None or _is_known(self.volts.time_s, time_s)
        ends = ~runs[:-1] | ~runs[1:] | (np.diff(time_s) > BREAK_S)
        unseen = np.flatnonzero(gaps(time_s) & (np.diff(command) != 0))
        edges = np.concatenate([[0], np.flatnonzero(ends) + 1, [len(time_s)]])
        drive = command / FULL_COMMAND * self.at_v
        volts = None if self.volts is None else volts_at(self.volts, self.speeds.values(), time_s)
        for first, last in zip(edges[:-1], edges[1:] - 1, strict=True):
            if last < first or time_s[last] - time_s[first] <= 2 * SETTLING_S:
                continue
            inside = slice(first, last + 1)
            between = measured.between(float(time_s[first]), float(time_s[last]))
            ratio = None if volts is None else Signal(time_s[inside], volts[inside] / self.at_v)
            own = unseen[(unseen >= first) & (unseen < last)]
            yield LogSegment(
                Signal(time_s[inside], drive[inside]), between, ratio, np.column_stack([time_s[own], time_s[own + 1]])
            )


def moves(command: Array) -> bool:
    """Return whether a command (n,) changes in most rows in which it drives a motor."""
    on = (command[1:] > 0) & (command[:-1] > 0)
    changed = np.diff(command)[on] != 0
    return bool(len(changed) and np.mean(changed) > _OWN_STEPS)


def _is_known(read_s: Array, time_s: Array) -> npt.NDArray[np.bool_]:
    """Return at which times (n,) a reading (m,) is near enough to give a value, where other readings were left out."""
    usual_s = float(np.median(np.diff(read_s))) if len(read_s) > 1 else np.inf
    behind = np.searchsorted(read_s, time_s).clip(1, max(len(read_s) - 1, 1))
    ahead_s, behind_s = read_s[behind - 1], read_s[np.minimum(behind, len(read_s) - 1)]
    nearest_s = np.minimum(np.abs(time_s - ahead_s), np.abs(time_s - behind_s))
    return np.asarray(nearest_s <= max(_UNSEEN * usual_s, _UNSEEN_S))
