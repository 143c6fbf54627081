"""A run as its folder shows it while it grows, and which run the page shows; nothing in it is locked or written."""

import contextlib
import io
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.errors import DataError
from cfid.recordings.vehicle import SUPERVISOR, VEHICLE_LOG
from cfid.recordings.wrench import AXES, LOADCELL
from cfid.records.files import RUN_FILE
from cfid.records.progress import PROGRESS_FILE, Counts, RunProgress, read_progress
from cfid.records.run import RECORDER_FILE, DeviceRecord, RunHeader, is_written, number_of, read_run
from cfid.rig.vehicle import BATTERY
from cfid.watch.signals import Trace, signals_of
from cfid.watch.spectrum import RotorLines, spectrum_of
from cfid.wire.supervisor import VehicleState

Array = npt.NDArray[np.float64]

CHUNK_BYTES = 1 << 20  # 14 000 rows of a load cell: two seconds at 7 kHz, parsed within about 20 ms

_QUIET_S = 3.0  # without progress, which a recorder writes every second
_READ_S = 0.1  # of the time from one picture to the next, while the page catches up with a long file
_LOOK_S = 0.5  # from one spectrum, and one look for a newer run, to the next


@dataclass(kw_only=True)
class DeviceRows:
    """The rows of a device's growing CSV file so far; `unreadable` counts bytes that are no rows of its columns."""

    path: Path
    record: DeviceRecord
    signals: list[Trace]
    rows: int = 0
    unreadable: int = 0
    latest: tuple[float, ...] = ()
    _offset: int = 0

    def read(self) -> Array:
        """Return the next whole rows (n, columns), of one chunk at most; a last line without its end stays."""
        try:
            with self.path.open("rb") as file:
                file.seek(self._offset)
                block = file.read(CHUNK_BYTES)
        except OSError:
            block = b""
        block = block[: block.rfind(b"\n") + 1]
        is_first = not self._offset
        self._offset += len(block)
        if is_first:
            block = block[block.find(b"\n") + 1 :]  # without the names of the columns
        columns = range(len(self.record.columns))
        values = np.empty((0, len(columns)))
        if block:
            try:
                table = pd.read_csv(io.BytesIO(block), header=None, names=columns, index_col=False, dtype=np.float64)
                values = table.to_numpy()
            except ValueError:  # somebody edited the file
                self.unreadable += len(block)
        rows = values[np.isfinite(values[:, 0])]
        self.rows += len(rows)
        self.latest = tuple(rows[-1].tolist()) if len(rows) else self.latest
        return rows


