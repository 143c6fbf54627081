"""Report what run.toml and a run's folder show about a recording: how it ended, what it lost, and where it lies."""

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from cfid.counted import counted
from cfid.errors import DataError
from cfid.records.files import first_fault
from cfid.records.run import RUN_FILE, DeviceRecord, Run, read_run

SIMULATED = "recorded on the simulated rig."
_LOST, _NEVER_TAKEN = "lost while recording", "never taken"


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


def run_at(path: Path) -> Run | None:
    """Return the run in a folder, or None where the path is not a folder.

    Raises DataError when it cannot be read.
    """
    try:
        is_run = path.is_dir()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    return read_run(path) if is_run else None


def file_name(path: Path, *, own: bool) -> str:
    """Return a file's name, preceded by the name of its run where it belongs to one."""
    return f"{path.resolve().parent.name}/{path.name}" if own else path.name


def losses(run: Run, record: DeviceRecord, rows: int) -> list[str]:
    """Return notes on a device's recording: cut or failed, samples lost or never taken, rows changed, simulated."""
    notes = []
    if run.cut:
        or_not_yet = ", or is still being recorded" if run.grows else ""
        notes.append(f"the run was cut{or_not_yet}; the rows on disk are used.")
    if run.header.state == "failed":
        notes.append(f"the run failed ({run.header.reason or 'no reason given'}); the recorded rows are used.")
    if record.lost:
        notes.append(f"{counted(record.lost, 'sample was', 'samples were')} {_LOST}.")
    if record.lost is None and not run.cut and run.header.origin is None:
        notes.append("how many samples are missing is unknown.")
    if record.achieved:
        notes.append(
            f"{counted(record.skipped or 0, 'sample was', 'samples were')} {_NEVER_TAKEN} ({record.achieved}): the "
            "device or this computer was slow."
        )
    if record.rows is not None and record.rows != rows:
        notes.append(
            f"{counted(record.rows, 'row was', 'rows were')} recorded, but {record.file} has {rows}: the file "
            "was changed since."
        )
    if run.header.simulated:
        notes.append(SIMULATED)
    return notes


def is_loss(note: str) -> bool:
    """Return whether a note of `losses` reports only that samples were lost or never taken."""
    return _LOST in note or _NEVER_TAKEN in note


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
