"""A flight log as what drove each rotor, and what shows how fast they followed: their speeds, or the acceleration."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, note, of_recording
from cfid.motors.lag.estimation import SETTLING_S, LogSegment
from cfid.motors.lag.model import Signal
from cfid.records.logs.any_kind import NO_OPTIONS, is_binary_log, read_log
from cfid.records.logs.log import FlightLog
from cfid.records.parameters import Source
from cfid.records.tables.schema import Foreign
from cfid.units import FULL_COMMAND, MOTORS

Array = npt.NDArray[np.float64]

_COMMANDS = ("motor.m{}", "pwm.m{}_pwm", "pwm.m{}")
_SPEEDS = ("rpm.m{}", "motor.m{}_rpm")
_VOLTS, _ACCELERATION = ("pm.vbat", "pm.vbatMV"), "acc.z"
_BREAK_S = 0.1  # without a row, after which the rotors' state is unknown
_BATTERY_V = (1.0, 60.0)
_OWN_STEPS = 0.5  # of the rows in which a command differs from the one before: below, rows show its own steps


@dataclass(frozen=True, kw_only=True, eq=False)
class RotorLog:
    """Commands by motor, 0 to 65535, with speeds in rad/s by motor, volts, and acceleration along z in m/s^2.

    Each has its own times, in seconds since the log's first row. `understood` is one line on the file.
    """

    name: str
    path: Path
    commands: Mapping[int, Signal]
    speeds: Mapping[int, Signal]
    volts: Signal | None = None
    acceleration: Signal | None = None
    understood: str = ""
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()

    @property
    def unseen_s(self) -> float:
        """The interval between rows of the commands where these change in most rows, else 0: rows show their steps."""
        time_s, value = self.commands[min(self.commands)]
        on = (value[1:] > 0) & (value[:-1] > 0)
        return float(np.median(np.diff(time_s))) if np.mean(np.diff(value)[on] != 0) > _OWN_STEPS else 0.0

    def only(self, rotor: int) -> "RotorLog":
        """Return the log with one rotor's speed. Raises ConfigError where it has none."""
        if rotor not in self.speeds:
            there = f"speeds of rotors {', '.join(map(str, self.speeds))}" if self.speeds else "no rotor speeds"
            raise ConfigError(f"{self.path}: `rotor` {rotor}: the log has {there}.")
        return replace(self, speeds={rotor: self.speeds[rotor]})

    def between(self, from_s: float | None, to_s: float | None) -> "RotorLog":
        """Return the log between two times since its first row. Raises ConfigError for an empty window."""
        window = (0.0 if from_s is None else from_s), (np.inf if to_s is None else to_s)
        cut = {motor: signal.between(*window) for motor, signal in self.commands.items()}
        if not all(len(signal.time_s) for signal in cut.values()):
            raise ConfigError(f"{self.path}: no rows between `from_s` {window[0]:g} and `to_s` {window[1]:g} s.")
        return replace(self, commands=cut)

    def drive(self, motor: int) -> Signal:
        """Return the command over the full one, times the battery's volts where these are known."""
        time_s, command = self.commands[motor]
        volts = 1.0 if self.volts is None else np.interp(time_s, *self.volts)
        return Signal(time_s, command / FULL_COMMAND * volts)

    def of_speed(self, motor: int) -> list[LogSegment]:
        """Return the parts in which one rotor runs, with its speed."""
        return list(self._pieces((motor,), self.speeds[motor]))

    def of_thrust(self) -> list[LogSegment]:
        """Return the parts in which all rotors run, with the acceleration, which is their thrust over the mass."""
        if self.acceleration is None:
            raise DataError(f"{self.path}: no rotor speeds (rpm.m1, ...) and no acc.z: nothing follows the commands.")
        missing = ", ".join(f"motor.m{motor}" for motor in MOTORS if motor not in self.commands)
        if missing:
            raise DataError(f"{self.path}: no {missing}: the thrust in acc.z is that of all four.")
        return list(self._pieces(MOTORS, self.acceleration))

    def _pieces(self, motors: tuple[int, ...], measured: Signal) -> Iterator[LogSegment]:
        """Yield the parts without a break that are long enough to be used."""
        time_s = self.commands[motors[0]].time_s
        runs = np.all([self.commands[motor].value > 0 for motor in motors], axis=0)
        ends = ~runs[:-1] | ~runs[1:] | (np.diff(time_s) > _BREAK_S)
        edges = np.concatenate([[0], np.flatnonzero(ends) + 1, [len(time_s)]])
        for first, last in zip(edges[:-1], edges[1:] - 1, strict=True):
            from_s, to_s = float(time_s[first]), float(time_s[last])
            if to_s - from_s > 2 * SETTLING_S:
                inside = slice(first, last + 1)
                drives = tuple(Signal(time_s[inside], self.drive(motor).value[inside]) for motor in motors)
                yield LogSegment(drives, measured.between(from_s, to_s))


