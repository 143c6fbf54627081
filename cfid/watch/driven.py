"""Finds the vehicles that runs being recorded drive, by the addresses that their devices state in run.toml."""

from functools import lru_cache
from pathlib import Path

from cfid.errors import DataError
from cfid.records.files import RUN_FILE
from cfid.records.run import RunHeader, read_run
from cfid.rig.lock import resolved, vehicles_locked

_MOST_RUNS = 4096  # whose run.toml is remembered


def vehicles_of(header: RunHeader) -> tuple[str, ...]:
    """Return the addresses of the vehicles among a run's devices: each device that uses one states it."""
    stated = [(device.model_extra or {}).get("uri") for device in header.devices.values()]
    return tuple(dict.fromkeys(uri for uri in stated if isinstance(uri, str)))


def vehicles_recorded(runs_folder: Path, *, besides: tuple[str, ...]) -> tuple[str, ...]:
    """Return the vehicles that a program on this computer holds for a run of a folder, except those in `besides`.

    A recorder that hangs holds its vehicle too; a run that was cut a week ago states "recording" and holds none.
    """
    held = {uri for uri in vehicles_locked() if uri not in {resolved(other) for other in besides}}
    if not held:
        return ()
    found: dict[str, None] = {}
    for path in sorted(runs_folder.glob(f"*/{RUN_FILE}"), reverse=True):
        found.update(dict.fromkeys(uri for uri in _recorded(path) if resolved(uri) in held))
    return tuple(found)


def _recorded(path: Path) -> tuple[str, ...]:
    """Return the vehicles of the run that a run.toml describes, if that run is being recorded."""
    try:
        return _recorded_as(path, path.stat().st_mtime_ns)
    except (OSError, DataError):  # it is read again on the next call
        return ()


@lru_cache(maxsize=_MOST_RUNS)
def _recorded_as(path: Path, _changed_ns: int) -> tuple[str, ...]:
    run = read_run(path.parent)
    return vehicles_of(run.header) if run.cut else ()
