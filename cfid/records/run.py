"""A run folder: one recording, its run.toml and one plain CSV file per device.

run.toml has `state = "recording"` until the run is closed; a run found in that state was cut, and its rows on disk are
read with a note. A campaign's runs are ordered by the `number` in their run.toml, which no clock that was set back
turns around.
"""

import contextlib
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import (
    AliasChoices,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding
from cfid.records.files import (
    RUN_FILE,
    check_format,
    first_fault,
    is_held,
    locked_folder,
    read_small,
    read_toml,
    write_toml,
)
from cfid.records.rig_file import NONE_STATED, RigFacts

RECORDER_FILE = ".recording"  # held by the process that records the run
FORMAT = 1
UNKNOWN = "unknown"  # in run.toml: how many samples were lost

_NUMBER = re.compile(rb"^number = (\d{1,9})\r?$", re.MULTILINE)  # before the tables of run.toml
_NOTABLE_SKIPS = 0.01  # of the samples requested
_NOTABLE_LOSSES = 0.01  # of the samples expected: as many as `cfid rig check --signals` allows
_QUIET_S = 2.0  # a file that changed within this time counts as growing
State = Literal["recording", "complete", "interrupted", "failed"]


_Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
_Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_Spread = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Count = Annotated[int, Field(strict=True, ge=0)]
_FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]*\.csv$")]  # a CSV file, and only in this folder
_ColumnName = Annotated[str, Field(pattern=r"^[^\s,;\"][^\t\r\n,;\"]*$")]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


Pull = Literal["x", "-x", "y", "-y", "z", "-z"]


class Label(_Section):
    """The operator's label of a run: mount, weight, body and note.

    `pull` is the axis of the load cell along which gravity points, and `at_mm` where the weight hangs in the cell's
    frame; `..._std...` are standard uncertainties, `at_std_mm` along each axis.
    """

    axis: str | None = None
    weight_g: _Positive | None = None
    weight_std_g: _Spread | None = None
    body: Literal["crazyflie", "testbody", "fixture"] | None = None
    pull: Pull | None = None
    at_mm: tuple[_Finite, _Finite, _Finite] | None = None
    at_std_mm: _Spread | None = None
    note: str | None = None


class DeviceRecord(_Section):
    """One device's file: its columns in the device's own units, and the scale from counts to SI.

    `lost` samples were taken and are missing, None where that is unknown or the run is not closed; `skipped` ones, of a
    device polled at `rate_hz`, were never taken.
    `channel_units` has, by column, units of another program's recording that the column's name does not show.
    """

    file: _FileName
    columns: tuple[_ColumnName, ...] = Field(min_length=1)
    counts_per_turn: _Positive | Literal["rls-13bit-in-22"] | None = None
    rows: _Count | None = None
    lost: Annotated[_Count | None, BeforeValidator(lambda value: None if value == UNKNOWN else value)] = 0
    skipped: _Count | None = Field(None, validation_alias=AliasChoices("skipped", "grid_places_skipped"))
    rate_hz: _Positive | None = None
    channel_units: dict[str, str] | None = None

    @property
    def achieved(self) -> str:
        """The rate achieved as text, "462 of 1000 Hz", where at least one sample in a hundred was skipped; else ""."""
        taken, skipped = (self.rows or 0) + (self.lost or 0), self.skipped or 0
        if not skipped or skipped < _NOTABLE_SKIPS * (taken + skipped):
            return ""
        share = taken / (taken + skipped)
        return f"{100 * share:.0f} %" if self.rate_hz is None else f"{share * self.rate_hz:.0f} of {self.rate_hz:g} Hz"


Clock = Literal["computer", "true", "84/85", "unknown"]


