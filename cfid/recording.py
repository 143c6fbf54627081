"""An angle over time, in seconds and radians, from a run folder or from a CSV file that anyone wrote.

Columns are found by name, units by suffix or option; what cannot be told is asked for, never guessed, and
time and counts are checked before anything is computed from them.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.parameters import Source
from cfid.run import Label, read_run
from cfid.table import Table, open_table
from cfid.wire.e201 import RLS_13BIT_IN_22, STEPS_PER_TURN, WORD_COUNTS_PER_TURN, decode_words

Array = npt.NDArray[np.float64]
TimeUnit = Literal["s", "ms", "us"]
AngleUnit = Literal["counts", "rad", "deg"]
CountsPerTurn = float | str

ENCODER = "encoder"
SECONDS: dict[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}

_TIME_NAME = re.compile(r"(?:t|time|timestamp)(?:[ _\[(]+(s|ms|us)[\])]?)?", re.IGNORECASE)
_ANGLE_NAME = re.compile(r"(?:phi|angle|theta|position)(?:[ _\[(]+(rad|deg|counts)[\])]?)?", re.IGNORECASE)
_FASTEST_S, _SLOWEST_S = 2e-5, 0.1  # sampling intervals of a rig: 50 kHz to 10 Hz
_FEWEST_ROWS = 16
_FAILED_SHARE = 0.01  # of 13-bit words that may fail their check
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


def read_angle(path: Path, reading: Reading) -> AngleRecord:
    """Read a run folder's encoder, or a bare CSV file.

    Raises DataError with file, line and next step; ConfigError when options contradict the file.
    """
    if not path.is_dir():
        return _read(path, reading, Label(), ())
    run = read_run(path)
    file, record = run.device_file(ENCODER), run.header.devices[ENCODER]
    own = Reading(
        time_unit="s",
        angle_unit="counts",
        counts_per_turn=reading.counts_per_turn or record.counts_per_turn,
        columns=record.columns[:2],
    )
    notes = () if not run.cut else ("the run was cut while recording; what reached the disk is used.",)
    return _read(file, own, run.header.label, notes)


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


def _read(path: Path, reading: Reading, label: Label, notes: tuple[str, ...]) -> AngleRecord:
    table = open_table(path, skip_lines=reading.skip_lines)
    time_column, angle_column = _columns(table, reading)
    values = table.numbers([*([time_column] if time_column else []), angle_column])
    if len(values) < _FEWEST_ROWS:
        raise DataError(f"{path}: {len(values)} rows; a recording has at least {_FEWEST_ROWS}.")
    time = _time(table, reading, time_column, values[:, 0])
    angle, keep, said = _angle(path, reading, angle_column, values[:, -1])
    if table.cut:
        notes += ("the last line was cut in the middle and is left out.",)
    return AngleRecord(
        path=path,
        source=Source(str(path), table.sha256),
        label=label,
        time_s=time[keep] - time[keep][0],
        angle_rad=angle,
        notes=tuple(f"{path.name}: {note}" for note in notes + said),
    )


def _columns(table: Table, reading: Reading) -> tuple[str | None, str]:
    """Return the names of the time column (None with a given rate) and of the angle column."""
    if reading.columns:
        if len(reading.columns) != (1 if reading.rate_hz else 2):
            raise ConfigError("--columns names the time and the angle column, or with --rate-hz the angle alone.")
        return (None if reading.rate_hz else reading.columns[0]), reading.columns[-1]
    names = table.names
    if not table.has_head and len(names) <= 2:
        if len(names) == 1 and not reading.rate_hz:
            raise DataError(f"{table.path}: one column and no time: say --rate-hz.")
        return (None if reading.rate_hz else names[0]), names[-1]
    angle = _named(table, _ANGLE_NAME, "angle (phi, angle, theta)", "--columns TIME,ANGLE")
    if reading.rate_hz:
        return None, angle
    return _named(table, _TIME_NAME, "time (t, time)", "--columns TIME,ANGLE, or --rate-hz"), angle


def _named(table: Table, pattern: re.Pattern[str], what: str, option: str) -> str:
    fitting = [name for name in table.names if pattern.fullmatch(name)]
    if len(fitting) == 1:
        return fitting[0]
    columns = ", ".join(table.names)
    if not fitting:
        raise DataError(f"{table.path}: no column of {what} among {columns}: say {option}.")
    raise DataError(f"{table.path}: more than one column of {what}: {', '.join(fitting)}. Say {option}.")


def _suffix(pattern: re.Pattern[str], name: str | None) -> str | None:
    match = pattern.fullmatch(name or "")
    return match.group(1).lower() if match and match.group(1) else None


def _unit(path: Path, asked: str | None, named: str | None, column: str | None, option: str) -> str | None:
    if asked and named and asked != named:
        raise ConfigError(f"{path}: column '{column}' says {named}, {option} says {asked}.")
    return asked or named


def _time(table: Table, reading: Reading, column: str | None, raw: Array) -> Array:
    if reading.rate_hz is not None:
        if reading.rate_hz <= 0:
            raise ConfigError(f"--rate-hz {reading.rate_hz:g}: a rate is above zero.")
        return np.arange(len(raw)) / reading.rate_hz
    unit = _unit(table.path, reading.time_unit, _suffix(_TIME_NAME, column), column, "--time-unit") or "s"
    backwards = np.flatnonzero(np.diff(raw) < 0)
    if len(backwards):
        row = int(backwards[0]) + 1
        raise DataError(
            f"{table.path}:{table.line_of_row(row)}: time goes back from {raw[row - 1]:.6f} to {raw[row]:.6f} "
            f"{unit}. Was the clock set, or are two recordings in one file?"
        )
    _check_interval(table.path, raw, unit)
    return np.asarray((raw - raw[0]) * SECONDS[unit])


def _check_interval(path: Path, raw: Array, unit: str) -> None:
    """Refuse a time unit that makes no sampling interval a rig can have, and propose one that does."""
    interval = (raw[-1] - raw[0]) / (len(raw) - 1)
    if _FASTEST_S <= interval * SECONDS[unit] <= _SLOWEST_S:
        return
    fitting = [name for name, scale in SECONDS.items() if _FASTEST_S <= interval * scale <= _SLOWEST_S]
    epoch = [name for name, scale in SECONDS.items() if _UNIX_S[0] <= raw[0] * scale <= _UNIX_S[1]]
    advice = f"Say --time-unit {fitting[0]}." if fitting else "Is this the time column? See --columns and --rate-hz."
    dated = f" It starts at {raw[0]:.0f}, which is a date (Unix time) in {epoch[0]}." if epoch else ""
    raise DataError(
        f"{path}: read in {unit}, the time column has {interval * SECONDS[unit]:.3g} s between samples.{dated} {advice}"
    )


def _angle(
    path: Path, reading: Reading, column: str, raw: Array
) -> tuple[Array, npt.NDArray[np.bool_], tuple[str, ...]]:
    """Return the continuous angle, which rows it kept, and what is to be said about them."""
    unit = _unit(path, reading.angle_unit, _suffix(_ANGLE_NAME, column), column, "--angle-unit")
    everything = np.ones(len(raw), dtype=bool)
    whole = bool(np.all(raw == np.round(raw)))
    if unit is None and (whole or reading.counts_per_turn is not None):
        unit = "counts"
    if unit is None:
        raise DataError(
            f"{path}: column '{column}' does not say its unit, and whole counts it is not: say --angle-unit rad|deg."
        )
    if unit == "counts":
        if not whole:
            raise DataError(f"{path}: column '{column}' is read as counts but has fractions: say --angle-unit rad|deg.")
        return _from_counts(path, reading.counts_per_turn, raw.astype(np.int64))
    angle = np.radians(raw) if unit == "deg" else raw
    # Only an angle that was folded into one turn can need unfolding.
    folded = np.ptp(angle) <= 2 * np.pi * (1 + 1e-9)
    return (np.unwrap(angle) if folded else angle), everything, ()


def _from_counts(
    path: Path, setting: CountsPerTurn | None, counts: npt.NDArray[np.int64]
) -> tuple[Array, npt.NDArray[np.bool_], tuple[str, ...]]:
    position, valid = decode_words(counts)
    said: tuple[str, ...] = ()
    if setting is None:
        # A word passes its check by chance once in 512: a file in which most pass is of that kind.
        setting = RLS_13BIT_IN_22 if np.mean(valid) > 0.5 else float(WORD_COUNTS_PER_TURN)
        name = setting if setting == RLS_13BIT_IN_22 else f"{WORD_COUNTS_PER_TURN}"
        said = (f"counts are read as --counts-per-turn {name}.",)
        if setting != RLS_13BIT_IN_22 and (counts.min() < 0 or counts.max() >= WORD_COUNTS_PER_TURN):
            raise DataError(f"{path}: counts run from {counts.min()} to {counts.max()}: say --counts-per-turn.")
    if setting != RLS_13BIT_IN_22:
        turns = counts / float(setting)
        return np.unwrap(2 * np.pi * (turns - np.floor(turns))), np.ones(len(counts), dtype=bool), said
    failed = int(np.count_nonzero(~valid))
    if failed > _FAILED_SHARE * len(counts):
        raise DataError(
            f"{path}: {failed} of {len(counts)} samples fail the check of a 13-bit word in 22 bits, more than "
            f"{100 * _FAILED_SHARE:g} %: a loose cable, or another encoder (--counts-per-turn N, e.g. 4194304)."
        )
    if failed:
        said += (f"{failed} of {len(counts)} samples fail the 13-bit check and are left out.",)
    angle = np.unwrap(2 * np.pi / STEPS_PER_TURN * position[valid])
    return angle, valid, said
