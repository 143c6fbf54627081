"""What every recording has, whatever it measures: named columns, times in seconds, and a word on how it ended.

Time is checked before anything is computed from it; what the other columns mean is the business of the module
above that reads them.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from cfid.errors import ConfigError, DataError
from cfid.records.files import first_fault
from cfid.records.run import RUN_FILE, DeviceRecord, Run, read_run
from cfid.records.tables.table import Array, Table

TimeUnit = Literal["s", "ms", "us"]

SECONDS: dict[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
CUT_LINE = "the last line was cut (it has no end) and is left out."

_UNITS: dict[str, tuple[str, ...]] = {
    "s": ("s", "sec", "second", "seconds"),
    "ms": ("ms", "msec", "millis", "milliseconds"),
    "us": ("us", "µs", "μs", "usec", "micros", "microseconds"),
    "rad": ("rad", "radian", "radians"),
    "deg": ("deg", "degree", "degrees", "°"),
    "n": ("n", "newton", "newtons"),
    "nm": ("nm", "n m", "n*m", "n·m"),
    "counts": ("counts", "count"),
}
_FASTEST_S, _SLOWEST_S = 1.9e-5, 0.11  # sampling intervals of a rig: 50 kHz to 10 Hz, with room for jitter
_FEWEST_ROWS = 16
_REPEATED_SHARE = 0.01  # of time stamps that need no word when they repeat the one before
_UNIX_S = (1e9, 4e9)  # seconds since the epoch, from 2001 to 2096


class Gap(BaseModel):
    """A span of Unix time in which a device gave nothing, and why."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    from_s: float
    to_s: float
    reason: str


class Facts(BaseModel):
    """What run.toml says of a device that samples by itself beyond what it says of any device."""

    model_config = ConfigDict(frozen=True)

    gaps: tuple[Gap, ...] = ()


Kind = TypeVar("Kind", bound=Facts)


def column_name(names: str, units: Sequence[str]) -> re.Pattern[str]:
    """Return what a column is called: `t`, `t_s`, `t [s]`, `angle(deg)`, `angle, deg`, ..."""
    spelt = "|".join(re.escape(word) for unit in units for word in _UNITS[unit])
    return re.compile(rf"(?:{names})(?:[ _/,\[(]+({spelt})[\])]?)?", re.IGNORECASE)


_TIME_NAME = column_name("t|time|timestamp", ("s", "ms", "us"))


def run_at(path: Path) -> Run | None:
    """Return the run that a folder is, or None for anything but a folder.

    Raises DataError when it cannot be read.
    """
    try:
        is_run = path.is_dir()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    return read_run(path) if is_run else None


def losses(run: Run, record: DeviceRecord, rows: int) -> list[str]:
    """Return what run.toml says about how a device's recording came about, ended, and what it lacks."""
    said = []
    if run.cut:
        said.append("the run was cut while recording; what reached the disk is used.")
    if run.header.state == "failed":
        said.append(f"the run failed ({run.header.reason or 'no reason given'}); what was recorded is used.")
    if record.lost:
        said.append(f"{record.lost} samples were lost while recording.")
    if record.rows is not None and record.rows != rows:
        said.append(f"{record.rows} rows were recorded, but {record.file} has {rows}: it was changed since.")
    if run.header.simulated:
        said.append("recorded on the simulated rig.")
    return said


def facts_of(run: Run, device: str, kind: type[Kind]) -> Kind:
    """Return what run.toml says of one of its devices. Raises DataError when it makes no sense."""
    extra = run.header.devices[device].model_extra or {}
    try:
        return kind.model_validate(extra)
    except ValidationError as error:
        fault = first_fault(error, extra)
        raise DataError(f"{run.folder / RUN_FILE}: devices.{device}.{fault}") from None


def gaps(facts: Facts) -> list[str]:
    """Return what is to be said of spans without samples."""
    if not facts.gaps:
        return []
    reasons = ", ".join(dict.fromkeys(gap.reason for gap in facts.gaps))
    total_s = sum(gap.to_s - gap.from_s for gap in facts.gaps)
    return [f"no samples for {total_s:.1f} s in {len(facts.gaps)} gap(s): {reasons}."]


