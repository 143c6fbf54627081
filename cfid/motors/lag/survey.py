"""What a log holds of its rotors, seen before it is fitted: when it was driven, and which values are impossible."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from cfid.motors.lag.model import Signal
from cfid.records.logs.log import FlightLog
from cfid.records.logs.windows import windows

_BATTERY_V = (1.0, 60.0)
PART_S = 300.0  # a flight is one part, or two


class Counts(NamedTuple):
    """How many of a rotor's speeds are 0 while it is driven, no numbers, known, and there."""

    zero: int
    missing: int
    known: int
    rows: int


class Surveyed(NamedTuple):
    """When a log's commands begin and end, what its speeds are, and how many voltages are no numbers or impossible.

    The last number of `volts` is how many there are.
    """

    begin_s: float
    end_s: float
    speeds: Mapping[int, Counts]
    volts: tuple[int, int, int]


def survey(log: FlightLog, commands: Mapping[int, str], speeds: Mapping[int, str], volts: str | None) -> Surveyed:
    """Look through a log, part after part, for what its rotors' commands and speeds and its voltage are."""
    names = [*commands.values(), *speeds.values(), *(() if volts is None else (volts,))]
    begin_s = min(float(next(log.series_of(name).blocks())[0, 0]) for name in commands.values())
    end_s, voltages = begin_s, np.zeros(3, np.intp)
    counts = {motor: np.zeros(len(Counts._fields), np.intp) for motor in speeds}
    for found in windows(log, names, from_s=begin_s, long_s=PART_S):
        end_s = max([end_s, *(float(found[name].time_s[-1]) for name in commands.values() if len(found[name].time_s))])
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
    return Surveyed(begin_s, end_s, whole, (int(voltages[0]), int(voltages[1]), int(voltages[2])))


def possible(volts: Signal) -> Signal:
    """Return the voltages that a battery may have."""
    possible = (volts.value > _BATTERY_V[0]) & (volts.value < _BATTERY_V[1])
    return Signal(volts.time_s[possible], volts.value[possible])
