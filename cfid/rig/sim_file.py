"""Reads and writes rig.sim.toml, which points commands at a simulated rig while that rig's process lives."""

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from cfid.errors import ConfigError
from cfid.records.files import first_fault, read_toml, write_toml
from cfid.records.rig_file import Devices, Rig

SIM_FILE = "rig.sim.toml"


class _SimFile(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    process: int
    seed: int
    devices: Devices


def devices_in(folder: Path, rig: Rig) -> tuple[Devices, bool]:
    """Return the addresses of a campaign's devices, and whether they are simulated.

    A rig.sim.toml whose process has ended is ignored. Raises ConfigError when it is invalid.
    """
    path = folder / SIM_FILE
    if not _is_held(path):
        return rig.devices, False
    try:
        content = read_toml(path, ConfigError)
    except FileNotFoundError:  # it ended just now
        return rig.devices, False
    try:
        return _SimFile.model_validate(content).devices, True
    except ValidationError as error:
        raise ConfigError(f"{path}: {first_fault(error, content)}") from None


def is_left_behind(folder: Path) -> bool:
    """Return whether a campaign has a rig.sim.toml whose process has ended."""
    path = folder / SIM_FILE
    return path.is_file() and not _is_held(path)


@contextlib.contextmanager
def published(folder: Path, devices: Devices, *, seed: int) -> Iterator[Path]:
    """Write rig.sim.toml and lock it; delete it at the end.

    Raises ConfigError when another simulated rig holds it, or it cannot be written.
    """
    path = folder / SIM_FILE
    if _is_held(path):
        raise ConfigError(f"{path}: another simulated rig serves this campaign. End that one first.")
    content = {"process": os.getpid(), "seed": seed, "devices": devices.model_dump(mode="json", exclude_none=True)}
    try:
        write_toml(path, content)
        handle = _locked(path, fcntl.LOCK_EX)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}.") from None
    try:
        yield path
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        os.close(handle)


def _is_held(path: Path) -> bool:
    """Return whether a process has locked the file."""
    try:
        os.close(_locked(path, fcntl.LOCK_SH | fcntl.LOCK_NB))
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False


def _locked(path: Path, kind: int) -> int:
    """Open and lock the file: the lock ends with its process, however that ends."""
    handle = os.open(path, os.O_RDWR)
    try:
        fcntl.flock(handle, kind)
    except OSError:
        os.close(handle)
        raise
    return handle
