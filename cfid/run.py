"""A run folder: one recording, its run.toml and one plain CSV file per device.

run.toml says `state = "recording"` until the run is closed; a run found in that state was cut, and what
reached the disk is read with a word about it. What the columns mean is `recording`'s business.
"""

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Annotated, Any, Literal, Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from cfid.durable import alone_in, first_fault, read_toml, write_toml
from cfid.errors import ConfigError, DataError
from cfid.rows import RowFile

RUN_FILE = "run.toml"
FORMAT = 1

_RESERVE_FILE = ".reserve"
_RESERVE_BYTES = 16384  # more than run.toml takes, in blocks of any file system

State = Literal["recording", "complete", "interrupted", "failed"]


_Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
_Count = Annotated[int, Field(strict=True, ge=0)]
_FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]*\.csv$")]  # in this folder, and no other file
_ColumnName = Annotated[str, Field(pattern=r"^[^\s,;\"][^\t\r\n,;\"]*$")]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


class Label(_Section):
    """What the operator said the run is: mount, weight, body, a note."""

    axis: str | None = None
    weight_g: _Positive | None = None
    body: Literal["crazyflie", "testbody", "fixture"] | None = None
    note: str | None = None


class DeviceRecord(_Section):
    """One device's file: its columns as the device said them, and the scale that turns counts into SI."""

    file: _FileName
    columns: tuple[_ColumnName, ...] = Field(min_length=1)
    counts_per_turn: _Positive | Literal["rls-13bit-in-22"] | None = None
    rows: _Count | None = None
    lost: _Count = 0