class Origin(_Section):
    """The recording of another program that a run was imported from, and how it was read.

    `clock` is the rate of the clock of its times, `unknown` where that may be 84/85 of real time. With `props_out`, the
    rotors turn the other way than a Crazyflie's; `square` is whether they stand at the corners of a square, and
    `motors` the number of motors that ran. None means not stated.
    `times`, `assumed` and `notes` are sentences for people.
    """

    file: str
    sha256: str
    program: str
    clock: Clock | None = None
    props_out: bool | None = None
    square: bool | None = None
    motors: _Count | None = None
    times: str = ""
    assumed: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _of_version_0_2(cls, content: Any) -> Any:
        """Turn the sentences in which version 0.2 stated clock and rotors into typed facts."""
        if not isinstance(content, dict):
            return content
        text, assumed = content.get("clock"), content.get("assumed")
        facts = dict(content)
        if isinstance(text, str) and text not in get_args(Clock):
            rates = {"whether they run at 84/85": "unknown", "not corrected": "true", "85/84": "84/85"}
            facts["clock"] = next((rate for part, rate in rates.items() if part in text), None)
            facts["times"] = text
        if isinstance(assumed, list | tuple) and "props_out" not in content:
            other_way = [one for one in assumed if str(one).startswith("rotors turn the other way than a Crazyflie's")]
            facts["props_out"] = True if other_way else None
        notes = content.get("notes")
        if isinstance(notes, list | tuple) and "square" not in content:
            off = [note for note in notes if str(note).startswith("the rotors do not stand on a square")]
            facts["square"] = False if off else None
        return facts


class Verdict(_Section):
    """Whether a recording is usable, judged at its end by the code that fits it, and why."""

    usable: bool
    text: str


class RunHeader(_Section):
    """The contents of run.toml."""

    format: int = FORMAT
    kind: str
    number: Annotated[int, Field(strict=True, ge=1)] | None = None  # counts a campaign's runs; version 0.2 had none
    started: AwareDatetime
    state: State
    reason: str = ""
    cfid_version: str = ""
    simulated: bool = False
    excluded: str = ""  # the reason why fits leave it out unless it is named
    label: Label = Label()
    rig: RigFacts = NONE_STATED  # as rig.toml stated them at the time
    requested: dict[str, Any] = Field({}, alias="asked")  # its name in run.toml
    origin: Origin | None = None
    verdict: Verdict | None = None
    devices: dict[str, DeviceRecord] = {}

    @property
    def stated_sha256(self) -> str:
        """A checksum of what a fit may take from run.toml: all but verdict, exclusion, notes, and how the run ended."""
        beside = {"number", "verdict", "excluded", "state", "reason"}
        stated = with_note(self, None)  # a label of a note alone is then as none
        return sha256(stated.model_dump_json(exclude=beside, exclude_defaults=True).encode()).hexdigest()

    @property
    def lost(self) -> int | None:
        """How many samples of all devices are missing, None where that of any is unknown."""
        counts = [device.lost for device in self.devices.values()]
        return None if None in counts else sum(filter(None, counts))

    @property
    def family(self) -> str:
        """The kind without the part after an underscore, which numbers its runs: `sine` for `sine_l13`."""
        return self.kind.partition("_")[0]


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run folder that was read."""

    folder: Path
    header: RunHeader

    @property
    def cut(self) -> bool:
        """Whether the recording ended without being closed."""
        return self.header.state == "recording"

    @property
    def grows(self) -> bool:
        """Whether the run is being recorded: it was not closed, and a process is writing it."""
        return self.cut and is_written(self.folder)

    @property
    def what(self) -> str:
        """What was recorded, in a few words: kind, body, mount and weight."""
        label = self.header.label
        weight = None if label.weight_g is None else f"{label.weight_g:g} g"
        return " ".join(filter(None, [self.header.kind, label.body, label.axis, weight]))

    @property
    def rows(self) -> int | None:
        """The rows of all devices; None where no device states them."""
        known = [device.rows for device in self.header.devices.values() if device.rows is not None]
        return sum(known) if known else None

    @property
    def outcome(self) -> str:
        """The state; `cut` for a run neither closed nor being written, `not usable` for a complete run judged so."""
        state, verdict = self.header.state, self.header.verdict
        unusable = state == "complete" and verdict is not None and not verdict.usable
        if self.cut:
            return "recording" if self.grows else "cut"
        return "not usable" if unusable else state

    @property
    def place(self) -> tuple[int, float, str]:
        """The place among a campaign's runs: by number; those without one come before, by start and name."""
        return self.header.number or 0, self.header.started.timestamp(), self.folder.name

    @property
    def usable(self) -> bool:
        """Whether fits that select their own runs take this one: complete, not excluded, not judged unusable."""
        header = self.header
        fit = header.verdict is None or header.verdict.usable
        return header.state == "complete" and not header.excluded and fit

    def device_file(self, device: str) -> Path:
        """Return the path of a device's CSV file.

        Raises DataError when the run has no such device.
        """
        if device not in self.header.devices:
            present = ", ".join(self.header.devices) or "none"
            raise DataError(f"{self.folder}: holds no {device} recording; its devices: {present}.")
        return self.folder / self.header.devices[device].file


