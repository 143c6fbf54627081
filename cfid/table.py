"""Reading columns of numbers from a CSV file that anyone may have written, with every fault named by line.

Knows separators, heads and cut files; what the columns mean is `recording`'s business.
"""

import hashlib
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A CSV file opened but not yet parsed: column names ('1', '2', ... without a head) and its body."""

    path: Path
    sha256: str
    names: tuple[str, ...]
    has_head: bool
    cut: bool
    _body: str
    _first_line: int
    _separator: str

    def numbers(self, columns: Sequence[str]) -> Array:
        """Return the named columns, shape (rows, columns).

        Raises DataError naming the line of the first field that is no finite number.
        """
        import pandas as pd  # half of the start-up time of a fit, and not needed to refuse a bad head

        missing = [name for name in columns if name not in self.names]
        if missing:
            raise DataError(f"{self.path}: no column '{missing[0]}'; it has {', '.join(self.names)}.")
        try:
            frame = pd.read_csv(
                io.StringIO(self._body),
                sep=self._separator,
                header=None,
                names=list(self.names),
                index_col=False,
                usecols=list(columns),
                dtype=np.float64,
                skipinitialspace=True,
                float_precision="high",
            )
        except (ValueError, OverflowError):
            raise self._first_fault(columns) from None
        values: Array = frame[list(columns)].to_numpy()
        if not np.all(np.isfinite(values)):
            raise self._first_fault(columns)
        return values

    def line_of_row(self, row: int) -> int:
        """Return the line of the file, counted from 1, that holds a row, counted from 0."""
        filled = [i for i, line in enumerate(self._body.split("\n")) if line.strip()]
        return self._first_line + filled[row]

    def _first_fault(self, columns: Sequence[str]) -> DataError:
        places = [self.names.index(name) for name in columns]
        for i, line in enumerate(self._body.split("\n")):
            fields = _fields(line, self._separator)
            if not line.strip():
                continue
            where = f"{self.path}:{self._first_line + i}"
            if len(fields) > len(self.names):
                return DataError(f"{where}: {len(fields)} fields where the file has {len(self.names)} columns.")
            for place, name in zip(places, columns, strict=True):
                field = fields[place] if place < len(fields) else ""
                if not _is_number(field) or not np.isfinite(float(field)):
                    return DataError(f"{where}: '{field}' in column '{name}' is no number. Repair or cut that line.")
        return DataError(f"{self.path}: not readable as a table of numbers.")


def open_table(path: Path, *, skip_lines: int = 0) -> Table:
    """Open a CSV file: comma, semicolon, tab or spaces, with or without a head of one line.

    A last line without its newline is left out (a cut number reads as a plausible one) and `cut` says so.

    Raises DataError when the file is missing, empty or no table of numbers.
    """
    content = _content(path)
    text = content.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    whole, newline, rest = text.rpartition("\n")
    cut = bool(rest.strip())
    lines = (whole + newline).split("\n")
    if skip_lines >= len(lines) - 1:
        raise DataError(f"{path}: nothing but {len(lines) - 1} lines, of which --skip-lines leaves out {skip_lines}.")
    first = next((i for i in range(skip_lines, len(lines)) if lines[i].strip()), None)
    if first is None:
        raise DataError(f"{path}: empty but for blank lines; nothing was recorded.")
    separator = _separator(lines[first])
    head = [field.strip().strip('"') for field in _fields(lines[first], separator)]
    has_head = not all(_is_number(field) for field in head)
    body_line = first + 1 if has_head else first
    body = "\n".join(lines[body_line:])
    if not body.strip():
        raise DataError(f"{path}: a head and no rows; nothing was recorded.")
    _check_table(path, lines, first, separator, has_head)
    return Table(
        path=path,
        sha256=hashlib.sha256(content).hexdigest(),
        names=tuple(head) if has_head else tuple(str(i + 1) for i in range(len(head))),
        has_head=has_head,
        cut=cut,
        _body=body,
        _first_line=body_line + 1,
        _separator=separator,
    )


def _content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.") from None
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}.") from None
    if not content.strip():
        raise DataError(f"{path}: empty; nothing was recorded.")
    if b"\0" in content[:65536]:
        raise DataError(f"{path}: no CSV file: it holds binary data.")
    return content


def _check_table(path: Path, lines: list[str], first: int, separator: str, has_head: bool) -> None:
    """Refuse what has no row of numbers where the first row should be."""
    at = next(i for i in range(first + int(has_head), len(lines)) if lines[i].strip())
    if not any(_is_number(field) for field in _fields(lines[at], separator)):
        raise DataError(
            f"{path}: no CSV file of numbers: line {at + 1} reads '{lines[at].strip()[:40]}'. "
            "A longer head can be left out with --skip-lines."
        )


def _separator(line: str) -> str:
    for separator in (",", ";", "\t"):
        if separator in line:
            return separator
    return r"\s+"


def _fields(line: str, separator: str) -> list[str]:
    return re.split(separator, line.strip()) if separator == r"\s+" else line.split(separator)


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True
