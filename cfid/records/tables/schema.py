"""Define the columns of each kind of CSV file and their names in files, and find them in a table."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, NamedTuple

from cfid.errors import ConfigError, DataError
from cfid.records.tables.head import POINTS
from cfid.records.tables.matlab import is_matlab
from cfid.records.tables.table import CsvTable

TimeUnit = Literal["s", "ms", "us"]

TIME = "t"


class Column(NamedTuple):
    """A column of a kind: its key, the pattern of its names in files, and its description in messages."""

    key: str
    called: re.Pattern[str]
    label: str
    optional: bool = False

    @classmethod
    def named(cls, key: str, *, optional: bool = False) -> "Column":
        """Return a column whose only name in files is its key."""
        return cls(key, re.compile(re.escape(key)), key, optional)


@dataclass(frozen=True, kw_only=True)
class Foreign:
    """How to read a file outside a run, where the file does not show it; a rate replaces the time column.

    `clock` relates the times of a uSD-card log, or of a table made of one, to real time.
    """

    time_unit: TimeUnit | None = None
    rate_hz: float | None = None
    skip_lines: int = 0
    columns: tuple[str, ...] = ()
    clock: Literal["true", "84/85"] | None = None


def refuse_clock(path: Path, reading: Foreign) -> None:
    """Raise ConfigError for a clock that was given for a recording whose times are not a Crazyflie's microseconds."""
    if reading.clock is not None:
        raise ConfigError(f"{path}: `clock` is for logs of a Crazyflie's uSD card and tables made of them.")


def unused_in_run(reading: Foreign, *used: str) -> tuple[str, ...]:
    """Return a note on settings for other programs' files that were given for a run, except those in `used`."""
    given = [f"`{one.name}`" for one in fields(reading) if getattr(reading, one.name) != one.default]
    unused = ", ".join(name for name in given if name.strip("`") not in used)
    return (f"{unused}: not used, the times and columns of a run are as they were taken.",) if unused else ()


def refuse_for_run(path: Path, reading: Foreign) -> None:
    """Raise ConfigError for settings of other programs' files that were given for a run."""
    for note in unused_in_run(reading):
        raise ConfigError(f"{path}: {note}")


@dataclass(frozen=True, kw_only=True)
class TableSchema:
    """The columns of one kind of table.

    `words` are those of the setting `columns`, in the columns' order, empty for a kind that is read only by its
    header. `hint` ends the message on a missing column.
    """

    columns: tuple[Column, ...]
    words: tuple[str, ...] = ()
    hint: str = ""

    def places(self, table: CsvTable, *, named: Sequence[str] = (), rate_hz: float | None = None) -> dict[str, str]:
        """Return the table's names of the columns, by key: those `named` by option, else by the header, else by order.

        An optional column may be absent, and is left out where columns are named; so is the time where a rate is
        given. Raises ConfigError for named columns that are too few, too many or repeated, DataError for a table
        that does not show its columns.
        """
        needed = [one for one in self.columns if not (one.optional or (one.key == TIME and rate_hz is not None))]
        if self.words and (named or not table.has_head):
            return dict(zip([one.key for one in needed], self._in_order(table, named, needed), strict=True))
        there = {one: [name for name in table.names if one.called.fullmatch(name)] for one in self.columns}
        self._check(table, {one: names for one, names in there.items() if one in needed})
        return {one.key: names[0] for one, names in there.items() if names and (one in needed or one.optional)}

    def _in_order(self, table: CsvTable, named: Sequence[str], needed: Sequence[Column]) -> list[str]:
        count, option = len(needed), self._option(needed)
        if named:
            if len(named) != count or len({table.place(name) for name in named}) < count:
                both = len(self.words)
                raise ConfigError(
                    f"`columns` {','.join(self.words)} names {both} columns, or with `rate_hz` the last {both - 1} "
                    "alone; none of them twice."
                )
            return list(named)
        names = [name for name in table.names if name]
        if len(names) == count:
            return names
        if needed[0].key == TIME and len(names) == count - 1:
            what = "one column" if count == 2 else f"{len(names)} columns"
            raise DataError(f"{table.path}: {what} and no time: give `rate_hz`.")
        by_number = ",".join(str(1 + place) for place in range(len(self.words) - count, len(self.words)))
        spelling = "" if is_matlab(table.path) else f" {POINTS}"
        raise DataError(
            f"{table.path}: no header for its {len(names)} columns: give {option} by number, as in {by_number}."
            f"{spelling}"
        )

    def _check(self, table: CsvTable, there: dict[Column, list[str]]) -> None:
        option = self._option(list(there))
        several = [one for one, names in there.items() if len(names) > 1]
        if several:
            found = (f"{name} ({i})" for i, name in enumerate(table.names, start=1) if name in there[several[0]])
            raise DataError(
                f"{table.path}: more than one column {several[0].label}: {', '.join(found)}. Give {option}, by name or "
                "number."
            )
        missing = [one for one, names in there.items() if not names]
        if missing:
            what = ", ".join(one.label for one in missing)
            rate = ", or `rate_hz`" if self.words and {one.key for one in missing} == {TIME} else ""
            hint = f" {self.hint}" if self.hint else ""
            raise DataError(f"{table.path}: no column {what} among {table.listing}: give {option}{rate}.{hint}")

    def _option(self, needed: Sequence[Column]) -> str:
        if not self.words:
            return f"a header {','.join(one.key for one in needed)}"
        return f"`columns` {','.join(self.words[-len(needed) :])}"
