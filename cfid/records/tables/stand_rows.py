"""Choose the rows of one motor in a table of motors, where a column of words distinguishes several."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.records.tables.stand_heads import heads_of
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.text import short

_ALL = "*"
_ROWS_A_MOTOR = 3
_BLOCKS = 0.5  # of the rows; more have a word where each row has its own
_OF_MOTORS = re.compile(r"prop|motor|rotor|blade|\bkv\b", re.IGNORECASE)
_SHARED = 0.5  # of the commands; rows of several motors share them, rows with remarks do not


class SeveralMotorsError(DataError):
    """Rows of one table may be of several motors, and no setting states which are meant."""


class Chosen(NamedTuple):
    """A table of some rows, the settings that name its columns, the columns by which rows were chosen, and notes."""

    table: CsvTable
    columns: tuple[str, ...]
    by: tuple[str, ...]
    notes: tuple[str, ...]


def with_rows(table: CsvTable, columns: Sequence[str]) -> Chosen:
    """Return the rows that `columns` choose by COLUMN=WORD, the word of a column of the file or * for all.

    Raises ConfigError for a word that no row has.
    """
    others, by, notes = [], [], []
    for pair in columns:
        name, _, word = (part.strip() for part in pair.partition("="))
        if heads_of([name]) or table.names.count(name) != 1:
            others.append(pair)
            continue
        by.append(name)
        if word == _ALL:
            continue
        words = _words(table, name)
        rest = np.flatnonzero(words != word)
        if len(rest) == len(words):
            raise ConfigError(f"{table.path}: `columns` {pair}: no row has that. '{name}' is {_listed(words)}.")
        table = table.without(rest)
        notes.append(f"{len(words) - len(rest)} of {len(words)} rows, whose '{name}' is '{word}' (`columns`).")
    return Chosen(table, tuple(others), tuple(by), tuple(notes))


def check_one_motor(table: CsvTable, command: Array, *, used: Sequence[str], settled: bool) -> None:
    """Raise SeveralMotorsError where a column of words, none of those `used`, divides rows (n,) of the same commands.

    Such rows are of several motors or propellers, or of sweeps up and down. In a recording, each group is one segment.
    A column that is named after motors or propellers may divide rows of any commands, and by numbers, too; a column of
    a known quantity, such as Motor Optical Speed (RPM), does not.
    """
    first = next(table.blocks(), table)
    for name in table.names:
        if not name or name in used or heads_of([name]) or table.names.count(name) != 1:
            continue
        is_motors = _OF_MOTORS.search(name) is not None
        if not is_motors and np.isfinite(first.known_numbers([name])).any():
            continue
        words = _words(table, name)
        one_after_another = settled or _are_stretches(words)
        if one_after_another and (_are_few(words) if is_motors else _divides(words, command)):
            which = words[words != ""][0]
            raise SeveralMotorsError(
                f"{table.path}: rows differ in '{name}' ({_listed(words)}): they may be of several motors, propellers "
                f"or runs. Choose one by `columns`, as in {name}={short(which)}, or take all as one motor's by "
                f"{name}={_ALL}."
            )


def _words(table: CsvTable, name: str) -> npt.NDArray[np.str_]:
    """Return a column's words (n,); words in only the first row of each block hold for the whole block."""
    words = np.array(table.words(name))
    filled = words != ""
    if not filled[0] or np.mean(filled) > _BLOCKS:
        return words
    return words[np.maximum.accumulate(np.where(filled, np.arange(len(words)), 0))]


def _are_few(words: npt.NDArray[np.str_]) -> bool:
    """Return whether there are several words, in enough rows each for a motor of its own."""
    stated = words[words != ""]
    return 2 <= len(np.unique(stated)) <= len(stated) / _ROWS_A_MOTOR


def _are_stretches(words: npt.NDArray[np.str_]) -> bool:
    """Return whether each word has a single segment of rows."""
    _, group = np.unique(words[words != ""], return_inverse=True)
    return len(group) > 0 and int(np.count_nonzero(np.diff(group))) == int(group.max())


def _divides(words: npt.NDArray[np.str_], command: Array) -> bool:
    """Return whether words (n,) divide rows into few groups that have most commands (n,) in common."""
    stated = (words != "") & np.isfinite(command)
    labels, group = np.unique(words[stated], return_inverse=True)
    if not _are_few(words[stated]):
        return False
    levels, level = np.unique(command[stated], return_inverse=True)
    groups_at = np.bincount(np.unique(level * len(labels) + group) // len(labels), minlength=len(levels))
    return bool(np.mean(groups_at > 1) >= _SHARED)


def _listed(words: npt.NDArray[np.str_]) -> str:
    return short(", ".join(dict.fromkeys(word for word in words.tolist() if word)), 120)
