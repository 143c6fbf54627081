"""An angle over time, in seconds and radians, from a run folder or from a CSV file that anyone wrote.

Columns are found by name, units by suffix or option; what cannot be told is asked for, never guessed, and
time and counts are checked before anything is computed from them.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from cfid.errors import ConfigError, DataError
from cfid.parameters import Source
from cfid.run import RUN_FILE, DeviceRecord, Label, Run, read_run
from cfid.table import Array, Table, open_table
from cfid.turns import CountsPerTurn, continuous_angle
from cfid.wire.rls import RLS_13BIT_IN_22

TimeUnit = Literal["s", "ms", "us"]
AngleUnit = Literal["counts", "rad", "deg"]

ENCODER = "encoder"
SECONDS: dict[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}

_UNITS: dict[str, tuple[str, ...]] = {
    "s": ("s", "sec", "second", "seconds"),
    "ms": ("ms", "msec", "millis", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "micros", "microseconds"),
    "rad": ("rad", "radian", "radians"),
    "deg": ("deg", "degree", "degrees", "°"),
    "counts": ("counts", "count"),
}


def _names(names: str, units: tuple[str, ...]) -> re.Pattern[str]:
    """Return what a column is called: `t`, `t_s`, `t [s]`, `angle(deg)`, `angle, deg`, ..."""
    spelt = "|".join(word for unit in units for word in _UNITS[unit])
    return re.compile(rf"(?:{names})(?:[ _/,\[(]+({spelt})[\])]?)?", re.IGNORECASE)


_TIME_NAME = _names("t|time|timestamp", ("s", "ms", "us"))
_ANGLE_NAME = _names("phi|angle|theta|position", ("rad", "deg", "counts"))
_FASTEST_S, _SLOWEST_S = 1.9e-5, 0.11  # sampling intervals of a rig: 50 kHz to 10 Hz, with room for jitter
_FEWEST_ROWS = 16
_REPEATED_SHARE = 0.01  # of time stamps that need no word when they repeat the one before
_UNIX_S = (1e9, 4e9)  # seconds since the epoch, from 2001 to 2096


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How to read a bare CSV file, where it does not say so itself."""

    time_unit: TimeUnit | None = None
    angle_unit: AngleUnit | None = None
    counts_per_turn: CountsPerTurn | None = None
    rate_hz: float | None = None
    skip_lines: int = 0
    columns: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class AngleRecord:
    """An angle (n,) that is continuous over turns, at increasing times (n,) from the first sample on."""

    path: Path
    source: Source
    label: Label
    time_s: Array
    angle_rad: Array
    notes: tuple[str, ...]
    run: str | None = None

    @property
    def name(self) -> str:
        """What to call it: the run's name, or the file's."""
        return self.run or self.path.stem


def read_angle(path: Path, reading: Reading) -> AngleRecord:
    """Read a run folder's encoder, or a bare CSV file.

    Raises DataError with file, line and next step; ConfigError when options contradict the file.
    """
    try:
        is_run = path.is_dir()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    if not is_run:
        return _read(path, reading, Label())[0]
    run = read_run(path)
    file, record = run.device_file(ENCODER), run.header.devices[ENCODER]
    if len(record.columns) < 2:
        raise DataError(f"{path / RUN_FILE}: devices.{ENCODER}.columns: has no time and angle.")
    own = Reading(
        time_unit="s",
        angle_unit="counts",
        counts_per_turn=reading.counts_per_turn or record.counts_per_turn,
        columns=record.columns[:2],
    )
    found, rows = _read(file, own, run.header.label)
    notes = tuple(f"{path.name}: {note}" for note in _losses(run, record, rows))
    return replace(found, run=path.resolve().name, notes=notes + found.notes)


def _losses(run: Run, record: DeviceRecord, rows: int) -> list[str]:
    """Return what run.toml says about how the recording ended and what it lacks."""
    said = []
    if run.cut:
        said.append("the run was cut while recording; what reached the disk is used.")
    if run.header.state == "failed":
        said.append(f"the run failed ({run.header.reason or 'no reason given'}); what was recorded is used.")
    if record.lost:
        said.append(f"{record.lost} samples were lost while recording.")
    if record.rows is not None and record.rows != rows:
        said.append(f"{record.rows} rows were recorded, but {record.file} has {rows}: it was changed since.")
    return said


def counts_per_turn(text: str) -> CountsPerTurn:
    """Parse --counts-per-turn: a number, or the name of a word format.

    Raises ConfigError for anything else.
    """
    if text == RLS_13BIT_IN_22:
        return text
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not (np.isfinite(value) and value > 0):
        raise ConfigError(f"--counts-per-turn {text}: expected a number above zero, or {RLS_13BIT_IN_22}.")
    return value


def _read(path: Path, reading: Reading, label: Label) -> tuple[AngleRecord, int]:
    """Return a file's record, and how many rows the file has."""
    table = open_table(path, skip_lines=reading.skip_lines)
    time_column, angle_column = _columns(table, reading)
    values = table.numbers([*([time_column] if time_column else []), angle_column])
    if len(values) < _FEWEST_ROWS:
        raise DataError(f"{path}: {len(values)} rows; a recording has at least {_FEWEST_ROWS}.")
    time, said = _time(table, reading, time_column, values[:, 0])
    unit = _unit(table, _ANGLE_NAME, angle_column, reading.angle_unit, "--angle-unit")
    angle = continuous_angle(table, angle_column, values[:, -1], unit=unit, counts_per_turn=reading.counts_per_turn)
    if table.cut:
        said += ("the last line was cut (it has no end) and is left out.",)
    record = AngleRecord(
        path=path,
        source=Source(str(path), table.sha256),
        label=label,
        time_s=time[angle.rows] - time[angle.rows[0]],
        angle_rad=angle.angle_rad,
        notes=tuple(f"{path.name}: {note}" for note in said + angle.said),
    )
    return record, len(values)


