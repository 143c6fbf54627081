"""Convert a recording: choose the files to write, and leave none half written."""

import contextlib
import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Literal

from cfid.errors import ConfigError
from cfid.interchange.recording import Recording
from cfid.interchange.writers import write_csv, write_mat, write_mcap, write_parquet
from cfid.records.files import refuse_kept
from cfid.records.logs.log import Series

Format = Literal["csv", "parquet", "mat", "mcap"]

_OF_SERIES: Mapping[str, Callable[[Series, Recording, Path], None]] = {"csv": write_csv, "parquet": write_parquet}
_OF_RECORDING: Mapping[str, Callable[[Recording, Path], None]] = {"mat": write_mat, "mcap": write_mcap}


def convert(recording: Recording, to: Format, out: Path | None) -> list[Path]:
    """Write a recording and return its files: one, or for several series as CSV or Parquet one each, in a folder.

    `out` is that file or folder; by default it is in the current folder and named after the recording. Raises
    ConfigError when it exists or cannot be written, DataError where the format cannot hold the recording; no file is
    left behind in either case.
    """
    if to in _OF_RECORDING:
        path = out or Path(f"{recording.name}.{to}")
        return [_written(path, partial(_OF_RECORDING[to], recording))]
    write = _OF_SERIES[to]
    if len(recording.series) == 1:
        path = out or Path(f"{recording.name}.{to}")
        return [_written(path, partial(write, recording.series[0], recording))]
    folder = out or Path(f"{recording.name}-{to}")
    try:
        refuse_kept(folder)
        folder.mkdir()
    except FileExistsError:
        raise ConfigError(f"{folder}: exists already, and is left as it is: give another `out`.") from None
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be created: {error.strerror}.") from None
    paths: list[Path] = []
    try:
        for series in recording.series:
            path = folder / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', series.name)}.{to}"
            paths.append(_written(path, partial(write, series, recording)))
    except BaseException:
        for path in paths:
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            folder.rmdir()
        raise
    return paths


def _written(path: Path, write: Callable[[Path], None]) -> Path:
    if path.exists() or path.is_symlink():
        raise ConfigError(f"{path}: exists already, and is left as it is: give another `out`.")
    try:
        refuse_kept(path)
        write(path)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}.") from None
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return path
