"""A survey of a log before it is fitted: when its rotors were driven, and which values are impossible."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.large import joined
from cfid.motors.lag.model import Signal
from cfid.recordings import supply
from cfid.recordings.crazyflie import times_in, windows
from cfid.recordings.limits import Limits
from cfid.recordings.recording import Recording

Array = npt.NDArray[np.float64]

_PART_S, _PART_ROWS = 300.0, 330_000  # a flight is one part, or two
_HEAD_ROWS = 1 << 16  # that show how far rows are apart


def part_s(log: Recording, names: Sequence[str]) -> float:
    """Return how long the parts are in which some channels of a log are read: as many rows as fit into the memory."""
    heads = [times_in(log, log.holding(name))[:_HEAD_ROWS] for name in names]
    apart_s = [float(np.median(np.diff(time_s))) for time_s in heads if len(time_s) > 1]
    return min([_PART_S, *(_PART_ROWS * step_s for step_s in apart_s if step_s > 0)])


class Counts(NamedTuple):
    """How many of a rotor's speeds are 0 while it is driven, are not numbers, or are known, and how many there are."""

    zero: int
    missing: int
    known: int
    rows: int


class Outside(NamedTuple):
    """How many of a channel's values are impossible, how many are known, and the first impossible value."""

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


class Volts(NamedTuple):
    """How many voltages were logged and how many are not numbers, and the impossible ones with their times."""

    rows: int
    missing: int
    wrong_s: Array
    wrong_v: Array
    usual_v: float

    def left_out(self) -> str:
        """Return a clause on the impossible voltages, "" for none."""
        if not len(self.wrong_v):
            return ""
        others = "" if np.isnan(self.usual_v) else f", where the others are about {self.usual_v:.3g} V"
        return f" (the first {self.wrong_v[0]:.4g} V{others})"


class Surveyed(NamedTuple):
    """When a log's commands begin and end, and what its speeds and voltages are.

    `outside` is by the names of the channels that have limits.
    """

    begin_s: float
    end_s: float
    speeds: Mapping[int, Counts]
    volts: Volts
    outside: Mapping[str, Outside]


def survey(
    log: Recording,
    commands: Mapping[int, str],
    speeds: Mapping[int, str],
    volts: str | None,
    limits: Mapping[str, Limits],
) -> Surveyed:
    """Survey a log, part after part: the commands and speeds of its rotors, and its voltage.

    `limits` are those of commands, speeds and other channels, by name.
    """
    names = [*limits, *(() if volts is None else (volts,))]
    begin_s = min(float(times_in(log, log.holding(name))[0]) for name in commands.values())
    end_s = begin_s
    counts = {motor: np.zeros(len(Counts._fields), np.intp) for motor in speeds}
    outside = dict.fromkeys(limits, Outside())

    def voltages() -> Iterator[Array]:
        """Yield times and voltages (n, 2) of each part, and survey everything else on the way."""
        nonlocal end_s, outside
        for found in windows(log, names, from_s=begin_s, long_s=part_s(log, names)):
            ends = (float(found[name].time_s[-1]) for name in commands.values() if len(found[name].time_s))
            end_s = max([end_s, *ends])
            outside = {name: counts.and_of(found[name].value, limits[name]) for name, counts in outside.items()}
            for motor, name in speeds.items():
                (time_s, speed), (driven_s, driven) = found[name], found[commands[motor]]
                known = np.isfinite(driven)
                on = (
                    np.interp(time_s, driven_s[known], driven[known]) > 0 if known.any() else np.zeros(len(speed), bool)
                )
                zero, turns = np.sum((speed <= 0) & on), np.sum(speed > 0)
                counts[motor] += np.array([zero, np.sum(~np.isfinite(speed)), turns, len(speed)])
            yield np.zeros((0, 2)) if volts is None else np.column_stack(found[volts])

    voltage = _volts_of(joined(voltages()))
    return Surveyed(begin_s, end_s, {motor: Counts(*map(int, one)) for motor, one in counts.items()}, voltage, outside)


def possible(volts: Signal, wrong_s: Array) -> Signal:
    """Return the voltages that are numbers and are not at the times (k,) of wrong ones."""
    possible = np.isfinite(volts.value) & ~np.isin(volts.time_s, wrong_s)
    return Signal(volts.time_s[possible], volts.value[possible])


def _volts_of(timed: Array) -> Volts:
    """Return what times and voltages (n, 2) show."""
    time_s, volts = timed.T
    wrong = supply.impossible(volts)
    missing = int(np.count_nonzero(~np.isfinite(volts)))
    return Volts(len(volts), missing, time_s[wrong], volts[wrong], supply.usual(volts, wrong))
