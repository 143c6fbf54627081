"""A run folder as it is found: one recording, its run.toml and one plain CSV file per device.

run.toml says `state = "recording"` until the run is closed; a run found in that state was cut, and what
reached the disk is read with a word about it. What the columns mean is `recording`'s business, and how a run is
written is `run_writer`'s.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from cfid.errors import DataError
from cfid.records.facts import NONE_STATED, RigFacts
from cfid.records.files import alone_in, first_fault, read_toml, write_toml

if TYPE_CHECKING:
    from pandas import DataFrame

RUN_FILE = "run.toml"
FORMAT = 1

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
    rig: RigFacts = NONE_STATED  # as rig.toml stated them then
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

    def frame(self, device: str) -> "DataFrame":
        """Return a device's rows in SI units over `t`, in seconds from the first row of the run.

        Raises DataError when the run has no such device, or its file cannot be understood.
        """
        from cfid.records.tables.frames import frame  # the readers of tables know runs

        return frame(self, device)

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
                header = noted(header, note or None)
            write_header(run.folder, header)
    except OSError as error:
        raise DataError(f"{run.folder / RUN_FILE}: cannot be written: {error.strerror}. It is as it was.") from None
    return Run(folder=run.folder, header=header)


def noted(header: RunHeader, note: str | None) -> RunHeader:
    """Return a header with another note."""
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


def write_header(folder: Path, header: RunHeader) -> None:
    """Write run.toml whole. Raises OSError."""
    content = header.model_dump(mode="json", exclude_none=True)
    content["started"] = header.started
    content.pop("rig")
    if header.rig.stated:
        content["rig"] = header.rig.stated
    write_toml(folder / RUN_FILE, content)