class RunHeader(_Section):
    """Everything run.toml says."""

    format: int = FORMAT
    kind: str
    started: AwareDatetime
    state: State
    reason: str = ""
    cfid_version: str = ""
    simulated: bool = False
    excluded: str = ""  # the reason why no fit takes it unless it is named
    label: Label = Label()
    asked: dict[str, Any] = {}
    devices: dict[str, DeviceRecord] = {}


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run folder that was read."""

    folder: Path
    header: RunHeader

    @property
    def cut(self) -> bool:
        """Whether the recording ended without being closed."""
        return self.header.state == "recording"

    def device_file(self, device: str) -> Path:
        """Return the path of a device's CSV file.

        Raises DataError when the run has no such device.
        """
        if device not in self.header.devices:
            present = ", ".join(self.header.devices) or "no device at all"
            raise DataError(f"{self.folder}: holds no {device} recording, but {present}.")
        return self.folder / self.header.devices[device].file


def read_run(folder: Path) -> Run:
    """Read a run folder's run.toml.

    Raises DataError when it is missing or makes no sense.
    """
    path = folder / RUN_FILE
    try:
        content = read_toml(path, DataError)
    except FileNotFoundError:
        raise DataError(f"{folder}: no run: it has no {RUN_FILE}.") from None
    written = content.get("format")
    if isinstance(written, int) and written > FORMAT:
        raise DataError(f"{path}: written by a newer cfid (format {written}, this one reads {FORMAT}): update cfid.")
    try:
        header = RunHeader.model_validate(content)
    except ValidationError as error:
        raise DataError(f"{path}: {first_fault(error, content)}") from None
    return Run(folder=folder, header=header)


def amend_run(run: Run, *, excluded: str | None = None, note: str | None = None) -> Run:
    """Write into run.toml why fits shall leave a run out ("" takes that back), or another note; rows stay as they are.

    What run.toml says by now stays, whatever it said when the run was read. Raises DataError when the file cannot be
    written.
    """
    try:
        with alone_in(run.folder):
            header = read_run(run.folder).header
            if excluded is not None:
                header = header.model_copy(update={"excluded": excluded})
            if note is not None:
                header = _noted(header, note or None)
            _write_header(run.folder, header)
    except OSError as error:
        raise DataError(f"{run.folder / RUN_FILE}: cannot be written: {error.strerror}. It is as it was.") from None
    return Run(folder=run.folder, header=header)


def _noted(header: RunHeader, note: str | None) -> RunHeader:
    return header.model_copy(update={"label": header.label.model_copy(update={"note": note})})


def list_runs(runs_folder: Path) -> list[Run | DataError]:
    """Return all runs of a campaign by name, those that cannot be read as the error that says why."""
    found: list[Run | DataError] = []
    for path in sorted(runs_folder.glob(f"*/{RUN_FILE}")):
        try:
            found.append(read_run(path.parent))
        except DataError as error:
            found.append(error)
    return found


@dataclass
class RunWriter:
    """A run being recorded. Made by `create_run`; used as a context manager it always closes itself.

    Blocks are written as they come, so that a killed process costs at most the block in hand.
    """

    folder: Path
    header: RunHeader
    _files: dict[str, RowFile] = field(default_factory=dict)
    _facts: dict[str, dict[str, Any]] = field(default_factory=dict)
    _fault: str = ""

    def append(self, device: str, columns: Sequence[Sequence[float] | Any]) -> None:
        """Write one block of a device, given as columns of equal length: time in seconds, then raw values.

        Raises DataError when the disk does not take it; the run can then only be closed, and is failed.
        """
        if self.header.state != "recording" or self._fault:
            raise ValueError(f"{self.folder} takes no more rows: {self._fault or self.header.state}")
        try:
            self._files[device].append(columns)
        except DataError as error:
            self._fault = str(error)
            raise

    def sync(self) -> None:
        """Bring what was written so far to the disk itself; slow, and safe to call from another thread."""
        for file in self._files.values():
            file.sync()

    def rows(self, device: str) -> int:
        """Return how many rows of a device were written."""
        return self._files[device].rows

    def describe(self, device: str, facts: Mapping[str, Any]) -> None:
        """Add to what run.toml will say of a device once the run is closed."""
        self._facts.setdefault(device, {}).update(facts)

    def count_lost(self, device: str, samples: int) -> None:
        """Count samples of a device that are known to be missing; run.toml says them however the run ends."""
        self._files[device].lost += samples

    def close(self, state: State, *, reason: str = "", lost: Mapping[str, int] | None = None) -> Run:
        """End the run and replace run.toml by its final form; a run whose disk failed it is failed in any case.

        Raises DataError when that cannot be written: run.toml then still says that the run is recording.
        """
        if self.header.state != "recording":
            raise ValueError(f"{self.folder} is closed already")
        for device, samples in (lost or {}).items():
            self.count_lost(device, samples)
        for file in self._files.values():
            file.close()
        devices = {name: self._closed(name, record) for name, record in self.header.devices.items()}
        if self._fault:
            state, reason = "failed", self._fault
        final = self.header.model_copy(update={"state": state, "reason": reason, "devices": devices})
        try:
            (self.folder / _RESERVE_FILE).unlink(missing_ok=True)
            with alone_in(self.folder):
                final = self._amended(final)
                _write_header(self.folder, final)
        except OSError as error:
            path = self.folder / RUN_FILE
            raise DataError(
                f"{path}: cannot be written: {error.strerror}. It says that the run was cut; its rows are there."
            ) from None
        self.header = final
        return Run(folder=self.folder, header=self.header)

    def _amended(self, final: RunHeader) -> RunHeader:
        """Return a header with what the operator wrote into run.toml while the run was being recorded."""
        try:
            written = read_run(self.folder).header
        except DataError:
            return final
        return _noted(final, written.label.note).model_copy(update={"excluded": written.excluded})

    def _closed(self, name: str, record: DeviceRecord) -> DeviceRecord:
        file = self._files[name]
        return record.model_copy(update={**self._facts.get(name, {}), "rows": file.rows, "lost": file.lost})

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close a run that nobody closed: complete, interrupted by Ctrl-C, or failed with the reason."""
        if self.header.state != "recording":
            return
        if error is None:
            self.close("complete")
            return
        stopped = isinstance(error, KeyboardInterrupt)
        with contextlib.suppress(DataError):  # the first error is the one to be told
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
    asked: Mapping[str, Any] = MappingProxyType({}),
) -> RunWriter:
    """Make a new run folder named after its start, kind and label, and open its files.

    Raises ConfigError when it cannot be made; never touches a folder that is there already.
    """
    stem = "_".join(filter(None, [f"{started:%Y-%m-%d_%H%M%S}", kind, _label_words(label)]))
    header = RunHeader(
        kind=kind,
        started=started,
        state="recording",
        cfid_version=cfid_version,
        simulated=simulated,
        label=label,
        asked=dict(asked),
        devices=dict(devices),
    )
    folder = _new_folder(runs_folder, re.sub(r"[^A-Za-z0-9_.+-]", "-", stem))
    writer = RunWriter(folder=folder, header=header)
    try:
        _write_header(folder, header)
        # A full disk must not keep run.toml from saying so at the end.
        (folder / _RESERVE_FILE).write_bytes(bytes(_RESERVE_BYTES))
        for name, record in devices.items():
            writer._files[name] = RowFile.create(folder / record.file, record.columns)
    except OSError as error:
        for file in writer._files.values():
            file.close()
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
            raise ConfigError(f"{folder}: cannot be made: {error.strerror}.") from None
        return folder
    raise ConfigError(f"{runs_folder}: a thousand runs named {stem} are there already.")


def _label_words(label: Label) -> str:
    weight = f"{label.weight_g:g}g" if label.weight_g is not None else ""
    body = label.body if label.body not in (None, "crazyflie") else ""
    return "_".join(filter(None, [body, label.axis, weight]))


def _write_header(folder: Path, header: RunHeader) -> None:
    content = header.model_dump(mode="json", exclude_none=True)
    content["started"] = header.started
    write_toml(folder / RUN_FILE, content)
