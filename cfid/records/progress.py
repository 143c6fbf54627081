"""A run's progress: what its recorder has counted so far, in a hidden file that exists only while it records."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from cfid.records.files import read_small, write_whole

PROGRESS_FILE = ".progress.json"

_Count = Annotated[int, Field(ge=0)]
_Finite = Annotated[float, Field(ge=0, allow_inf_nan=False)]


@dataclass(frozen=True, kw_only=True)
class Counts:
    """A device's rows, the samples that are missing (None: unknown), and its rows per second in the last second."""

    rows: _Count
    lost: _Count | None
    rate_hz: _Finite


@dataclass(frozen=True, kw_only=True)
class RunProgress:
    """How much longer a recording will last, None where that is unknown, and the counts of its devices by name."""

    left_s: _Finite | None = None
    devices: dict[str, Counts] = field(default_factory=dict)


_CONTENT = TypeAdapter(RunProgress)  # checks what is read: nothing that a recorder counts may end its recording


def write_progress(folder: Path, progress: RunProgress) -> None:
    """Write the progress of a run. Raises OSError."""
    write_whole(folder / PROGRESS_FILE, _CONTENT.dump_json(progress), synced=False)


def read_progress(folder: Path) -> RunProgress:
    """Return the progress of a run; an empty one where no recorder wrote any, or the file is damaged."""
    try:
        return _CONTENT.validate_json(read_small(folder / PROGRESS_FILE))
    except (OSError, ValidationError):
        return RunProgress()
