"""A flight log as commands that drove each rotor, and the speeds that show how fast rotors followed.

A long log is read part after part, so it may be larger than the memory.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.estimate.held_readings import Readings, once_each
from cfid.findings import Finding, finding, of_recording, rejection
from cfid.motors.lag.model import Signal
from cfid.motors.lag.part import BREAK_S, LogPart
from cfid.motors.lag.survey import part_s, possible, survey
from cfid.recordings.crazyflie import findings_in, first_of, is_flown, windows
from cfid.recordings.limits import COMMANDS, SPEEDS, Limits, refuse_repeated_times
from cfid.recordings.read import is_binary_log, read_recording
from cfid.recordings.recording import Column, Facts, Recording, Series
from cfid.recordings.stand import StandTable
from cfid.recordings.table import read_table
from cfid.units import MOTORS

Array = npt.NDArray[np.float64]

_COMMANDS = ("motor.m{}", "pwm.m{}_pwm", "pwm.m{}", "control.m{}")
_SPEEDS = ("rpm.m{}", "motor.m{}_rpm")
_VOLTS = ("pm.vbat", "pm.vbatMV")
_IMPOSSIBLE_SHARE = 0.1  # share of impossible ones among the voltages that are numbers, up to which the others are used
_ONE_RATE = rejection(
    "rotor-model-not-excited",
    "commands that are held this shortly show one rate each way, k1 + 2 k2 w at a mean speed w, not k1 and k2. Record "
    "steps that hold each command for a second, between low and high speeds. Time constants and delay hold for the "
    "speeds of this recording.",
    "dynamics.rising",
    "dynamics.falling",
)
_FEWEST_CHANGES, _HELD_S = 20, 0.25  # of a stand's command that never rests: fewest changes, longest mean interval


@dataclass(frozen=True, kw_only=True, eq=False)
class RotorLog:
    """A log with commands: the names of its channels, by motor, and the window of it to use.

    The window is in seconds since `begin_s`, the log's first row of a command. `limits` are those of each channel, by
    name, that has a few values outside them. These values are left out, as are the voltages at the times
    `wrong_volts_s` (k,) since `begin_s`.
    """

    log: Recording
    name: str
    commands: Mapping[int, str]
    speeds: Mapping[int, str]
    volts: str | None
    limits: Mapping[str, Limits]
    begin_s: float
    window: tuple[float, float]
    wrong_volts_s: Array
    findings: tuple[Finding, ...] = ()

    @property
    def path(self) -> Path:
        """The log's file."""
        return self.log.path

    def only(self, rotor: int) -> "RotorLog":
        """Return the log with one rotor's speed. Raises ConfigError where it has none."""
        if rotor not in self.speeds:
            rotors = f"rotor{'s' if len(self.speeds) > 1 else ''} {', '.join(map(str, self.speeds))}"
            there = f"speeds of {rotors} alone" if self.speeds else "no rotor speeds"
            raise ConfigError(f"{self.path}: `rotor` {rotor}: the log has {there}.")
        return replace(self, speeds={rotor: self.speeds[rotor]})

    def between(self, from_s: float | None, to_s: float | None) -> "RotorLog":
        """Return the log between two times since its first row. Raises ConfigError for an empty window."""
        low, high = (0.0 if from_s is None else from_s), (np.inf if to_s is None else to_s)
        if not low < min(high, self.window[1]):
            raise ConfigError(f"{self.path}: no rows between `from_s` {low:g} and `to_s` {high:g} s.")
        return replace(self, window=(low, min(high, self.window[1])))

    def parts(self) -> Iterator[LogPart]:
        """Yield the window, in parts of equal length where it is longer than 5 minutes, all with drives at one voltage.

        Raises DataError where nothing shows how the rotors follow.
        """
        if not self.speeds:
            raise DataError(
                f"{self.path}: no rotor speeds (rpm.m1, ...): use `cfid fit flight`, which takes the lag from the gyro "
                "and the accelerometer."
            )
        low, high = self.window
        names = [*self.commands.values(), *self.speeds.values(), *([] if self.volts is None else [self.volts])]
        count = ceil((high - low) / part_s(self.log, names))
        at_v = 0.0
        for part in windows(self.log, names, from_s=self.begin_s + low, long_s=(high - low) / count):
            signals = {name: self._since_begin(*self._within(name, *timed)) for name, timed in part.items()}
            signals = {name: one if name == self.volts else _numbers(one) for name, one in signals.items()}
            known = all(len(signals[name].time_s) > 1 for name in names)
            if known and (self.volts is None or len(self._volts(signals).time_s)):
                self._refuse_times(signals[next(iter(self.commands.values()))].time_s)
                found = self._part(signals)
                at_v = at_v or found.mean_v
                yield replace(found, at_v=at_v)

    def _refuse_times(self, time_s: Array) -> None:
        """Raise DataError where times (n,) of commands repeat, and where every interval between them is a break."""
        refuse_repeated_times(self.path, time_s)
        usual_s = float(np.median(np.diff(time_s)))
        if usual_s > 0.99 * BREAK_S:  # where rows are usually as far apart as a break, some are farther
            raise DataError(
                f"{self.path}: the commands were recorded every {usual_s:.2g} s, and not within {BREAK_S:g} s: too "
                "slow to show how the rotors follow. Record faster, or hold each command for some seconds."
            )

    def _since_begin(self, time_s: Array, value: Array) -> Signal:
        return Signal(time_s - self.begin_s, value).between(self.window[0], self.window[1])

    def _within(self, name: str, time_s: Array, value: Array) -> Signal:
        """Return a channel with nan for impossible values."""
        if name not in self.limits:
            return Signal(time_s, value)
        return Signal(time_s, np.where(self.limits[name].outside(value), np.nan, value))

    def _volts(self, signals: Mapping[str, Signal]) -> Signal:
        assert self.volts is not None
        return possible(signals[self.volts], self.wrong_volts_s)

    def _part(self, signals: Mapping[str, Signal]) -> LogPart:
        commands = {motor: signals[name] for motor, name in self.commands.items()}
        each = {motor: _once_each(signals[name]) for motor, name in self.speeds.items()}
        volts, volts_readings = (None, None) if self.volts is None else _once_each(self._volts(signals))
        return LogPart(
            commands=commands,
            speeds={motor: speed._replace(value=_known(speed.value)) for motor, (speed, _) in each.items()},
            readings={motor: readings for motor, (_, readings) in each.items()},
            volts=volts,
            volts_readings=volts_readings,
        )


