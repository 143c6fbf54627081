"""A run folder: one recording, its run.toml and one plain CSV file per device.

run.toml says `state = "recording"` until the run is closed; a run found in that state was cut, and what
reached the disk is read with a word about it. What the columns mean is `recording`'s business.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, Self

import tomli_w
from pydantic import BaseModel, ConfigDict, ValidationError

from cfid.durable import write_whole
from cfid.errors import ConfigError, DataError

RUN_FILE = "run.toml"
FORMAT = 1

State = Literal["recording", "complete", "interrupted", "failed"]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


class Label(_Section):
    """What the operator said the run is: mount, weight, body, a note."""

    axis: str | None = None
    weight_g: float | None = None
    body: Literal["crazyflie", "testbody", "fixture"] | None = None
    note: str | None = None


class DeviceRecord(_Section):
    """One device's file: its columns as the device said them, and the scale that turns counts into SI."""

    file: str
    columns: tuple[str, ...]
    counts_per_turn: float | str | None = None
    rows: int | None = None
    lost: int = 0


class RunHeader(_Section):
    """Everything run.toml says."""

    format: int = FORMAT
    kind: str
    started: datetime
    state: State
    reason: str = ""
    cfid_version: str = ""
    label: Label = Label()
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
        header = RunHeader.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise DataError(f"{folder}: no run: it has no {RUN_FILE}.") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise DataError(f"{path}: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        raise DataError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    if header.format > FORMAT:
        raise DataError(f"{path}: written by a newer cfid (format {header.format}, this one reads {FORMAT}).")
    return Run(folder=folder, header=header)


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

    Blocks are flushed as they come, so that a killed process costs at most the block in hand.
    """

    folder: Path
    header: RunHeader
    _files: dict[str, IO[str]] = field(default_factory=dict)
    _rows: dict[str, int] = field(default_factory=dict)

    def append(self, device: str, columns: Sequence[Sequence[float] | Any]) -> None:
        """Write one block of a device, given as columns of equal length: time in seconds, then raw values."""
        record = self.header.devices[device]
        if len(columns) != len(record.columns) or len({len(column) for column in columns}) != 1:
            raise ValueError(f"{device} has the columns {record.columns}, each as long as the others")
        texts = [
            [f"{value:.6f}" for value in columns[0]],
            *([_exact(value) for value in column] for column in columns[1:]),
        ]
        lines = [",".join(row) for row in zip(*texts, strict=True)]
        self._files[device].write("\n".join(lines) + "\n" if lines else "")
        self._files[device].flush()
        self._rows[device] += len(lines)

    def close(self, state: State, *, reason: str = "", lost: Mapping[str, int] | None = None) -> Run:
        """End the run and replace run.toml by its final form."""
        for file in self._files.values():
            file.close()
        devices = {
            name: record.model_copy(update={"rows": self._rows[name], "lost": (lost or {}).get(name, 0)})
            for name, record in self.header.devices.items()
        }
        self.header = self.header.model_copy(update={"state": state, "reason": reason, "devices": devices})
        _write_header(self.folder, self.header)
        return Run(folder=self.folder, header=self.header)

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
        elif isinstance(error, KeyboardInterrupt):
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
) -> RunWriter:
    """Make a new run folder named after its start, kind and label, and open its files.

    Raises ConfigError when it cannot be made; never touches a folder that is there already.
    """
    stem = "_".join(filter(None, [f"{started:%Y-%m-%d_%H%M%S}", kind, _label_words(label)]))
    folder = _new_folder(runs_folder, stem)
    header = RunHeader(
        kind=kind,
        started=started,
        state="recording",
        cfid_version=cfid_version,
        label=label,
        devices=dict(devices),
    )
    _write_header(folder, header)
    writer = RunWriter(folder=folder, header=header)
    for name, record in devices.items():
        file = (folder / record.file).open("x", encoding="utf-8", newline="\n")
        file.write(",".join(record.columns) + "\n")
        file.flush()
        writer._files[name] = file
        writer._rows[name] = 0
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


def _exact(value: float) -> str:
    return str(int(value)) if float(value).is_integer() else repr(float(value))


def _write_header(folder: Path, header: RunHeader) -> None:
    content = header.model_dump(mode="json", exclude_none=True)
    content["started"] = header.started
    write_whole(folder / RUN_FILE, tomli_w.dumps(content).encode())
