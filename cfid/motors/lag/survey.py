"""What a log holds of its rotors, seen before it is fitted: when it was driven, and which values are impossible."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.motors.lag.model import Signal
from cfid.records.logs.limits import Limits
from cfid.records.logs.log import FlightLog
from cfid.records.logs.windows import windows

Array = npt.NDArray[np.float64]

_BATTERY_V = (1.0, 60.0)
PART_S = 300.0  # a flight is one part, or two


class Counts(NamedTuple):
    """How many of a rotor's speeds are 0 while it is driven, no numbers, known, and there."""

    zero: int
    missing: int
    known: int
    rows: int


class Outside(NamedTuple):
    """How many of a channel's values cannot be, how many are known, and the first of the former."""

    wrong: int = 0
    known: int = 0
    first: float = 0.0

    def and_of(self, values: Array, limits: Limits) -> "Outside":
        """Return these counts with those of more values (n,)."""
        outside = limits.outside(values)
        first = float(values[np.argmax(outside)]) if not self.wrong and outside.any() else self.first
        return Outside(
            self.wrong + int(np.count_nonzero(outside)), self.known + int(np.count_nonzero(np.isfinite(values))), first
        )


class Surveyed(NamedTuple):
    """When a log's commands begin and end, what its speeds are, and how many voltages are no numbers or impossible.

    The last number of `volts` is how many there are. `outside` is by the name of a channel that has limits.
    """

    begin_s: float
    end_s: float
    speeds: Mapping[int, Counts]
    volts: tuple[int, int, int]
    outside: Mapping[str, Outside]


def survey(
    log: FlightLog,
    commands: Mapping[int, str],
    speeds: Mapping[int, str],
    volts: str | None,
    limits: Mapping[str, Limits],
) -> Surveyed:
    """Look through a log, part after part, for what its rotors' commands and speeds and its voltage are.

    `limits` are of commands, speeds and other channels, by name.
    """
    names = [*limits, *(() if volts is None else (volts,))]
    begin_s = min(float(next(log.series_of(name).blocks())[0, 0]) for name in commands.values())
    end_s, voltages = begin_s, np.zeros(3, np.intp)
    counts = {motor: np.zeros(len(Counts._fields), np.intp) for motor in speeds}
    outside = dict.fromkeys(limits, Outside())
    for found in windows(log, names, from_s=begin_s, long_s=PART_S):
        end_s = max([end_s, *(float(found[name].time_s[-1]) for name in commands.values() if len(found[name].time_s))])
        outside = {name: counts.and_of(found[name].value, limits[name]) for name, counts in outside.items()}
        for motor, name in speeds.items():
            (time_s, speed), driven = found[name], found[commands[motor]]
            on = np.interp(time_s, *driven) > 0 if len(driven.time_s) else np.zeros(len(speed), bool)
            zero, known = np.sum((speed <= 0) & on), np.sum(speed > 0)
            counts[motor] += np.array([zero, np.sum(~np.isfinite(speed)), known, len(speed)])
        if volts is not None:
            voltage = found[volts].value
            missing, kept = np.sum(~np.isfinite(voltage)), len(possible(Signal(*found[volts])).value)
            voltages += np.array([missing, len(voltage) - missing - kept, len(voltage)])
    whole = {motor: Counts(*map(int, count)) for motor, count in counts.items()}
    return Surveyed(begin_s, end_s, whole, (int(voltages[0]), int(voltages[1]), int(voltages[2])), outside)


def possible(volts: Signal) -> Signal:
    """Return the voltages that a battery may have."""
    possible = (volts.value > _BATTERY_V[0]) & (volts.value < _BATTERY_V[1])
    return Signal(volts.time_s[possible], volts.value[possible])
