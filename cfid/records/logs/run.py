"""Read a run folder as a log: a series for every device, in the device's own units."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

from cfid.errors import DataError
from cfid.records.files import RUN_FILE, sha256_of
from cfid.records.logs.crazyflie_names import assumptions, crazyflie_channel, stated_channel
from cfid.records.logs.log import Array, FlightLog, Series
from cfid.records.logs.spin import of_rotors
from cfid.records.parameters import Source
from cfid.records.run import Run, losses
from cfid.records.tables.blocks import open_table
from cfid.records.tables.schema import TIME
from cfid.records.tables.times import line_notes


def log_of_run(run: Run) -> FlightLog:
    """Return a run's devices as series. Raises DataError where none can be read; a note names each faulty one."""
    series: list[Series] = []
    notes: list[str] = []
    for device, record in run.header.devices.items():
        if record.rows == 0:
            notes.append(f"{device} has no rows.")
            continue
        try:
            one, lines = _of_device(device, run.device_file(device), record.channel_units or {})
        except DataError as fault:  # a fault in one device does not hide the others
            notes.append(f"{device} is left out: {fault}")
            continue
        series.append(one)
        lost = [found.sentence for found in losses(run, record, one.rows)]
        notes += [f"{device}: {note}" for note in (*lost, *lines)]
    if not series:
        raise DataError(f"{run.folder}: nothing to read. {' '.join(notes)}")
    origin = run.header.origin
    notes += [] if origin is None else of_rotors(origin.notes)
    file = run.folder / RUN_FILE
    return FlightLog(
        path=run.folder,
        source=Source(str(file), sha256_of(file)),
        program="run of cfid" if origin is None else f"run of cfid, imported from {origin.file}, {origin.program}",
        clock="times are in s",
        series=tuple(series),
        assumed=(
            *(() if origin is None else of_rotors(origin.assumed)),
            *assumptions(channel for one in series for channel in one.channels),
        ),
        notes=tuple(dict.fromkeys(notes)),
    )


def _of_device(device: str, path: Path, units: Mapping[str, str]) -> tuple[Series, tuple[str, ...]]:
    sha256 = sha256_of(path)
    table = open_table(path, sha256=sha256)
    names = table.names
    rows = sum(len(block.numbers(names)) for block in table.blocks())
    if names[0] != TIME:
        raise DataError(f"{path}: its first column is not the time '{TIME}': it is not a device's file of a run.")
    channels = tuple(
        stated_channel(name, units[name]) if name in units else crazyflie_channel(name) for name in names[1:]
    )
    return Series(name=device, rows=rows, channels=channels, blocks=partial(_blocks, path, sha256)), line_notes(table)


def _blocks(path: Path, sha256: str) -> Iterator[Array]:
    for block in open_table(path, sha256=sha256).blocks():
        yield block.numbers(block.names)
