"""What a recording of any origin is: series of columns with units over time, typed facts, and findings."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from pandas import DataFrame

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.large import stored
from cfid.records.parameters import Source
from cfid.records.run import Label, Run
from cfid.units import factor

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
Kind = Literal["angle", "wrench", "stand", "flight", "ping", "period"]
Clock = Literal["computer", "true", "84/85", "unknown"]

_TIMES = re.compile(
    r"t|tout|time|time[ _]?stamp|ticks?|elapsed(?:[ _]time)?|relative[ _]time|timeus|seconds?|secs?|millis|micros",
    re.IGNORECASE,
)
_ANGLES = re.compile(
    r"(?:phi|angle|theta|alpha|winkel|auslenkung|[φϕθϑα]|pos|position|enc|encoder(?:[ _]angle)?)_?\d?", re.IGNORECASE
)
TIME, ANGLE = "t", "phi"  # what runs call them, and options that name no other column
COUNTS = ("counts", "count")  # as units of an encoder or a load cell
ENCODER = "encoder"  # the device of a run
OF_TABLES = ("columns", "units", "rate_hz", "skip_lines", "decimal", "rows")  # fields of `How`
FEWEST_ROWS = 16  # of a recording of an angle or of forces
MISSING_SHARE = 0.1  # of a recording's rows that may lack a number


def is_time(name: str) -> bool:
    """Return whether a column is called a time."""
    return bool(_TIMES.fullmatch(name))


def is_angle(name: str) -> bool:
    """Return whether a column is called an angle, also as the last part of a dotted name."""
    return bool(_ANGLES.fullmatch(name.rpartition(".")[2]))


@dataclass(frozen=True, kw_only=True)
class How:
    """What a file does not say of itself. Each field is an option of `cfid import`.

    `columns` are NAME=COLUMN, with a column's name or number, or columns alone in the order of the kind. `units` are
    by column, `rows` the words that select rows, by column. `clock` relates a Crazyflie's microseconds to real time,
    `log` is the number of one of several flights in a file, counted from 1.
    """

    columns: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    skip_lines: int = 0
    decimal: Literal[".", ","] = "."
    rows: tuple[tuple[str, str], ...] = ()
    clock: Literal["true", "84/85"] | None = None
    counts_per_turn: float | str | None = None
    counts_per_n: float | None = None
    counts_per_nm: float | None = None
    esc_us: tuple[float, float] | None = None
    dshot: bool = False
    motors: int | None = None
    log: int | None = None
    props_out: bool | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the fields that differ from their defaults."""
        default = How()
        return tuple(one.name for one in fields(self) if getattr(self, one.name) != getattr(default, one.name))

    def refuse_unused(self, path: Path, *used: str) -> None:
        """Raise ConfigError for a field that was given and is not among those that a kind of file uses."""
        unused = [name for name in self.given if name not in used]
        if unused:
            names = ", ".join(f"`{'unit' if name == 'units' else name}`" for name in unused)
            raise ConfigError(f"{path}: {names}: nothing in this recording needs it. Leave it out.", code="unused")


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """A column: its name without the unit, the unit as it is spelt, "" for none, and its numbers in that unit.

    `head` is the name in the file. `values` (n,) are nan where the file has no number.
    """

    name: str
    unit: str
    values: Array
    head: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Columns (n,) that were sampled together, at times (n,) in s since the first row.

    `time_s` is None for a table without times, `begin_s` the first row's time by the file's clock, None without one.
    `line_of_row` gives the line of the file, counted from 1, of a row counted from 0; `source` has the file's checksum.
    """

    name: str
    path: Path
    columns: tuple[Column, ...]
    rows: int
    source: Source | None = None
    time_s: Array | None = None
    begin_s: float | None = None
    line_of_row: Callable[[int], int] | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The columns' names."""
        return tuple(column.name for column in self.columns)

    def line(self, row: int) -> str:
        """Return the path, with the line of a row where the file has lines, to begin a message."""
        return f"{self.path}:{self.line_of_row(row)}" if self.line_of_row is not None else f"{self.path}"

    def line_number(self, row: int) -> int:
        """Return the line of the file of a row, or the number of the row, counted from 1."""
        return row + 1 if self.line_of_row is None else self.line_of_row(row)

    def column(self, name: str) -> Column:
        """Return a column by its name, or by its head in the file. Raises DataError that names the columns."""
        named = [one for one in self.columns if one.name == name] or [one for one in self.columns if one.head == name]
        if len(named) > 1:
            raise DataError(f"{self.path}: {len(named)} columns are named '{name}': give one by `columns`.")
        if not named:
            listing = ", ".join(one.head or one.name for one in self.columns)
            raise DataError(f"{self.path}: no column '{name}'; it has {listing}.", code="no-column")
        return named[0]

    def si(self, name: str, unit: str) -> Array:
        """Return a column (n,) in an SI unit.

        Raises ConfigError where the column has no unit, DataError where its unit is of another kind.
        """
        column = self.column(name)
        if not column.unit:
            raise ConfigError(
                f"{self.path}: column '{column.head or name}' names no unit: give `unit` {name}={unit.replace(' ', '')}"
                " or the like.",
                code="no-unit",
            )
        scale = factor(column.unit, unit)
        if scale is None:
            raise DataError(
                f"{self.path}: column '{column.head or name}' is in '{column.unit}', which is no unit of "
                f"{unit.replace(' ', '')}. Where the name is wrong, give `unit` {name}=...",
                code="other-unit",
            )
        return column.values if scale == 1 else column.values * scale

    def complete(self, names: Sequence[str]) -> "Series":
        """Return the series without the rows that lack a number in a column, with a finding.

        Raises DataError that names the first such row, where more than a tenth lack one.
        """
        lacking = np.zeros(self.rows, np.bool_)
        for name in names:
            lacking |= ~np.isfinite(self.column(name).values)
        count = int(np.count_nonzero(lacking))
        if not count:
            return self
        row = int(np.argmax(lacking))
        if count > MISSING_SHARE * self.rows:
            raise DataError(
                f"{self.line(row)}: no number in {' or '.join(names)}, as in {count} of {self.rows} rows. "
                "Correct the column, or name another by `columns`.",
                code="no-number",
            )
        left_out = finding(
            "rows-without-number", count=count, rows=self.rows, names=", ".join(names), line=self.line_number(row)
        )
        kept = self.kept(~lacking)
        return replace(kept, findings=(*kept.findings, left_out.at(self.path.name)))

    def kept(self, rows: npt.NDArray[np.bool_] | Rows) -> "Series":
        """Return the series with some of its rows, by a mask or by their places, in this order."""
        places = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        line_of_row, time_s = self.line_of_row, self.time_s
        return replace(
            self,
            columns=tuple(replace(one, values=stored(one.values[places])) for one in self.columns),
            rows=len(places),
            time_s=None if time_s is None else stored(time_s[places]),
            line_of_row=None if line_of_row is None else lambda row: line_of_row(int(places[row])),
        )

    def frame(self) -> DataFrame:
        """Return the columns as a data frame, in their units; `t` are the times in s since the first row."""
        times = {} if self.time_s is None else {"t": self.time_s}
        return DataFrame({**times, **{one.name: one.values for one in self.columns}})


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What is known of a recording as a whole, None where nothing states it.

    `begin_s` is the Unix time of its first row. `clock` tells whether times are those of this computer, or of a
    Crazyflie at its true rate, at 84/85 of it, or unknown which. `props_out` is whether rotors turn the other way than
    a Crazyflie's, `square` whether they stand at the corners of a square, `motors` how many motors thrust and torque
    are of.
    """

    program: str = ""
    label: Label = field(default_factory=Label)
    begin_s: float | None = None
    clock: Clock | None = None
    props_out: bool | None = None
    square: bool | None = None
    motors: int | None = None
    simulated: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """A run folder or a file of another program, read: its series by name, its facts, and what was found on the way.

    The series of a run folder are read when they are asked for.
    """

    path: Path
    source: Source
    series: Mapping[str, Series]
    facts: Facts = field(default_factory=Facts)
    run: Run | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def name(self) -> str:
        """The run's name, or the file's without its suffix."""
        return self.path.stem if self.run is None else self.run.folder.resolve().name

    def holding(self, *names: str) -> Series:
        """Return the series with columns of these names; of several, the one with most rows.

        Raises a DataError that names the columns of the recording.
        """
        there = [one for one in self.series.values() if set(names) <= {*one.names, *(c.head for c in one.columns)}]
        if not there:
            listing = "; ".join(f"{name}: {', '.join(one.names)}" for name, one in self.series.items())
            raise DataError(f"{self.path}: no column {', '.join(names)}; it has {listing}.", code="no-column")
        return max(there, key=lambda one: one.rows)
