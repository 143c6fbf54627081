"""A run's progress: what its recorder has counted so far, in a hidden file that exists only while it records."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from cfid.records.files import read_small, write_whole

PROGRESS_FILE = ".progress.json"

_Count = Annotated[int, Field(ge=0)]


class Counts(BaseModel):
    """A device's rows, the samples that are missing (None: unknown), and its rows per second in the last second."""

    model_config = ConfigDict(frozen=True)

    rows: _Count
    lost: _Count | None
    rate_hz: Annotated[float, Field(ge=0, allow_inf_nan=False)]


_DEVICES = TypeAdapter(dict[str, Counts])


def write_progress(folder: Path, devices: Mapping[str, Counts]) -> None:
    """Write the counts of a run's devices, by their names. Raises OSError."""
    write_whole(folder / PROGRESS_FILE, _DEVICES.dump_json(dict(devices)))


def read_progress(folder: Path) -> dict[str, Counts]:
    """Return the counts of a run's devices; none where no recorder wrote any, or the file is damaged."""
    try:
        return _DEVICES.validate_json(read_small(folder / PROGRESS_FILE))
    except (OSError, ValidationError):
        return {}
