"""Read a table of any kind, for notebooks."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, overload

from cfid.errors import ConfigError
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from cfid.recordings.sines import CrossingRecord, PingRecord, read_crossings, read_pings
from cfid.recordings.wrench import WrenchRecord, wrench_of
from cfid.records.tables.angle import AngleRecord, Reading, read_angle
from cfid.records.tables.stand import StandTable, read_stand_table

_READERS: Mapping[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "angle": (
        tuple(field.name for field in fields(Reading)),
        lambda path, **settings: read_angle(path, Reading(**settings)),
    ),
    "wrench": (
        tuple(field.name for field in fields(How)),
        lambda path, **settings: wrench_of(read_recording(path, How(**settings)), How(**settings)),
    ),
    "crossings": ((), read_crossings),
    "pings": ((), read_pings),
    "stand": (("gravity_mps2", "rate_hz", "skip_lines", "time_unit", "esc_us", "motors"), read_stand_table),
}


@overload
def read_table(path: str | Path, *, kind: Literal["angle"], **settings: Any) -> AngleRecord: ...
@overload
def read_table(path: str | Path, *, kind: Literal["wrench"], **settings: Any) -> WrenchRecord: ...
@overload
def read_table(path: str | Path, *, kind: Literal["crossings"], **settings: Any) -> CrossingRecord: ...
@overload
def read_table(path: str | Path, *, kind: Literal["pings"], **settings: Any) -> PingRecord: ...
@overload
def read_table(path: str | Path, *, kind: Literal["stand"], **settings: Any) -> StandTable: ...
def read_table(path: str | Path, *, kind: str, **settings: Any) -> Any:
    """Read a CSV file, or a run folder, of a kind: angles, forces and torques, crossings, pings, or a stand's table.

    `settings` state what a file does not: `time_unit` ("s", "ms", "us"), `rate_hz`, `skip_lines`, `columns` ("t,phi"
    or a tuple); for angles `angle_unit` and `counts_per_turn`; for forces `units` by column, `counts_per_n` and
    `counts_per_nm`; for a stand `gravity_mps2`, `esc_us` and `motors`.
    Raises ConfigError for an unknown kind or setting, DataError with file, line and next step.
    """
    if kind not in _READERS:
        raise ConfigError(f"kind '{kind}': unknown; the kinds are {', '.join(_READERS)}.")
    known, read = _READERS[kind]
    unknown = sorted(settings.keys() - set(known))
    if unknown:
        raise ConfigError(f"{kind}: no setting {', '.join(unknown)}; the settings are {', '.join(known) or 'none'}.")
    if isinstance(columns := settings.get("columns"), str):
        settings["columns"] = tuple(name.strip() for name in columns.split(","))
    return read(Path(path), **settings)
