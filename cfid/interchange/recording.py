"""A recording as it is converted: the series of a run's devices, or of a file that another program wrote."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cfid.errors import ConfigError, DataError
from cfid.records.files import sha256_of
from cfid.records.logs.any_kind import read_log
from cfid.records.logs.log import Array, Channel, Series
from cfid.records.run import RUN_FILE, Run, read_run
from cfid.records.tables.blocks import table_blocks
from cfid.records.tables.schema import TIME, Foreign
from cfid.records.tables.times import CUT_LINE, losses


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Series with raw numbers in the units of whoever recorded them; `origin` are texts that files keep with them."""

    name: str
    series: tuple[Series, ...]
    origin: Mapping[str, str]
    understood: str
    notes: tuple[str, ...]


def recording_at(path: Path, reading: Foreign) -> Recording:
    """Read a run folder, or a file of any kind. Raises DataError or ConfigError as its reader."""
    if path.is_dir():
        if reading.clock is not None:
            raise ConfigError(f"{path}: --clock is for a log; the times of a run are as they were taken.")
        return _of_run(read_run(path))
    log = read_log(path, reading)
    facts = {"file": path.name, "sha256": log.source.sha256, "program": log.program, "clock": log.clock}
    assumed = f" Assumed: {', '.join(log.assumed)}." if log.assumed else ""
    return Recording(
        name=path.stem, series=log.series, origin=facts, understood=f"{log.understood}{assumed}", notes=log.notes
    )


def _of_run(run: Run) -> Recording:
    series: list[Series] = []
    notes: list[str] = []
    for device, record in run.header.devices.items():
        if record.rows == 0:
            notes.append(f"{device} has no rows.")
            continue
        path = run.device_file(device)
        try:
            one, cut = _of_device(device, path)
        except DataError as fault:  # a fault in one device does not hide the others
            notes.append(f"{device} is left out: {fault}")
            continue
        series.append(one)
        notes += [f"{device}: {note}" for note in (*losses(run, record, one.rows), *((CUT_LINE,) if cut else ()))]
    if not series:
        raise DataError(f"{run.folder}: nothing to convert. {' '.join(notes)}")
    rows = ", ".join(f"{one.name} {one.rows} rows" for one in series)
    return Recording(
        name=run.folder.resolve().name,
        series=tuple(series),
        origin={"run": run.folder.resolve().name, RUN_FILE: (run.folder / RUN_FILE).read_text(encoding="utf-8")},
        understood=f"{run.folder.name}: a run of cfid, in the devices' own units: {rows}.",
        notes=tuple(dict.fromkeys(notes)),
    )


def _of_device(device: str, path: Path) -> tuple[Series, bool]:
    sha256 = sha256_of(path)
    rows, cut = 0, False
    names: tuple[str, ...] = ()
    for table in table_blocks(path, sha256=sha256):
        names, cut = table.names, table.cut
        rows += len(table.numbers(names)) if table.filled else 0
    if names[0] != TIME:
        raise DataError(f"{path}: its first column is not the time '{TIME}': it is not a device's file of a run.")
    channels = tuple(map(Channel, names[1:]))
    return Series(name=device, rows=rows, channels=channels, blocks=partial(_blocks, path, sha256)), cut


def _blocks(path: Path, sha256: str) -> Iterator[Array]:
    for table in table_blocks(path, sha256=sha256):
        if table.filled:
            yield table.numbers(table.names)
