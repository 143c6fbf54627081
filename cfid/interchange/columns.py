"""Choose which columns become a device of a run: those without gaps, those with the same gaps, changing commands."""

import hashlib
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.records.logs.log import Array, Series

Mask = npt.NDArray[np.bool_]


def finite_columns(series: Series) -> tuple[Mask, list[list[str]]]:
    """Return which columns (1 + channels,) have only finite numbers, and the names of those with some, grouped by gaps.

    Raises DataError where a time is missing or earlier than the one before it.
    """
    whole, some = np.ones(1 + len(series.names), dtype=bool), np.zeros(1 + len(series.names), dtype=bool)
    patterns = [hashlib.sha256() for _ in whole]
    last = -np.inf
    for block in series.blocks():
        finite = np.isfinite(block)
        whole &= finite.all(axis=0)
        some |= finite.any(axis=0)
        if not whole[0] or np.any(np.diff(block[:, 0], prepend=last) < 0):
            raise DataError("its times go back, or are missing.")
        last = block[-1, 0]
        for place in np.flatnonzero(~whole):
            patterns[place].update(last.tobytes() + np.packbits(finite[:, place]).tobytes())
    gaps: dict[bytes, list[str]] = {}
    for place in np.flatnonzero(some & ~whole):
        gaps.setdefault(patterns[place].digest(), []).append(series.names[place - 1])
    return whole, list(gaps.values())


def chosen_columns(series: Series, chosen: Mask) -> Iterator[Array]:
    """Yield the chosen columns (1 + channels,) of a series, in blocks (m, c)."""
    for block in series.blocks():
        yield block[:, chosen]


def known_rows(series: Series, names: Sequence[str]) -> Iterator[Array]:
    """Yield time and channels (m, 1 + c) that have the same gaps, in the rows where they have finite numbers."""
    places = [1 + series.names.index(name) for name in names]
    for block in series.blocks():
        yield block[np.isfinite(block[:, places[0]])][:, [0, *places]]


def changes(series: Series, motors: Sequence[str]) -> Iterator[Array]:
    """Yield the rows (m, 5) in which a motor's command differs from that of the row before."""
    places = [0, *(1 + series.names.index(name) for name in motors)]
    last = np.full((1, len(motors)), np.nan)
    for block in series.blocks():
        rows = block[:, places]
        changed = np.any(rows[:, 1:] != np.vstack([last, rows[:-1, 1:]]), axis=1)
        last = rows[-1:, 1:]
        yield rows[changed]