class LiveRun:
    """A run folder that is read again and again."""

    def __init__(self, folder: Path) -> None:
        """Read its run.toml. Raises DataError when that is missing or invalid."""
        self.folder = folder
        self.header: RunHeader = read_run(folder).header
        self.zero_s: float | None = None  # Unix time at the zero of the picture
        self.devices = {
            name: DeviceRows(
                path=folder / record.file,
                record=record,
                signals=signals_of(name, record, rests=self.header.kind != LOADCELL),  # that kind may begin loaded
            )
            for name, record in self.header.devices.items()
        }

    @property
    def recording(self) -> bool:
        """Whether run.toml states that the run is being recorded; the file of a run that was cut does so forever."""
        return self.header.state == "recording"

    @property
    def recording_now(self) -> bool:
        """Whether a process is recording the run, with rows or without."""
        return self.recording and is_written(self.folder)

    @property
    def rows(self) -> int:
        """How many rows of all devices were read."""
        return sum(device.rows for device in self.devices.values())

    @property
    def signals(self) -> list[Trace]:
        """All signals, device by device."""
        return [signal for device in self.devices.values() for signal in device.signals]

    @property
    def now_s(self) -> float:
        """The time of the newest row, in s from the first."""
        times = [device.latest[0] for device in self.devices.values() if device.latest]
        return max(times) - self.zero_s if times and self.zero_s is not None else 0.0

    @property
    def quiet_s(self) -> float:
        """How long ago the recorder wrote its progress, by this computer's clock."""
        try:
            written_s = (self.folder / PROGRESS_FILE).stat().st_mtime
        except OSError:
            written_s = self.header.started.timestamp()
        return max(time.time() - written_s, 0.0)

    @property
    def silent(self) -> bool:
        """Whether a run that was not closed has had no progress for some seconds: its recorder hangs, or is gone."""
        return self.recording and self.quiet_s > _QUIET_S

    @property
    def vehicle_state(self) -> VehicleState | None:
        """The last state that the vehicle's supervisor reported."""
        device = self.devices.get(SUPERVISOR)
        return None if device is None or not device.latest else VehicleState.of(int(device.latest[1]))

    @property
    def battery_v(self) -> float | None:
        """The vehicle's last logged voltage."""
        device = self.devices.get(VEHICLE_LOG)
        if device is None or not device.latest or BATTERY not in device.record.columns:
            return None
        return device.latest[device.record.columns.index(BATTERY)]

    @property
    def force(self) -> Trace | None:
        """The force on the load cell, where the run has one with its usual columns."""
        return next((signal for signal in self.signals if signal.names == AXES[:3]), None)

    def progress(self) -> RunProgress:
        """Return what is known of the devices: by run.toml for a run that was closed, else by its recorder."""
        if self.recording:
            return read_progress(self.folder)
        return RunProgress(
            devices={
                name: Counts(rows=record.rows, lost=record.lost, rate_hz=0.0)
                for name, record in self.header.devices.items()
                if record.rows is not None
            }
        )

    def read_header(self) -> None:
        """Read run.toml again; one that is missing or invalid by now changes nothing."""
        with contextlib.suppress(DataError):
            self.header = read_run(self.folder).header

    def read(self, within_s: float) -> None:
        """Read the rows that were added to the files, for at most about `within_s`."""
        end_s, caught_up = time.monotonic() + within_s, False
        while not caught_up and time.monotonic() < end_s:
            before = self.rows
            for device in self.devices.values():
                rows = device.read()
                if not len(rows):
                    continue
                if self.zero_s is None:
                    self.zero_s = float(rows[0, 0])
                for signal in device.signals:
                    signal.extremes.add(rows[:, 0] - self.zero_s, signal.convert(rows))
            caught_up = self.rows == before


class ShownRun:
    """The run that the page shows, read once for all viewers: the one named, else the newest of a campaign."""

    def __init__(self, *, folder: Path | None, runs_folder: Path | None) -> None:
        """Begin with the named run; without one, turn to each new recording. Raises DataError where it is no run."""
        self.run: LiveRun | None = None if folder is None else LiveRun(folder)
        self.spectrum: RotorLines | None = None
        self.viewers = 0
        self._runs_folder = runs_folder if folder is None else None
        self._next_look_s = 0.0

    def read(self) -> None:
        """Read what was added since the last call, while anybody views it."""
        if not self.viewers:
            return
        is_due = time.monotonic() >= self._next_look_s
        if is_due:
            self._next_look_s = time.monotonic() + _LOOK_S
            self.look()
        if self.run is None:
            return
        self.run.read(_READ_S)
        if is_due and self.run.force is not None:
            self.spectrum = spectrum_of(*self.run.force.extremes.newest())

    def look(self) -> None:
        """Read run.toml again, and turn to a newer run of the campaign, unless the shown run is being recorded."""
        if self.run is not None:
            self.run.read_header()
        if self._runs_folder is None or (self.run is not None and self.run.recording_now):
            return
        folder = newest_run(self._runs_folder)
        if folder is None or (self.run is not None and self.run.folder == folder):
            return
        with contextlib.suppress(DataError):  # the next call tries again
            self.run, self.spectrum = LiveRun(folder), None


def newest_run(runs_folder: Path) -> Path | None:
    """Return the run being recorded, else the last one; None where there is none."""
    recorded = [path.parent for path in runs_folder.glob(f"*/{RECORDER_FILE}") if is_written(path.parent)]
    folders = recorded or [path.parent for path in runs_folder.glob(f"*/{RUN_FILE}")]
    return max(folders, key=lambda folder: (number_of(folder), folder.name), default=None)
