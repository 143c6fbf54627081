"""Record a run: create its folder, append whole rows to CSV files, and close it however the recording ends."""

import contextlib
import errno
import itertools
import os
import re
import shutil
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from io import FileIO
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import numpy as np

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.records.files import RUN_FILE, held, locked_folder
from cfid.records.progress import PROGRESS_FILE, RunProgress, write_progress
from cfid.records.rig_file import NONE_STATED, RigFacts
from cfid.records.run import (
    RECORDER_FILE,
    DeviceRecord,
    Label,
    Origin,
    Run,
    RunHeader,
    State,
    next_number,
    read_run,
    with_note,
    write_header,
)

_RESERVE_FILE = ".reserve"
_RESERVE_BYTES = 16384  # more than run.toml takes, in blocks of any file system
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


@dataclass
class RunWriter:
    """A run being recorded, made by `create_run`; as a context manager, it always closes itself.

    Blocks are written as they arrive, so that a killed process loses at most the current block.
    """

    folder: Path
    header: RunHeader
    _made: os.stat_result
    _files: dict[str, RowFile] = field(default_factory=dict)
    _facts: dict[str, dict[str, Any]] = field(default_factory=dict)
    _held: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)  # until run.toml states the end
    _fault: str = ""
    _progress_lock: threading.Lock = field(default_factory=threading.Lock)

    def append(self, device: str, columns: Sequence[Sequence[float] | Any]) -> None:
        """Write one block of a device, given as columns of equal length: time in seconds, then raw values.

        Raises DataError when writing fails; the run can then only be closed, with the state failed.
        """
        if self.header.state != "recording" or self._fault:
            raise ValueError(f"{self.folder} takes no more rows: {self._fault or self.header.state}")
        try:
            self._files[device].append(columns)
        except DataError as error:
            self._fault = str(error)
            raise

    def sync(self, progress: RunProgress) -> None:
        """Write the progress of the recording, and flush all rows so far to the disk.

        Slow, and safe to call from another thread, also while the run is closed.
        """
        with self._progress_lock, contextlib.suppress(OSError):  # a progress that is not shown ends no recording
            if self.header.state == "recording" and os.path.samestat(self._made, self.folder.stat()):
                write_progress(self.folder, progress)
        for file in self._files.values():
            file.sync()

    def rows(self, device: str) -> int:
        """Return how many rows of a device were written."""
        return self._files[device].rows

    def describe(self, device: str, facts: Mapping[str, Any]) -> None:
        """Add facts of a device, which are written to run.toml when the run is closed."""
        self._facts.setdefault(device, {}).update(facts)

    def count_lost(self, device: str, samples: int | None) -> None:
        """Count samples of a device that are missing, None where their number is unknown, as it then remains.

        run.toml states the sum however the run ends.
        """
        file = self._files[device]
        file.lost = None if samples is None or file.lost is None else file.lost + samples

    def close(self, state: State, *, reason: str = "", lost: Mapping[str, int] | None = None) -> Run:
        """Close the run and write its final run.toml; after a failed write, the state is always failed.

        Raises DataError when run.toml cannot be written: it then still has the state recording.
        """
        if self.header.state != "recording":
            raise ValueError(f"{self.folder} is closed already")
        for device, samples in (lost or {}).items():
            self.count_lost(device, samples)
        losses = list(filter(None, [file.close() for file in self._files.values()]))
        self._fault = self._fault or " ".join(losses)
        devices = {name: self._closed(name, record) for name, record in self.header.devices.items()}
        if self._fault:
            state, reason = "failed", self._fault
        final = self.header.model_copy(update={"state": state, "reason": reason, "devices": devices})
        try:
            if not os.path.samestat(self._made, self.folder.stat()):  # another folder has its name
                raise FileNotFoundError(errno.ENOENT, "the run's folder was moved")
            (self.folder / _RESERVE_FILE).unlink(missing_ok=True)
            with locked_folder(self.folder):
                final = self._amended(final)
                write_header(self.folder, final)
        except OSError as error:
            path, rows = self.folder / RUN_FILE, self._fault or "Its rows are kept."
            raise DataError(f"{path}: cannot be written: {error.strerror}. The run counts as cut. {rows}") from None
        finally:
            self._held.close()
        self.header = final
        with self._progress_lock, contextlib.suppress(OSError):  # files left there are harmless
            (self.folder / RECORDER_FILE).unlink(missing_ok=True)
            (self.folder / PROGRESS_FILE).unlink(missing_ok=True)
        return Run(folder=self.folder, header=self.header)

    def _amended(self, final: RunHeader) -> RunHeader:
        """Return a header with the operator's changes to run.toml during the recording."""
        try:
            written = read_run(self.folder).header
        except DataError:
            return final
        return with_note(final, written.label.note).model_copy(update={"excluded": written.excluded})

    def _closed(self, name: str, record: DeviceRecord) -> DeviceRecord:
        file = self._files[name]
        return record.model_copy(update={**self._facts.get(name, {}), "rows": file.rows, "lost": file.lost})

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close a run that is still open: complete, interrupted by Ctrl-C, or failed with the reason."""
        if self.header.state != "recording":
            return
        if error is None:
            self.close("complete")
            return
        stopped = isinstance(error, KeyboardInterrupt)
        with contextlib.suppress(DataError):  # the first error is the one to report
            if stopped:
                self.close("interrupted", reason="stopped by the operator")
            else:
                self.close("failed", reason=str(error) or type(error).__name__)


def create_run(
    runs_folder: Path,
    *,
    kind: str,
    label: Label,
    devices: Mapping[str, DeviceRecord],
    started: datetime,
    cfid_version: str,
    simulated: bool = False,
    facts: RigFacts = NONE_STATED,
    requested: Mapping[str, Any] = MappingProxyType({}),
    origin: Origin | None = None,
) -> RunWriter:
    """Create a run folder named after its start, kind and label, with the next number, and open its files.

    Raises ConfigError when it cannot be created; never touches an existing folder.
    """
    stem = "_".join(filter(None, [f"{started:%Y-%m-%d_%H%M%S}", kind, _label_text(label)]))
    header = RunHeader(
        kind=kind,
        started=started,
        state="recording",
        cfid_version=cfid_version,
        simulated=simulated,
        label=label,
        rig=facts,
        asked=dict(requested),
        origin=origin,
        devices={name: record.model_copy(update={"lost": None}) for name, record in devices.items()},
    )
    try:
        runs_folder.mkdir(parents=True, exist_ok=True)
        with locked_folder(runs_folder):  # so that two runs that begin at once have different numbers
            folder = _new_folder(runs_folder, re.sub(r"[^A-Za-z0-9_.+-]", "-", stem))
            header = header.model_copy(update={"number": next_number(runs_folder)})
            return _opened(RunWriter(folder=folder, header=header, _made=folder.stat()), devices)
    except OSError as error:
        raise ConfigError(f"{runs_folder}: cannot be created: {error.strerror}.") from None


def _opened(writer: RunWriter, devices: Mapping[str, DeviceRecord]) -> RunWriter:
    """Write run.toml and open the devices' files. Raises ConfigError; then nothing of the run is left."""
    folder, imported = writer.folder, writer.header.origin is not None
    try:
        writer._held.enter_context(held(folder / RECORDER_FILE))  # before run.toml, by which others find the run
        write_header(folder, writer.header)
        # Reserved, so that run.toml can state the reason at the end even where the disk is full.
        (folder / _RESERVE_FILE).write_bytes(bytes(_RESERVE_BYTES))
        for name, record in devices.items():
            writer._files[name] = RowFile.create(folder / record.file, record.columns, all_digits=imported)
            if imported:
                writer.count_lost(name, None)
    except OSError as error:
        for file in writer._files.values():
            file.close()
        writer._held.close()
        shutil.rmtree(folder, ignore_errors=True)  # nothing was recorded, and an empty run would stay in every list
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}.") from None
    return writer


def _new_folder(runs_folder: Path, stem: str) -> Path:
    for attempt in range(1, 1000):
        folder = runs_folder / (stem if attempt == 1 else f"{stem}-{attempt}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be created: {error.strerror}.") from None
        return folder
    raise ConfigError(f"{runs_folder}: a thousand runs named {stem} exist already.")


def _label_text(label: Label) -> str:
    weight = f"{label.weight_g:g}g" if label.weight_g is not None else ""
    body = label.body if label.body not in (None, "crazyflie") else ""
    return "_".join(filter(None, [body, label.axis, weight]))