def read_run(folder: Path) -> Run:
    """Read a run folder's run.toml.

    Raises DataError when it is missing or invalid.
    """
    path = folder / RUN_FILE
    try:
        content = read_toml(path, DataError)
    except FileNotFoundError:
        raise DataError(f"{folder}: not a run: it has no {RUN_FILE}. Name a run (see `cfid runs`) or a file.") from None
    check_format(path, content.get("format", FORMAT), newest=FORMAT)
    try:
        header = RunHeader.model_validate(content)
    except ValidationError as error:
        raise DataError(f"{path}: {first_fault(error, content)}") from None
    return Run(folder=folder, header=header)


def run_at(path: Path) -> Run | None:
    """Return the run in a folder, or None where the path is not a folder.

    Raises DataError when it cannot be read.
    """
    try:
        is_run = path.is_dir()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    return read_run(path) if is_run else None


def run_holding(path: Path) -> Run | None:
    """Return the run whose folder or file a path is, None for any other path. Raises DataError as `read_run`."""
    folder = path if path.is_dir() else path.parent
    return read_run(folder) if (folder / RUN_FILE).is_file() else None


def refuse_contradiction(where: str, given: Mapping[str, object], own: Mapping[str, object]) -> None:
    """Raise ConfigError for the first given value that contradicts a run's own label.

    None means not stated; of a list that the label states, any member may be given.
    """
    for name, value in given.items():
        stated = own.get(name)
        allowed = stated if isinstance(stated, list | tuple) else [stated]
        if value is not None and stated is not None and value not in allowed:
            label = f"{name} {', '.join(map(str, allowed))}"
            raise ConfigError(
                f"{where}: {name} {value} contradicts the run's own label, {label}. Leave it out, or correct the label "
                "in run.toml."
            )


def by_name(text: str, runs_folder: Path) -> str:
    """Return a text in which the paths of a folder's runs are shortened to the names of the runs' own folders."""
    for folder in dict.fromkeys((str(runs_folder.resolve()), str(runs_folder))):
        text = text.replace(f"{folder}/", "")
    return text


def amend_run(run: Run, *, excluded: str | None = None, note: str | None = None, verdict: Verdict | None = None) -> Run:
    """Set in run.toml the reason to exclude a run from fits ("" includes it again) or its verdict, or add a note.

    An empty note removes all notes.

    Everything else stays as it is on disk, even where it changed after the run was read. Raises DataError when the
    file cannot be written.
    """
    try:
        with locked_folder(run.folder):
            header = read_run(run.folder).header
            if excluded is not None:
                header = header.model_copy(update={"excluded": excluded})
            if verdict is not None:
                header = header.model_copy(update={"verdict": verdict})
            if note is not None:
                header = with_note(header, "; ".join(filter(None, [header.label.note, note])) if note else None)
            write_header(run.folder, header)
    except OSError as error:
        raise DataError(f"{run.folder / RUN_FILE}: cannot be written: {error.strerror}. It is unchanged.") from None
    return Run(folder=run.folder, header=header)


def with_note(header: RunHeader, note: str | None) -> RunHeader:
    """Return a header with another note."""
    return header.model_copy(update={"label": header.label.model_copy(update={"note": note})})


def list_runs(runs_folder: Path) -> list[Run | DataError]:
    """Return the errors of a campaign's unreadable runs, then its runs, oldest first."""
    runs: list[Run] = []
    errors: list[Run | DataError] = []
    for path in sorted(runs_folder.glob(f"*/{RUN_FILE}")):
        try:
            runs.append(read_run(path.parent))
        except DataError as error:
            errors.append(error)
    return errors + sorted(runs, key=lambda run: run.place)


def number_of(folder: Path) -> int:
    """Return a run's number as far as its run.toml can be read, 0 for none."""
    with contextlib.suppress(OSError):
        found = _NUMBER.search(read_small(folder / RUN_FILE))
        return 0 if found is None else int(found[1])
    return 0


def next_number(runs_folder: Path) -> int:
    """Return one more than the largest number of a run there; the caller has locked the folder."""
    return 1 + max((number_of(path.parent) for path in runs_folder.glob(f"*/{RUN_FILE}")), default=0)