def _columns(table: Table, reading: Reading) -> tuple[str | None, str]:
    """Return the time column (None with a given rate) and the angle column, each as the table finds it."""
    if reading.columns:
        if len(reading.columns) != (1 if reading.rate_hz is not None else 2):
            raise ConfigError("--columns names the time and the angle column, or with --rate-hz the angle alone.")
        if len({table.place(column) for column in reading.columns}) < len(reading.columns):
            raise ConfigError(f"--columns {','.join(reading.columns)}: one column cannot be both time and angle.")
        return (None if reading.rate_hz is not None else reading.columns[0]), reading.columns[-1]
    names = [name for name in table.names if name]
    if not table.has_head and len(names) == (1 if reading.rate_hz is not None else 2):
        return (None if reading.rate_hz is not None else names[0]), names[-1]
    if not table.has_head and len(names) == 1:
        raise DataError(f"{table.path}: one column and no time: say --rate-hz.")
    if not table.has_head:
        option = "--columns TIME,ANGLE" if reading.rate_hz is None else "--columns ANGLE"
        raise DataError(
            f"{table.path}: no head names its {len(names)} columns: say {option} by number, as in "
            f"{'1,2' if reading.rate_hz is None else '2'}. Numbers need decimal points, and no comma inside."
        )
    angle = _named(table, _ANGLE_NAME, "angle (phi, angle, theta)", "--columns TIME,ANGLE")
    if reading.rate_hz is not None:
        return None, angle
    return _named(table, _TIME_NAME, "time (t, time)", "--columns TIME,ANGLE, or --rate-hz"), angle


def _named(table: Table, pattern: re.Pattern[str], what: str, option: str) -> str:
    fitting = [(str(i + 1), name) for i, name in enumerate(table.names) if pattern.fullmatch(name)]
    if len(fitting) == 1:
        return fitting[0][1]
    if not fitting:
        raise DataError(f"{table.path}: no column of {what} among {table.listing}: say {option}.")
    several = ", ".join(f"{name} ({number})" for number, name in fitting)
    raise DataError(f"{table.path}: more than one column of {what}: {several}. Say {option}, by name or number.")


def _unit(table: Table, pattern: re.Pattern[str], column: str, asked: str | None, option: str) -> str | None:
    """Return the unit that was asked for or that the column's name ends with, if any."""
    name = table.names[table.place(column)]
    match = pattern.fullmatch(name)
    word = match.group(1) if match else None
    named = next((unit for unit, words in _UNITS.items() if word and word.lower() in words), None)
    if asked and named and asked != named:
        raise ConfigError(f"{table.path}: column '{name}' says {named}, {option} says {asked}.")
    return asked or named


def _time(table: Table, reading: Reading, column: str | None, raw: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the times in seconds from the first on, and what is to be said about them."""
    if reading.rate_hz is not None:
        if not 0 < reading.rate_hz < np.inf:
            raise ConfigError(f"--rate-hz {reading.rate_hz:g}: a rate is above zero.")
        return np.arange(len(raw)) / reading.rate_hz, ()
    unit = _unit(table, _TIME_NAME, column or "", reading.time_unit, "--time-unit") or "s"
    with np.errstate(over="ignore"):
        intervals = np.diff(raw)
    backwards = np.flatnonzero(intervals < 0)
    if len(backwards):
        row = int(backwards[0]) + 1
        raise DataError(
            f"{table.path}:{table.line_of_row(row)}: time goes back from {raw[row - 1]:.6f} to {raw[row]:.6f} "
            f"{unit}. Was the clock set, or are two recordings in one file?"
        )
    said = _check_unit(table.path, raw[0], intervals, unit)
    repeated = int(np.count_nonzero(intervals == 0))
    if repeated > _REPEATED_SHARE * len(raw):
        said += (f"{repeated} of {len(raw)} samples have the time of the one before.",)
    return np.asarray((raw - raw[0]) * SECONDS[unit]), said


def _check_unit(path: Path, first: float, intervals: Array, unit: str) -> tuple[str, ...]:
    """Refuse a time unit that makes no sampling interval a rig can have, and propose one that does."""
    if not np.any(intervals):
        raise DataError(
            f"{path}: time stands still at {first:.12g}. Were its last digits cut off, are there decimal commas, or is "
            "this not the time column? See --columns and --rate-hz."
        )
    # The median of those that pass: stamps that come in blocks repeat, and a pause is one long interval.
    interval = float(np.median(intervals[intervals > 0]))
    fitting = [name for name, scale in SECONDS.items() if _FASTEST_S <= interval * scale <= _SLOWEST_S]
    dates = [name for name, scale in SECONDS.items() if _UNIX_S[0] <= first * scale <= _UNIX_S[1]]
    dated = f" It starts at {first:.0f}, which is a date (Unix time) in {dates[0]}." if dates else ""
    better = dates if dates and dates[0] in fitting else fitting
    if unit not in fitting or (better is dates and unit not in dates):
        advice = f"Say --time-unit {better[0]}." if better else "Is this the time column? See --columns and --rate-hz."
        seconds = f"{interval * SECONDS[unit]:.3g}"
        raise DataError(f"{path}: read in {unit}, the time column has {seconds} s between samples.{dated} {advice}")
    if unit == better[0]:
        return ()
    # What is slow in one unit is very fast in the next, and few instruments are.
    rate = f"{1 / (interval * SECONDS[unit]):.0f} Hz"
    return (f"time is read in {unit}, which makes {rate}: is it not in {better[0]}?",)
