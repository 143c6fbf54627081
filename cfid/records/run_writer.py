"""Record a run: create its folder, append rows, and close it however the recording ends."""

import contextlib
import errno
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

from cfid.errors import ConfigError, DataError
from cfid.records.facts import NONE_STATED, RigFacts
from cfid.records.files import held, locked_folder
from cfid.records.row_file import RowFile
from cfid.records.run import (
    RECORDER_FILE,
    RUN_FILE,
    DeviceRecord,
    Label,
    Origin,
    Run,
    RunHeader,
    State,
    read_run,
    with_note,
    write_header,
)

_RESERVE_FILE = ".reserve"
_RESERVE_BYTES = 16384  # more than run.toml takes, in blocks of any file system


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

    def sync(self) -> None:
        """Flush everything written so far to the disk; slow, and safe to call from another thread."""
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
        with contextlib.suppress(OSError):  # a file left there is harmless
            (self.folder / RECORDER_FILE).unlink()
        self.header = final
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
    """Create a run folder named after its start, kind and label, and open its files.

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
    folder = _new_folder(runs_folder, re.sub(r"[^A-Za-z0-9_.+-]", "-", stem))
    try:
        writer = RunWriter(folder=folder, header=header, _made=folder.stat())
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be read: {error.strerror}.") from None
    try:
        writer._held.enter_context(held(folder / RECORDER_FILE))  # before run.toml, by which others find the run
        write_header(folder, header)
        # Reserved, so that run.toml can state the reason at the end even where the disk is full.
        (folder / _RESERVE_FILE).write_bytes(bytes(_RESERVE_BYTES))
        for name, record in devices.items():
            writer._files[name] = RowFile.create(folder / record.file, record.columns, all_digits=origin is not None)
            if origin is not None:
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
            folder.mkdir(parents=True)
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
