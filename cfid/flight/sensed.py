"""Read a flight's commands, rates and specific forces between two times from a log, with each reading once."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.estimate.held_readings import Readings
from cfid.findings import Finding
from cfid.flight.airborne import EDGE_S
from cfid.flight.channels import command_names, commands_of, forces_of, rates_of
from cfid.flight.repeated import ACCELEROMETER, GYRO, commands_apart_s, first_rows
from cfid.flight.rows import ROW_S, ROW_STEPS, STEP_S
from cfid.recordings.crazyflie import between, channel
from cfid.recordings.limits import COMMANDS, FORCES, RATES, Limits, refuse_repeated_times, without_hung
from cfid.recordings.recording import Recording

Array = npt.NDArray[np.float64]
Timed = tuple[Array, Array]

SLOWEST_S = 0.021  # the largest time between rows of a sensor: with more, changes of the rates are missed
_OTHER_UNIT_S = 0.5  # between rows, 1000 times the longest that autopilots log
_AVERAGED_S = ROW_S / 2  # between rows of a sensor: if they are closer, they are averaged
_MOST_S = 600.0
_AROUND_S = 5.0  # of rows that are kept before and after, for channels that are logged rarely


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensed:
    """Times (k,) and values of four motors' commands (k,), rates (k, 3) and specific forces (k, 3), readings once each.

    All have rows from `begin_s` to `end_s`; `first_s` is the time of the log's first command. `log` also contains the
    rows before and after, for its other channels. `low_pass_hz` are the filters of forces and rates, and `findings`
    state which rows were left out.
    """

    log: Recording
    commands: tuple[Timed, ...]
    rates: Timed
    forces: Timed
    low_pass_hz: tuple[float | None, float | None]
    readings: Mapping[str, Readings]
    first_s: float
    begin_s: float
    end_s: float
    findings: tuple[Finding, ...]

    @property
    def times_s(self) -> tuple[Array, ...]:
        """The times of each channel's rows."""
        return tuple(one[0] for one in (*self.commands, self.rates, self.forces))

    @property
    def row_s(self) -> Array:
        """The times of a flight's rows."""
        return np.asarray(self.begin_s + ROW_S * np.arange(self._rows), dtype=np.float64)

    @property
    def step_s(self) -> Array:
        """The times of a flight's drives."""
        return np.asarray(self.begin_s + STEP_S * np.arange(self._rows * ROW_STEPS), dtype=np.float64)

    @property
    def averaged(self) -> bool:
        """Whether a flight's rows are means of several readings."""
        return _apart_s(self.rates[0]) < _AVERAGED_S

    @property
    def apart_s(self) -> tuple[float, float, float]:
        """The usual times between commands, between readings of the gyro and between readings of the accelerometer."""
        return (
            commands_apart_s(*self.commands[0], self.readings),
            _apart_s(self.rates[0]),
            _apart_s(self.forces[0]),
        )

    @property
    def _rows(self) -> int:
        return int((self.end_s - self.begin_s) / ROW_S)


def sensed_in(log: Recording, from_s: float, to_s: float) -> Sensed:
    """Return what a log's instruments show between two times since its first row of a command.

    Raises DataError for a log that lacks commands of all motors, rates or accelerations, or is sampled too slowly, and
    ConfigError where too much or too little lies between these times.
    """
    first = channel(log, command_names(log)[0])[0]
    refuse_repeated_times(log.path, first)
    _check_spacing(first, log)
    from_s, to_s = _window(first, log.path, from_s, to_s)
    log = between(log, from_s - _AROUND_S, to_s + _AROUND_S)
    spoilt: list[Finding] = []
    commands = tuple(
        _possible(*_numbers(*one, name, log.path), COMMANDS, name, spoilt)
        for name, one in zip(command_names(log), commands_of(log), strict=True)
    )
    rates, rates_hz = rates_of(log)
    rates = _possible(*rates, RATES, GYRO, spoilt)
    forces, forces_hz = forces_of(log)
    forces = _possible(*forces, FORCES, ACCELEROMETER, spoilt)
    (rates, forces), hung = without_hung({GYRO: rates, ACCELEROMETER: forces})
    timed = [one[0] for one in (*commands, rates, forces)]
    begin, end = max(from_s, *(float(one[0]) for one in timed)), min(to_s, *(float(one[-1]) for one in timed))
    _check_left(end - begin, log.path)
    for one in timed:
        _check_spacing(one, log)
    (rates, forces), readings = first_rows({GYRO: rates, ACCELEROMETER: forces})
    for time_s in (rates[0], forces[0]):
        _check_spacing(time_s, log, "readings")
    return Sensed(
        log=log,
        commands=commands,
        rates=rates,
        forces=forces,
        low_pass_hz=(forces_hz, rates_hz),
        readings=readings,
        first_s=float(first[0]),
        begin_s=begin,
        end_s=end,
        findings=(*spoilt, *hung),
    )