def rotor_log(path: Path) -> RotorLog | None:
    """Read a vehicle's log; return None for a table without the firmware's commands. Raises DataError as its reader."""
    is_table = not is_binary_log(path)
    if is_table and not any(map(is_flown, read_table(path).heads)):
        return None  # a thrust stand's table need not have times
    log = read_recording(path)
    return None if is_table and not _of_motors(log, _COMMANDS) else of_log(log)


def of_stand(table: StandTable) -> RotorLog | None:
    """Return a thrust stand's speeds as a log of a command of every rotor that never rests.

    None if the command rests, and for a table without times or speeds.
    """
    time_s, speeds, known = table.time_s, table.speeds_rad_s, np.isfinite(table.command)
    if time_s is None or speeds is None or np.count_nonzero(np.diff(table.command[known])) < _FEWEST_CHANGES:
        return None
    if np.ptp(time_s) > _HELD_S * np.count_nonzero(np.diff(table.command[known])):
        return None
    several = table.speeds == "rotors"
    each = speeds.T if several else [table.square_mean_speed_rad_s]
    motors = range(1, 1 + len(each))
    columns = [Column(name=f"motor.m{motor}", unit="1", values=table.command[known]) for motor in motors]
    columns += [
        Column(name=f"rpm.m{motor}", unit="rad/s", values=np.asarray(speed)[known])
        for motor, speed in zip(motors, each, strict=True)
    ]
    if table.vbat_v is not None and np.isfinite(table.vbat_v).any():
        columns.append(Column(name="pm.vbat", unit="V", values=table.vbat_v[known]))
    rows = int(np.count_nonzero(known))
    series = Series(name="stand", path=table.path, columns=tuple(columns), rows=rows, time_s=time_s[known], begin_s=0.0)
    log = Recording(
        path=table.path,
        source=table.source,
        series={"stand": series},
        facts=Facts(program="table of a thrust stand"),
    )
    return replace(of_log(log), findings=(*table.findings, _ONE_RATE))


