"""A CSV file during recording, to which only whole rows of numbers are appended."""

import contextlib
import errno
import itertools
import os
from collections.abc import Sequence
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError

_LOSSES = (errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EROFS)  # a flush's other errors: the file system has no flush


class RowFile:
    """A new CSV file with a header, open for rows; `rows` were written, `lost` samples are missing (None: unknown).

    Writing is unbuffered, so that a killed process loses no row that was appended. Times are written
    to the microsecond, finer than almost any stamp, or with `all_digits`, as another program recorded them.
    """

    def __init__(self, path: Path, raw: FileIO, columns: Sequence[str], *, all_digits: bool = False) -> None:
        """Wrap an empty file that is open for writing; `create` makes one."""
        self.path, self.columns, self._all_digits = path, tuple(columns), all_digits
        self.rows = self._written = 0
        self.lost: int | None = 0
        self._raw = raw

    @classmethod
    def create(cls, path: Path, columns: Sequence[str], *, all_digits: bool = False) -> "RowFile":
        """Create the file, open for appending, and write its header. Raises OSError, also when the file exists."""
        file = cls(path, FileIO(path, "xb", opener=_appending), columns, all_digits=all_digits)
        try:
            file._write((",".join(columns) + "\n").encode())
        except OSError:
            file._raw.close()
            raise
        file.rows = 0
        return file

    def append(self, columns: Sequence[Sequence[float] | Any]) -> None:
        """Append rows, given as columns of equal length: time in seconds, then raw values.

        Raises DataError when the disk takes only part of the rows, where the file then ends with the last whole row,
        or when the file was removed, cut or moved.
        """
        if len(columns) != len(self.columns) or len({len(column) for column in columns}) != 1:
            raise ValueError(f"{self.path.name} has the columns {self.columns}, each as long as the others")
        if gone := self._gone():
            raise DataError(f"{self.path}: {gone}")
        try:
            self._write(_lines(columns, all_digits=self._all_digits))
        except OSError as error:
            # a file system that became read-only after an error drops what was written but not flushed
            kept = "of which the disk may lack the last" if self._flush_fault() else "which are kept"
            raise DataError(
                f"{self.path}: {error.strerror} after {self.rows} rows, {kept}: the recording ends there."
            ) from None

    def _gone(self) -> str:
        """Return what happened to a file that is no longer complete or at its path, "" for one that is."""
        own, rows = os.fstat(self._raw.fileno()), counted(self.rows, "row")
        if own.st_nlink == 0:
            return f"was removed during the recording, with its {rows}: record it again."
        if own.st_size < self._written:
            return f"was cut by another program during the recording, with its {rows}: record it again."
        try:
            moved = not os.path.samestat(own, self.path.stat())
        except OSError:
            moved = True
        return f"was moved during the recording, with its {rows}: the recording ends there." if moved else ""

    def sync(self) -> None:
        """Flush the rows so far to the disk; slow, so callers run it in a thread."""
        with contextlib.suppress(OSError, ValueError):  # a file closed meanwhile was flushed already
            os.fsync(self._raw.fileno())

    def close(self) -> str:
        """Flush the rows to the disk and close the file; return the reason where the disk lost any, else ""."""
        if self._raw.closed:
            return ""
        fault = self._flush_fault()
        with contextlib.suppress(OSError):
            self._raw.close()
        return fault and f"{self.path}: {fault} when its rows were flushed to the disk: compare its end."

    def _flush_fault(self) -> str:
        """Flush the rows to the disk, and return why it lost any, "" where it lost none."""
        try:
            os.fsync(self._raw.fileno())
        except OSError as error:
            return os.strerror(error.errno) if error.errno in _LOSSES else ""
        return ""

    def _write(self, block: bytes) -> None:
        """Write lines; when writing fails, the file ends with the last whole line."""
        written = 0
        try:
            while written < len(block):
                written += self._raw.write(memoryview(block)[written:])
        finally:
            whole = block.rfind(b"\n", 0, written) + 1
            self._written += whole
            self.rows += block.count(b"\n", 0, whole)
            if written > whole:
                with contextlib.suppress(OSError):  # the reader leaves out a partial row
                    self._raw.truncate(self._raw.tell() - (written - whole))


def _appending(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_APPEND, 0o666)


def _lines(columns: Sequence[Sequence[float] | Any], *, all_digits: bool) -> bytes:
    """Format all rows at once: at 7000 rows a second, a call per field would cost more than all the rest."""
    times = np.asarray(columns[0], dtype=np.float64)
    if not np.all(np.isfinite(times)):
        raise ValueError("a time is a finite number")
    raw = [np.asarray(column) for column in columns[1:]]
    forms = ("%d" if np.issubdtype(column.dtype, np.integer) else "%s" for column in raw)
    line = ",".join(["%s" if all_digits else "%.6f", *forms])
    fields = [_exact(times) if all_digits else times.tolist(), *(_exact(column) for column in raw)]
    return ((line + "\n") * len(times) % tuple(itertools.chain.from_iterable(zip(*fields, strict=True)))).encode()


def _exact(column: Any) -> list[Any]:
    return column.tolist() if np.issubdtype(column.dtype, np.integer) else [_shortest(x) for x in column.tolist()]


def _shortest(value: float) -> str:
    return str(int(value)) if isinstance(value, int) or value.is_integer() else repr(value)
