"""Decide what a path is, a run folder or a table, and read it as a recording."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from cfid.errors import ConfigError
from cfid.recordings.recording import Column, Facts, How, Kind, Recording, Series
from cfid.recordings.table import read_table
from cfid.recordings.times import TIME, series_of
from cfid.records.files import RUN_FILE, sha256_of
from cfid.records.parameters import Source
from cfid.records.run import DeviceRecord, Run, losses, run_at

# The columns that `columns` names without a name for each, by how many there are.
_IN_ORDER: Mapping[bool, Mapping[int, tuple[str, ...]]] = {False: {1: (TIME,), 2: (TIME, "phi")}, True: {1: ("phi",)}}


def read_recording(path: Path | str, how: How | None = None, *, kind: Kind | None = None) -> Recording:
    """Read a run folder, whose series are read when they are asked for, or a table, which has times for most kinds.

    Raises DataError for what cannot be read, ConfigError for what `how` has to state.
    """
    path, how = Path(path), how or How()
    run = run_at(path)
    if run is not None:
        how.refuse_unused(path)
        return of_run(run)
    how = _with_names(how)
    table = read_table(path, how)
    series = series_of(table, how, name=path.stem, timed=kind in ("angle", "wrench"))
    return Recording(
        path=path,
        source=table.source,
        series={series.name: replace(series, findings=())},
        facts=Facts(program="table", begin_s=series.begin_s),
        findings=series.findings,
    )


def of_run(run: Run) -> Recording:
    """Return a run folder's recording, a series for each device that has rows, in the devices' own units."""
    header, path = run.header, run.folder / RUN_FILE
    readers = {
        device: partial(_device, run, device, record) for device, record in header.devices.items() if record.rows != 0
    }
    return Recording(
        path=run.folder,
        source=Source(str(path), sha256_of(path)),
        series=_Devices(readers),
        facts=Facts(
            label=header.label,
            begin_s=header.started.timestamp(),
            clock="computer" if header.origin is None else header.origin.clock,
            simulated=header.simulated,
        ),
        run=run,
    )


class _Devices(Mapping[str, Series]):
    """The series of a run folder, each read when it is first asked for."""

    def __init__(self, readers: Mapping[str, Callable[[], Series]]) -> None:
        self._readers = readers
        self._read: dict[str, Series] = {}

    def __getitem__(self, device: str) -> Series:
        if device not in self._read:
            self._read[device] = self._readers[device]()
        return self._read[device]

    def __iter__(self) -> Iterator[str]:
        return iter(self._readers)

    def __len__(self) -> int:
        return len(self._readers)


def _device(run: Run, device: str, record: DeviceRecord) -> Series:
    """Read a device's file; its columns keep their names."""
    table = read_table(run.device_file(device), of_run=True)
    units = record.channel_units or {}
    columns = tuple(
        replace(one, name=one.head, unit="s" if one.head == TIME else units.get(one.head) or _unit(device, one, record))
        for one in table.columns
    )
    series = series_of(replace(table, columns=columns), How(), name=device)
    place = f"{run.folder.resolve().name}/{record.file}"
    lost = (one.at(run.folder.resolve().name) for one in losses(run, record, series.rows))
    return replace(series, findings=(*lost, *(one.at(place) for one in series.findings)))


def _unit(device: str, column: Column, record: DeviceRecord) -> str:
    """Return the unit of a column of a device, "" where only the device's reader knows it."""
    if device == "encoder" and column.head != TIME:
        return "counts" if record.counts_per_turn else str((record.model_extra or {}).get("angle_unit") or "")
    return column.unit


def _with_names(how: How) -> How:
    """Return settings in which every column of `columns` has a name, that of the kind with as many columns."""
    if not how.columns or any("=" in word for word in how.columns):
        return how
    names = _IN_ORDER[how.rate_hz is not None].get(len(how.columns))
    if names is None:
        raise ConfigError(
            f"`columns` {','.join(how.columns)}: name each, as in t=1,phi=2; without names they are time and angle.",
            code="columns",
        )
    return replace(how, columns=tuple(f"{name}={word}" for name, word in zip(names, how.columns, strict=True)))