def _numbers(time_s: Array, values: Array, what: str, path: Path) -> tuple[Array, Array]:
    """Return the rows of times (n,) and values (n,) that contain a number. Raises DataError if there are none.

    A missing number is not replaced by the one before: what the motor did without a command is unknown, so the row is
    treated as missing.
    """
    known = np.isfinite(values)
    if not known.any():
        raise DataError(f"{path}: '{what}' has no number: a flight's thrust is that of all four motors.")
    return time_s[known], values[known]


def _possible(time_s: Array, values: Array, limits: Limits, what: str, findings: list[Finding]) -> tuple[Array, Array]:
    """Return times (n,) and values (n,) or (n, 3) without a few impossible rows, which are then in `findings`."""
    outside = limits.outside(values)
    rows, known = (np.atleast_2d(mask.T) for mask in (outside, np.isfinite(values)))
    wrong, count = rows.any(axis=0), int(np.count_nonzero(rows.any(axis=0)))
    if not limits.few(count, int(np.count_nonzero(known.all(axis=0)))):
        return time_s, values
    findings.append(limits.left_out(what, count, float(values[outside][0])))
    return time_s[~wrong], values[~wrong]


def _apart_s(time_s: Array) -> float:
    """Return the usual time between rows at times (n,)."""
    return float(np.median(np.diff(time_s)))


def _check_spacing(time_s: Array, log: Recording, what: str = "rows") -> None:
    """Raise DataError for rows, or `what` they show, at times (n,) too far apart to follow rates."""
    if len(time_s) < 2 or (apart_s := _apart_s(time_s)) <= SLOWEST_S:
        return
    other = " If times are in a smaller unit, import the table with `unit`." if apart_s >= _OTHER_UNIT_S else ""
    raise DataError(
        f"{log.path}: {what} {1e3 * apart_s:.0f} ms apart (limit {1e3 * SLOWEST_S:.0f} ms): log motors, gyro and "
        f"accelerometer every 10 ms at least (PX4: the high rate of SDLOG_PROFILE).{other}"
    )


def _window(time_s: Array, path: Path, from_s: float, to_s: float) -> tuple[float, float]:
    """Return the first and last time of the rows (n,) to fit. Raises ConfigError for too long or too short a window."""
    begin, end = float(time_s[0]) + from_s, float(min(time_s[-1], time_s[0] + to_s))
    _check_left(end - begin, path)
    if end - begin > _MOST_S:
        gone = np.diff(time_s[(time_s >= begin) & (time_s <= end)])
        longest = int(np.argmax(gone))
        jump = f"; {gone[longest]:.0f} s of them are one gap" if gone[longest] > (end - begin) / 2 else ""
        raise ConfigError(f"{path}: {end - begin:.0f} s at once (limit {_MOST_S:g} s){jump}: give `from_s` and `to_s`.")
    return begin, end


def _check_left(left_s: float, path: Path) -> None:
    if not left_s > 2 * EDGE_S:
        raise ConfigError(f"{path}: {max(left_s, 0.0):.3g} s are left of the log (limit {2 * EDGE_S:g} s).")