def of_log(log: Recording) -> RotorLog:
    """Find commands, speeds and voltage in a log. Raises DataError without commands."""
    commands = _of_motors(log, _COMMANDS)
    if not commands:
        raise DataError(
            f"{log.path}: no command of a motor (motor.m1, pwm.m1_pwm, PX4's actuator_motors; the pulse widths of its "
            "actuator_outputs are not read)."
        )
    speeds = {motor: name for motor, name in _of_motors(log, _SPEEDS).items() if motor in commands}
    volts = first_of(log, _VOLTS)
    limits = dict.fromkeys(commands.values(), COMMANDS) | dict.fromkeys(speeds.values(), SPEEDS)
    seen = survey(log, commands, speeds, volts, limits)
    limits = {name: limits[name] for name, (wrong, known, _) in seen.outside.items() if limits[name].few(wrong, known)}
    outside = [one.left_out(name, seen.outside[name].wrong, seen.outside[name].first) for name, one in limits.items()]
    faults: list[str] = []
    for motor, counts in seen.speeds.items():
        if counts.zero:
            faults.append(
                f"rotor {motor}: {counts.zero} of {counts.rows} speeds are 0 while it is driven, and left out."
            )
        if missing := counts.missing:
            faults.append(f"rotor {motor}: {missing} of {counts.rows} speeds are no numbers, and left out.")
    rows, missing, wrong = seen.volts.rows, seen.volts.missing, len(seen.volts.wrong_s)
    use_volts = wrong <= _IMPOSSIBLE_SHARE * (rows - missing) and missing < rows
    if missing or wrong:
        used = "these are left out" if use_volts else f"it is not used (limit {_IMPOSSIBLE_SHARE:.0%} impossible)"
        where = f"is no number in {missing} and impossible in {wrong} of {rows} rows"
        faults.append(f"the battery's voltage {where}: {used}{seen.volts.left_out()}.")
    return RotorLog(
        log=log,
        name=log.path.stem,
        commands=commands,
        speeds={motor: name for motor, name in speeds.items() if seen.speeds[motor].known},
        volts=volts if use_volts else None,
        limits=limits,
        begin_s=seen.begin_s,
        window=(0.0, np.nextafter(seen.end_s - seen.begin_s, np.inf)),
        wrong_volts_s=seen.volts.wrong_s - seen.begin_s,
        findings=(
            *findings_in(log),
            *(one.at(log.path.name) for one in outside),
            *of_recording(log.path.name, faults),
            *((finding("gyro-clock-undecided", "dynamics.*").at(log.path.name),) if _undecided(log) else ()),
        ),
    )


def _undecided(log: Recording) -> bool:
    return log.facts.clock == "unknown"


def _once_each(measured: Signal) -> tuple[Signal, Readings]:
    """Return a measured signal with each reading once, and how many rows show a reading."""
    counts, readings = once_each(*measured)
    return Signal(measured.time_s[counts], measured.value[counts]), readings


def _numbers(signal: Signal) -> Signal:
    """Return a signal without the rows that have no number, such as a log's rows for other channels."""
    known = np.isfinite(signal.value)
    return Signal(signal.time_s[known], signal.value[known])


def _known(speed: Array) -> Array:
    """Return speeds (n,) with nan in place of 0, which a sensor shows when it has lost its rotor."""
    return np.where(speed > 0, speed, np.nan)


def _of_motors(log: Recording, patterns: tuple[str, ...]) -> dict[int, str]:
    found = {motor: first_of(log, patterns, motor) for motor in MOTORS}
    return {motor: name for motor, name in found.items() if name is not None}