def rotor_log(path: Path, reading: Foreign = NO_OPTIONS) -> RotorLog | None:
    """Read a log of a vehicle, None for a table without the firmware's commands. Raises DataError as its reader."""
    try:
        log = read_log(path, reading)
    except DataError:
        if path.is_file() and not is_binary_log(path):
            return None  # a thrust stand's table need not have times
        raise
    return of_log(log) if is_binary_log(path) or _of_any(log, _COMMANDS) else None


def of_log(log: FlightLog) -> RotorLog:
    """Take commands, speeds, voltage and acceleration from a log. Raises DataError without commands."""
    commands = _of_motors(log, _COMMANDS)
    if not commands:
        raise DataError(f"{log.path}: no command of a motor (motor.m1, pwm.m1_pwm).")
    begin_s = min(signal.time_s[0] for signal in commands.values())
    speeds, faults = {}, []
    for motor, (time_s, speed) in _of_motors(log, _SPEEDS).items():
        if motor not in commands:
            continue
        lost = (speed <= 0) & (np.interp(time_s, *commands[motor]) > 0)
        if lost.any():
            faults.append(f"rotor {motor}: {lost.sum()} of {len(speed)} speeds are 0 while it is driven, and left out.")
        if np.any(speed > 0):
            speeds[motor] = Signal(time_s, np.where(speed > 0, speed, np.nan))
    volts = _one(log, _VOLTS)
    if volts is not None and not np.all((volts.value > _BATTERY_V[0]) & (volts.value < _BATTERY_V[1])):
        faults.append("the battery's voltage has impossible values: it is not used.")
        volts = None
    acceleration = _one(log, (_ACCELERATION,))
    return RotorLog(
        name=log.path.stem,
        path=log.path,
        commands=_since(commands, begin_s),
        speeds=_since(speeds, begin_s),
        volts=None if volts is None else Signal(volts.time_s - begin_s, volts.value),
        acceleration=None if acceleration is None else Signal(acceleration.time_s - begin_s, acceleration.value),
        understood=log.understood,
        findings=(
            *of_recording(log.path.name, (*log.notes, *faults)),
            *(note("recording", f"assumed: {text}.").at(log.path.name) for text in log.assumed),
        ),
        sources=(log.source,),
    )


def _of_any(log: FlightLog, patterns: tuple[str, ...]) -> bool:
    return any(_first(log, patterns, motor) for motor in MOTORS)


def _first(log: FlightLog, patterns: tuple[str, ...], motor: int = 0) -> str | None:
    there = {name for series in log.series for name in series.names}
    return next((name for pattern in patterns if (name := pattern.format(motor)) in there), None)


def _one(log: FlightLog, names: tuple[str, ...]) -> Signal | None:
    name = _first(log, names)
    return None if name is None else Signal(*log.channel(name))


def _of_motors(log: FlightLog, patterns: tuple[str, ...]) -> dict[int, Signal]:
    found = {motor: _first(log, patterns, motor) for motor in MOTORS}
    return {motor: Signal(*log.channel(name)) for motor, name in found.items() if name is not None}


def _since(signals: Mapping[int, Signal], begin_s: float) -> dict[int, Signal]:
    return {motor: Signal(time_s - begin_s, value) for motor, (time_s, value) in signals.items()}
