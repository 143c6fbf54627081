"""Represent a recording of any origin as named channels in SI units, read block by block, whatever its size."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.large import empty, joined
from cfid.records.parameters import Source
from cfid.units import RPM, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

BLOCK_ROWS = 1 << 16  # 65536 rows of 50 channels are 26 MB

_LISTED = 8  # series, and channels of one unit, that one line names
_UNIT_WORDS = {"": "an unknown unit", "1": "plain numbers"}

# Units that logs are written in: the SI unit of each, and the factor to it. A g is that of the firmware's estimator.
_SI: dict[str, tuple[str, float]] = {
    "g": ("m/s^2", USUAL_GRAVITY_MPS2),
    "deg": ("rad", math.pi / 180),
    "deg/s": ("rad/s", math.pi / 180),
    "mrad/s": ("rad/s", 1e-3),
    "rpm": ("rad/s", RPM),
    "mm": ("m", 1e-3),
    "mm/s": ("m/s", 1e-3),
    "mm/s^2": ("m/s^2", 1e-3),
    "mV": ("V", 1e-3),
    "mbar": ("Pa", 100.0),
    "gauss": ("T", 1e-4),
}


@dataclass(frozen=True)
class Channel:
    """A column of a log: its name, and its unit in the log.

    The unit is "1" for a plain number, "" where it is unknown; `scale` is one step of a count in that unit.
    """

    name: str
    own_unit: str = ""
    scale: float = 1.0

    @property
    def variable(self) -> str:
        """The name without the unit in brackets that ends it where the unit is not the variable's usual one."""
        return self.name.partition(" [")[0]

    @property
    def unit(self) -> str:
        """The SI unit."""
        return _SI.get(self.own_unit, (self.own_unit, 1.0))[0]

    @property
    def factor(self) -> float:
        """The ratio of the value in its SI unit to the raw number."""
        return self.scale * _SI.get(self.own_unit, ("", 1.0))[1]


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Channels that were sampled together.

    `blocks()` yields arrays (m, 1 + channels) in order: time in s by the log's clock, then raw numbers, NaN where the
    log has none.
    """

    name: str
    rows: int
    channels: tuple[Channel, ...]
    blocks: Callable[[], Iterator[Array]]

    @property
    def names(self) -> tuple[str, ...]:
        """The channels' names."""
        return tuple(channel.name for channel in self.channels)

    @property
    def variables(self) -> tuple[str, ...]:
        """The names of the channels' variables."""
        return tuple(channel.variable for channel in self.channels)

    def place_of(self, name: str) -> int:
        """Return the position of a channel, by its name or variable. Raises ValueError for another name."""
        return (self.names if name in self.names else self.variables).index(name)

    @property
    def time_s(self) -> Array:
        """The times (rows,) in s by the log's clock."""
        return self.column(0)

    def values(self, name: str) -> Array:
        """Return a channel (rows,) in its SI unit, by its name or variable. Raises ValueError for another name."""
        place = self.place_of(name)
        column = self.column(1 + place)
        column *= self.channels[place].factor
        return column

    def column(self, place: int) -> Array:
        """Return raw numbers (rows,): the times for place 0, then the channels. A large column takes no memory."""
        found, begin = empty(self.rows), 0
        for block in self.blocks():
            found[begin : begin + len(block)] = block[:, place]
            begin += len(block)
        return found

    def between(self, begin_s: float, end_s: float) -> "Series":
        """Return the rows between two times."""
        none = np.zeros((0, 1 + len(self.channels)))
        inside = (block[(begin_s <= block[:, 0]) & (block[:, 0] <= end_s)] for block in self.blocks())
        kept = joined(chain([none], inside))
        return replace(self, rows=len(kept), blocks=lambda: iter([kept] if len(kept) else []))


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightLog:
    """A recording of a vehicle, or of another device, in one or several series.

    `program` names the format and its writer, `clock` states what the times are. `assumed` are sentences on what the
    file does not state, `notes` on what is damaged or missing.
    """

    path: Path
    source: Source
    program: str
    clock: str
    series: tuple[Series, ...]
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def channel(self, name: str) -> tuple[Array, Array]:
        """Return times (n,) in s and values (n,) in SI of a channel. Raises DataError as `series_of`."""
        series = self.series_of(name)
        return series.time_s, series.values(name)

    def series_of(self, name: str) -> Series:
        """Return the series with a channel, by its name or variable; of several, the one with most rows.

        Raises a DataError that names the channels of the log.
        """
        having = [series for series in self.series if name in {*series.names, *series.variables}]
        if not having:
            there = "; ".join(f"{series.name}: {', '.join(series.names)}" for series in self.series)
            raise DataError(f"{self.path}: no channel {name}; it has {there}.")
        return max(having, key=lambda one: one.rows)

    @property
    def understood(self) -> str:
        """One line: the format, and for each series its rows, rate and channels with their units as read."""
        first = sorted(self.series, key=lambda one: not any(channel.own_unit for channel in one.channels))[:_LISTED]
        more = f"; and {len(self.series) - _LISTED} more series" if len(self.series) > _LISTED else ""
        return f"{self.path.name}: {self.program}; {self.clock}; {'; '.join(map(_described, first))}{more}."


def in_memory(name: str, time_s: Array, channels: Sequence[Channel], values: Sequence[npt.NDArray[Any]]) -> Series:
    """Return a series of arrays (n,) of numbers of any type, one array per channel."""

    def blocks() -> Iterator[Array]:
        for begin in range(0, len(time_s), BLOCK_ROWS):
            part = slice(begin, begin + BLOCK_ROWS)
            yield np.column_stack([time_s[part], *(np.asarray(each[part], dtype=np.float64) for each in values)])

    return Series(name=name, rows=len(time_s), channels=tuple(channels), blocks=blocks)


def printable(text: str, length: int = 60) -> str:
    """Return a name from a file in a form for the terminal: without control characters, and of limited length."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)[:length]


def _described(series: Series) -> str:
    first = next(series.blocks(), np.zeros((0, 1)))[:, 0]
    steps = np.diff(first)
    rate = f" at {1 / np.median(steps[steps > 0]):.0f} Hz" if np.any(steps > 0) else ""
    by_unit: dict[str, list[str]] = {}
    for channel in series.channels:
        by_unit.setdefault(_UNIT_WORDS.get(channel.own_unit, channel.own_unit), []).append(channel.name)
    columns = ", ".join(f"{_listed(names)} in {unit}" for unit, names in by_unit.items()) or "times alone"
    return f"{series.name}, {counted(series.rows, 'row')}{rate}: {columns}"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return " ".join(names[:_LISTED]) + more