def time_column(table: Table, option: str) -> str:
    """Return the name of the time column; `option` is what can say it.

    Raises DataError when there is none, or more than one.
    """
    return named_column(table, _TIME_NAME, "time (t, time)", f"{option}, or --rate-hz")


def named_column(table: Table, pattern: re.Pattern[str], what: str, option: str) -> str:
    """Return the one column that is called so.

    Raises DataError when there is none, or more than one.
    """
    fitting = [(str(i + 1), name) for i, name in enumerate(table.names) if pattern.fullmatch(name)]
    if len(fitting) == 1:
        return fitting[0][1]
    if not fitting:
        raise DataError(f"{table.path}: no column of {what} among {table.listing}: say {option}.")
    several = ", ".join(f"{name} ({number})" for number, name in fitting)
    raise DataError(f"{table.path}: more than one column of {what}: {several}. Say {option}, by name or number.")


def unit_of(table: Table, pattern: re.Pattern[str], column: str, asked: str | None, option: str) -> str | None:
    """Return the unit that was asked for or that the column's name ends with, if any.

    Raises ConfigError when the two contradict each other.
    """
    name = table.names[table.place(column)]
    match = pattern.fullmatch(name)
    word = match.group(1) if match else None
    named = next((unit for unit, words in _UNITS.items() if word and word.lower() in words), None)
    if asked and named and asked != named:
        raise ConfigError(f"{table.path}: column '{name}' says {named}, {option} says {asked}.")
    return asked or named


def numbers_of(table: Table, columns: Sequence[str]) -> Array:
    """Return the named columns, shape (rows, columns).

    Raises DataError when they are no numbers, or too few to be a recording.
    """
    values = table.numbers(columns)
    if len(values) < _FEWEST_ROWS:
        raise DataError(f"{table.path}: {len(values)} rows; a recording has at least {_FEWEST_ROWS}.")
    return values


def seconds_of(table: Table, column: str, raw: Array, *, unit: TimeUnit | None) -> Array:
    """Return a time column's values (n,) in seconds, on the clock that the file has them by.

    Raises ConfigError when the unit that was asked for is not that of the column's name.
    """
    return raw * SECONDS[unit_of(table, _TIME_NAME, column, unit, "--time-unit") or "s"]


def times_of(
    table: Table, column: str | None, raw: Array, *, unit: TimeUnit | None, rate_hz: float | None, own: bool = False
) -> tuple[Array, tuple[str, ...]]:
    """Return the times (n,) in seconds from the first on, and what is to be said about them.

    `raw` (n,) are the column's values; with a rate neither is looked at. Of a run of our `own` the unit is known,
    however slow it is. Raises DataError when time goes back, stands still or has another unit, ConfigError for a
    rate that is none.
    """
    if rate_hz is not None:
        if not 0 < rate_hz < np.inf:
            raise ConfigError(f"--rate-hz {rate_hz:g}: a rate is above zero.")
        return np.arange(len(raw)) / rate_hz, ()
    known = unit_of(table, _TIME_NAME, column or "", unit, "--time-unit") or "s"
    with np.errstate(over="ignore"):
        intervals = np.diff(raw)
    backwards = np.flatnonzero(intervals < 0)
    if len(backwards):
        row = int(backwards[0]) + 1
        raise DataError(
            f"{table.path}:{table.line_of_row(row)}: time goes back from {raw[row - 1]:.6f} to {raw[row]:.6f} "
            f"{known}. Was the clock set, or are two recordings in one file?"
        )
    if not np.any(intervals):
        raise DataError(
            f"{table.path}: time stands still at {raw[0]:.12g}. Were its last digits cut off, are there decimal "
            "commas, or is this not the time column? See --columns and --rate-hz."
        )
    said = () if own else _check_unit(table.path, raw[0], intervals, known)
    repeated = int(np.count_nonzero(intervals == 0))
    if repeated > _REPEATED_SHARE * len(raw):
        said += (f"{repeated} of {len(raw)} samples have the time of the one before.",)
    return np.asarray((raw - raw[0]) * SECONDS[known]), said


def _check_unit(path: Path, first: float, intervals: Array, unit: str) -> tuple[str, ...]:
    """Refuse a time unit that makes no sampling interval a rig can have, and propose one that does."""
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
