"""Decide what a path is, a run folder or a table, and read it as a recording."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from cfid.errors import ConfigError, DataError
from cfid.recordings.recording import Facts, How, Recording, Series
from cfid.recordings.table import read_table
from cfid.recordings.times import TIME, series_of
from cfid.recordings.wrench import AXES, described_above
from cfid.records.files import RUN_FILE, check_regular, sha256_of
from cfid.records.parameters import Source
from cfid.records.run import DeviceRecord, Run, run_at


def read_recording(path: Path | str, how: How | None = None) -> Recording:
    """Read a run folder, whose series are read when they are asked for, or a table.

    Raises DataError for what cannot be read, ConfigError for what `how` has to state, or states and nothing uses.
    """
    path, how = Path(path), how or How()
    run = run_at(path)
    if run is not None:
        how.refuse_unused(path)
        return of_run(run)
    how = _with_names(how)
    try:
        check_regular(path)
        table, how = described_above(read_table(path, how), how)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.", code="no-file") from None
    series = series_of(table, how, name=path.stem, timed=False)
    return Recording(
        path=path,
        source=table.source,
        series={series.name: replace(series, findings=())},
        facts=Facts(program="table", begin_s=series.begin_s),
        findings=series.findings,
    )


def _with_names(how: How) -> How:
    """Return settings in which every column of `columns` has a name, that of the kind with as many columns."""
    if not how.columns or any("=" in word for word in how.columns):
        return how
    names = AXES if how.rate_hz is not None else (TIME, *AXES)
    if len(names) != len(how.columns):
        raise ConfigError(f"`columns` {','.join(how.columns)}: name each, as in t=1,Fz=4.", code="columns")
    return replace(how, columns=tuple(f"{name}={word}" for name, word in zip(names, how.columns, strict=True)))


def of_run(run: Run) -> Recording:
    """Return a run folder's recording, a series for each device that has rows, in the devices' own units."""
    path = run.folder / RUN_FILE
    devices = {name: partial(_device, run, name, one) for name, one in run.header.devices.items() if one.rows != 0}
    return Recording(
        path=run.folder,
        source=Source(str(path), sha256_of(path)),
        series=_Devices(devices),
        facts=Facts(
            label=run.header.label,
            begin_s=run.header.started.timestamp(),
            clock="computer",
            simulated=run.header.simulated,
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
    units = "n,nm" if (record.model_extra or {}).get("units") == "n,nm" else "counts"
    of_axis = {axis: units if units == "counts" else "N" if axis[0] == "F" else "N m" for axis in AXES}
    columns = tuple(
        replace(one, name=one.head, unit="s" if one.head == TIME else of_axis.get(one.head, one.unit))
        for one in table.columns
    )
    return series_of(replace(table, columns=columns), How(), name=device)