def is_written(folder: Path) -> bool:
    """Return whether a process is recording into a run's folder: it holds a lock there, even without any rows yet.

    Another computer may not see the lock, and version 0.1 took none: the times of the files then decide.
    """
    newest_s = max((file.stat().st_mtime for file in folder.glob("*.csv")), default=0.0)
    return is_held(folder / RECORDER_FILE) or time.time() - newest_s < _QUIET_S


def folders_without_run(runs_folder: Path) -> list[Path]:
    """Return the folders among a campaign's runs that have no run.toml, in the order of their names."""
    folders = sorted(path for path in runs_folder.glob("*/") if not path.name.startswith("."))
    return [folder for folder in folders if not (folder / RUN_FILE).is_file()]


_KINDS_OF_LOSS = ("losses", "arrivals")  # tables of a device


def write_header(folder: Path, header: RunHeader) -> None:
    """Write run.toml atomically, without what is empty and kinds of losses that did not happen. Raises OSError."""
    content = header.model_dump(mode="json", exclude_none=True, by_alias=True)
    content["started"] = header.started
    for name, device in content["devices"].items():
        device.setdefault("lost", UNKNOWN)
        kinds = {key: {kind: count for kind, count in device.get(key, {}).items() if count} for key in _KINDS_OF_LOSS}
        content["devices"][name] = {key: value for key, value in (device | kinds).items() if value not in ([], {})}
    del content["rig"]  # it goes to the end
    content["rig"] = header.rig.stated
    write_toml(folder / RUN_FILE, {name: value for name, value in content.items() if value not in ("", {})})


class Gap(BaseModel):
    """A span of Unix time in which a device delivered nothing, and why.

    `lost` is how many rows are missing by the device's own clock, None where the clock does not show it. With 0, no row
    is missing: all came late.
    """

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    from_s: float
    to_s: float
    reason: str
    lost: int | None = None


class Facts(BaseModel):
    """The further keys in run.toml of a device that samples by itself."""

    model_config = ConfigDict(frozen=True)

    gaps: tuple[Gap, ...] = ()


Kind = TypeVar("Kind", bound=Facts)


def file_name(path: Path, *, own: bool) -> str:
    """Return a file's name, preceded by the name of its run where it belongs to one."""
    return f"{path.resolve().parent.name}/{path.name}" if own else path.name


def losses(run: Run, record: DeviceRecord, rows: int) -> list[Finding]:
    """Return findings on a device's recording: cut or failed, samples lost or not taken, rows changed, simulated."""
    header = run.header
    findings = []
    if run.cut:
        findings.append(finding("recording-cut", or_grows=", or is still being recorded" if run.grows else ""))
    if header.state == "failed":
        findings.append(finding("recording-failed", reason=header.reason or "no reason given"))
    if record.lost:
        lost = finding("samples-lost", samples=counted(record.lost, "sample was", "samples were"))
        few = record.lost <= _NOTABLE_LOSSES * (record.lost + rows)
        findings.append(replace(lost, severity="note") if few else lost)
    if record.lost is None and not run.cut and header.origin is None:
        findings.append(finding("samples-lost-unknown"))
    if record.achieved:
        samples = counted(record.skipped or 0, "sample was", "samples were")
        findings.append(finding("samples-not-taken", samples=samples, achieved=record.achieved))
    if record.rows is not None and record.rows != rows:
        recorded = counted(record.rows, "row was", "rows were")
        findings.append(finding("rows-changed", recorded=recorded, file=record.file, rows=rows))
    if header.simulated:
        findings.append(finding("recording-simulated"))
    return findings


def facts_of(run: Run, device: str, kind: type[Kind]) -> Kind:
    """Return the further keys in run.toml of one of its devices. Raises DataError when they are invalid."""
    extra = run.header.devices[device].model_extra or {}
    try:
        return kind.model_validate(extra)
    except ValidationError as error:
        fault = first_fault(error, extra)
        raise DataError(f"{run.folder / RUN_FILE}: devices.{device}.{fault}") from None


def gaps(facts: Facts) -> list[str]:
    """Return a note on spans without samples, if there are any."""
    empty = [gap for gap in facts.gaps if gap.lost != 0]
    if not empty:
        return []
    reasons = ", ".join(dict.fromkeys(gap.reason for gap in empty))
    total_s = sum(gap.to_s - gap.from_s for gap in empty)
    return [f"no samples for {total_s:.1f} s in {counted(len(empty), 'gap')}: {reasons}."]
