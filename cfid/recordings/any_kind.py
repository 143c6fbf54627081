"""Read a table of any kind, for notebooks."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, overload

from cfid.errors import ConfigError
from cfid.recordings.recording import How
from cfid.recordings.stand import StandTable, read_stand, stand_of
from cfid.records.tables.angle import AngleRecord, Reading, read_angle
from cfid.records.tables.crossings import CrossingRecord, read_crossings
from cfid.records.tables.pings import PingRecord, read_pings
from cfid.records.tables.wrench import WrenchReading, WrenchRecord, read_wrench
from cfid.units import USUAL_GRAVITY_MPS2


def _read_stand(path: Path, *, gravity_mps2: float = USUAL_GRAVITY_MPS2, **settings: Any) -> StandTable:
    how = How(**settings)
    return stand_of(read_stand(path, how), how, gravity_mps2=gravity_mps2)


_READERS: Mapping[str, tuple[tuple[str, ...], Callable[..., Any]]] = {
    "angle": (
        tuple(field.name for field in fields(Reading)),
        lambda path, **settings: read_angle(path, Reading(**settings)),
    ),
    "wrench": (
        tuple(field.name for field in fields(WrenchReading)),
        lambda path, **settings: read_wrench(path, WrenchReading(**settings)),
    ),
    "crossings": (("time_unit",), read_crossings),
    "pings": ((), read_pings),
    "stand": (
        ("gravity_mps2", *(field.name for field in fields(How))),
        _read_stand,
    ),
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
    or a tuple); for angles `angle_unit` and `counts_per_turn`; for forces `units`, `counts_per_n`, `counts_per_nm`; for
    a stand all fields of `How`, and `gravity_mps2`.
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
