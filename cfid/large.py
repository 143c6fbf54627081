"""Arrays that may be larger than the memory: above a certain size they are kept in a temporary file."""

import math
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError

Array = npt.NDArray[np.float64]

PART_ROWS = 1 << 20  # 8 MB of one column

_LEAST_BYTES = 1 << 25  # a minute of forces at 7 kHz stays in memory


def empty(*shape: int) -> Array:
    """Return an uninitialized array of a shape. Raises ConfigError where the disk has too little space."""
    size = 8 * math.prod(shape)
    if size < _LEAST_BYTES:
        return np.empty(shape)
    with _file(size) as file:
        return _mapped(file, *shape)


def joined(blocks: Iterable[Array]) -> Array:
    """Return one or more blocks (m, k), concatenated. Raises ConfigError where the disk has too little space."""
    kept: list[Array] = []
    rest = iter(blocks)
    for block in rest:
        kept.append(block)
        if sum(each.nbytes for each in kept) >= _LEAST_BYTES:
            return _on_disk(chain(kept, rest))
    return kept[0] if len(kept) == 1 else np.concatenate(kept)


def stored(value: Array) -> Array:
    """Return an array, moved to a temporary file if it is large, so that it takes no memory. Raises as `empty` does."""
    if value.nbytes < _LEAST_BYTES:
        return value
    found = empty(*value.shape)
    found[...] = value
    return found


def as_columns(blocks: Iterable[Array], columns: int, *, most_rows: int) -> list[Array]:
    """Return blocks (m, columns), concatenated, as columns (n,), n being `most_rows` at most.

    Of large ones, each column lies by itself in a file, so that only those that are used take memory. Raises
    ConfigError where the disk has too little space.
    """
    kept: list[Array] = []
    rest = iter(blocks)
    for block in rest:
        kept.append(block)
        if sum(each.nbytes for each in kept) >= _LEAST_BYTES:
            break
    else:
        return list(np.ascontiguousarray(np.concatenate([np.empty((0, columns)), *kept]).T))
    with tempfile.TemporaryFile(prefix="cfid-") as file:
        rows = 0
        try:
            file.truncate(8 * columns * most_rows)  # without disk space for what is never written
            for block in chain(kept, rest):
                for place in range(columns):
                    part = np.ascontiguousarray(block[:, place])
                    os.pwrite(file.fileno(), part.data, 8 * (place * most_rows + rows))
                rows += len(block)
        except OSError as error:
            raise _no_room(error) from None
        mapped = _mapped(file, columns, most_rows)
    return [mapped[place, :rows] for place in range(columns)]


def side_by_side(columns: Sequence[Array]) -> Array:
    """Return s columns (n,) as one array (n, s). Raises as `empty` does."""
    if len(columns) == 1:
        return columns[0][:, np.newaxis]
    found = empty(len(columns[0]), len(columns))
    for at, column in enumerate(columns):
        found[:, at] = column
    return found


def chosen_rows(value: Array, rows: npt.NDArray[np.bool_]) -> Array:
    """Return the chosen rows of an array (n, ...), or the array itself if all rows are chosen."""
    return value if rows.all() else stored(value[rows])


def parts(rows: int) -> Iterator[slice]:
    """Yield consecutive slices of this number of rows, which are processed one after another."""
    for begin in range(0, rows, PART_ROWS):
        yield slice(begin, min(begin + PART_ROWS, rows))


def differences(value: Array, *, order: int = 1) -> Iterator[tuple[int, Array]]:
    """Yield the differences of a given order of a series (n,) in parts, each with the index of its first element."""
    for begin in range(0, len(value) - order, PART_ROWS):
        with np.errstate(over="ignore"):
            step = np.diff(value[begin : begin + PART_ROWS + order], n=order)
        yield begin, step


def some_steps(value: Array) -> Array:
    """Return the differences of neighbours of a series (n,); of a long series, a part of them."""
    several = len(value) // PART_ROWS + 1
    return np.concatenate([np.zeros(0), *(step[: PART_ROWS // several] for _, step in differences(value))])


def longest_step(value: Array) -> int:
    """Return the index of the element before the largest difference of neighbours of a series (n,)."""
    places = [begin + int(np.argmax(step)) for begin, step in differences(value)]
    return max(places, key=lambda place: float(value[place + 1] - value[place]))


def usual_step(value: Array) -> float:
    """Return the median of the positive differences that `some_steps` returns, NaN where none is positive."""
    steps = some_steps(value)
    return float(np.median(steps[steps > 0])) if np.any(steps > 0) else math.nan


def _on_disk(blocks: Iterator[Array]) -> Array:
    first = next(blocks)
    with _file(0) as file:
        try:
            size = sum(file.write(np.ascontiguousarray(block).data) for block in chain([first], blocks))
            file.flush()
        except OSError as error:
            raise _no_room(error) from None
        return _mapped(file, size // (8 * math.prod(first.shape[1:])), *first.shape[1:])


def _file(size: int) -> IO[bytes]:
    """Return an unnamed temporary file with its space reserved, since a write to a mapping dies on a full disk."""
    try:
        file = tempfile.TemporaryFile(prefix="cfid-")  # noqa: SIM115 - the caller closes it
        if sys.platform == "linux" and size:
            os.posix_fallocate(file.fileno(), 0, size)
        else:
            file.truncate(size)
    except OSError as error:
        raise _no_room(error) from None
    return file


def _mapped(file: IO[bytes], *shape: int) -> Array:
    mapped: np.memmap[Any, np.dtype[np.float64]] = np.memmap(file, np.float64, "r+", shape=shape)
    return np.asarray(mapped)


def _no_room(error: OSError) -> ConfigError:
    return ConfigError(
        f"{tempfile.gettempdir()}: no room for the numbers of a large recording: {error.strerror or error}. Set TMPDIR "
        "to a folder with room."
    )
