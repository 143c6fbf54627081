"""Read channels of a log part by part, so that a log may be larger than the memory."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from cfid.records.logs.log import Array, FlightLog, Series


class Timed(NamedTuple):
    """A channel's values (n,) in SI units at times (n,) in s by the log's clock."""

    time_s: Array
    value: Array


def windows(log: FlightLog, names: Sequence[str], *, from_s: float, long_s: float) -> Iterator[Mapping[str, Timed]]:
    """Yield channels in parts of length `long_s`, the first from `from_s` on; it also has all rows before that.

    Raises DataError for a channel that the log does not have.
    """
    series: dict[Series, list[str]] = {}
    for name in names:
        series.setdefault(log.series_of(name), []).append(name)
    cuts = [_cut(one, of_one, from_s, long_s) for one, of_one in series.items()]
    for parts in zip_longest(*cuts):
        found: dict[str, Timed] = {}
        for rows, of_one in zip(parts, series.values(), strict=True):
            columns = np.zeros((0, 1 + len(of_one))) if rows is None else rows
            found |= {name: Timed(columns[:, 0], columns[:, 1 + at]) for at, name in enumerate(of_one)}
        yield found


def _cut(series: Series, names: Sequence[str], from_s: float, long_s: float) -> Iterator[Array]:
    """Yield the rows (n, 1 + names) of each part, times first."""
    places = [0, *(1 + series.place_of(name) for name in names)]
    factors = [1.0, *(series.channels[place - 1].factor for place in places[1:])]
    kept, end_s = [np.zeros((0, len(places)))], from_s + long_s
    for block in series.blocks():
        rows = block[:, places] * factors
        while rows[-1, 0] >= end_s:
            first = int(np.searchsorted(rows[:, 0], end_s))
            yield np.concatenate([*kept, rows[:first]])
            kept, rows, end_s = [], rows[first:], end_s + long_s
        kept.append(rows)
    yield np.concatenate(kept)
