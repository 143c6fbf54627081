"""A run as its folder shows it, while it grows: signals, rates, losses, the vehicle's state, the time left."""

import contextlib
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.motors.plan import StaircasePlan
from cfid.recordings.vehicle import READINGS, SUPERVISOR, VEHICLE_LOG
from cfid.recordings.wrench import LOADCELL
from cfid.records.files import RUN_FILE
from cfid.records.run import DeviceRecord, Run, RunHeader, is_written, number_of, read_run
from cfid.rig.vehicle import BATTERY
from cfid.transfer.sines.plan import SAMPLE_S
from cfid.watch.driven import vehicles_of, vehicles_recorded
from cfid.watch.signals import Trace, signals_of
from cfid.watch.tail import Tail
from cfid.wire.supervisor import VehicleState

Array = npt.NDArray[np.float64]

_RATE_S = 2.0  # over which a rate is averaged
_QUIET_S = 2.0  # without a row of any device, after which a run is silent
_SEQUENCE, _VEHICLE_MS = "rdt_sequence", "vehicle_ms"
_WRAPS = {_SEQUENCE: 2**32, _VEHICLE_MS: 2**24}  # columns in which the source numbers or dates its rows
_FEWEST_STEPS = 8  # of the vehicle's time, whose median is the period of its log


@dataclass(kw_only=True)
class DeviceProgress:
    """A device's rows so far, its rate in Hz, and the samples known to be missing (None where rows do not show it)."""

    record: DeviceRecord
    tail: Tail
    signals: list[Trace]
    rows: int = 0
    missing: int | None = None
    latest_s: float = float("nan")
    latest: tuple[float, ...] = ()
    _marks: deque[tuple[float, int]] = field(default_factory=deque)
    _early: Array = field(default_factory=lambda: np.empty(0))  # steps before the period is known
    _period: float = 0.0

    @property
    def rate_hz(self) -> float:
        """Rows per second over the last seconds, by the rows' own times."""
        if len(self._marks) < 2:
            return 0.0
        (begin_s, before), (end_s, after) = self._marks[0], self._marks[-1]
        return (after - before) / (end_s - begin_s) if end_s > begin_s else 0.0

    def take(self, zero_s: float | None) -> float | None:
        """Read the next rows; return the Unix time at the zero of the run's picture, None until it is known."""
        rows = self.tail.rows()
        if not len(rows):
            return zero_s
        zero_s = float(rows[0, 0]) if zero_s is None else zero_s
        if not self._marks:
            self._marks.append((float(rows[0, 0]), 1))  # so that a short file, read at once, has a rate too
        self._count_missing(rows)
        for signal in self.signals:
            signal.add(rows[:, 0] - zero_s, rows)
        self.rows += len(rows)
        self.latest_s, self.latest = float(rows[-1, 0]), tuple(rows[-1].tolist())
        self._marks.append((self.latest_s, self.rows))
        while len(self._marks) > 2 and self.latest_s - self._marks[1][0] > _RATE_S:
            self._marks.popleft()
        return zero_s

    def _count_missing(self, rows: Array) -> None:
        """Count the samples missing before each of the rows (n, columns), if a column numbers or dates the rows."""
        column = next((name for name in _WRAPS if name in self.record.columns), None)
        if column is None:
            return
        place, wrap = self.record.columns.index(column), _WRAPS[column]
        steps = np.diff(np.concatenate([[self.latest[place]] if self.latest else [], rows[:, place]])) % wrap
        steps = np.concatenate([self._early, steps[(steps > 0) & (steps < wrap / 2)]])
        if not self._period and column == _VEHICLE_MS and len(steps) < _FEWEST_STEPS:
            self._early = steps
            return
        self._early = np.empty(0)
        self._period = self._period or (1.0 if column == _SEQUENCE else float(np.median(steps)))
        self.missing = (self.missing or 0) + int(np.sum(np.rint(steps / self._period) - 1))


class LiveRun:
    """A run folder that is read again and again; nothing in it is locked or written."""

    def __init__(self, folder: Path) -> None:
        """Read its run.toml. Raises DataError when that is missing or invalid."""
        self.folder = folder
        self.header: RunHeader = read_run(folder).header
        self.zero_s: float | None = None
        self.devices = {
            name: DeviceProgress(
                record=record,
                tail=Tail(folder / record.file, len(record.columns)),
                signals=signals_of(name, record, rests=self.header.kind != LOADCELL),  # that kind may begin loaded
            )
            for name, record in self.header.devices.items()
        }
        self._changed = self._stamp()

    @property
    def recording(self) -> bool:
        """Whether run.toml states that the run is being recorded; the file of a run that was cut does so forever."""
        return self.header.state == "recording"

    @property
    def driven(self) -> tuple[str, ...]:
        """The addresses of the vehicles that this run drives, or drove when it was cut, then those of its neighbours.

        The neighbours are the other runs in the same folder that are being recorded now.
        """
        own = vehicles_of(self.header) if self.recording else ()
        return own + vehicles_recorded(self.folder.resolve().parent, besides=own)

    @property
    def signals(self) -> list[Trace]:
        """All signals, device by device."""
        return [signal for device in self.devices.values() for signal in device.signals]

    @property
    def now_s(self) -> float:
        """The time of the newest row, in s from the first."""
        times = [device.latest_s for device in self.devices.values() if device.rows]
        return max(times) - self.zero_s if times and self.zero_s is not None else 0.0

    @property
    def behind(self) -> float:
        """The fraction of the files that is not read yet, from 0 to 1."""
        behind = sum(device.tail.behind_bytes for device in self.devices.values())
        whole = sum(_size(self.folder / device.record.file) for device in self.devices.values())
        return behind / whole if whole else 0.0

    @property
    def quiet_s(self) -> float:
        """How long ago the newest row was taken, by this computer's clock."""
        return max(time.time() - (self.zero_s or self.header.started.timestamp()) - self.now_s, 0.0)

    @property
    def recording_now(self) -> bool:
        """Whether a process is recording the run, with rows or without."""
        return self.recording and is_written(self.folder)

    @property
    def left_s(self) -> float | None:
        """How much longer the recording will last, None where it has no planned end."""
        lasts_s = planned_s(Run(folder=self.folder, header=self.header))
        return None if lasts_s is None or not self.recording_now else max(lasts_s - self.now_s, 0.0)

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
    def loadcell(self) -> DeviceProgress | None:
        """The load cell, where the run has one with its usual columns."""
        device = self.devices.get(LOADCELL)
        return device if device is not None and device.signals else None

    @property
    def silent(self) -> bool:
        """Whether a run that was not closed has had no row for some seconds, by this computer's clock."""
        return self.recording and not self.behind and self.quiet_s > _QUIET_S

    def rate_hz(self, device: DeviceProgress) -> float:
        """Return a device's rows per second, 0 if it had none in the last seconds while others had some."""
        silent_s = self.now_s + (self.zero_s or 0.0) - device.latest_s
        return 0.0 if silent_s > _RATE_S or (self.silent and self.recording_now) else device.rate_hz

    def read(self, within_s: float) -> bool:
        """Read what was added, for at most about `within_s`; return whether anything was added."""
        begun_s, before = time.monotonic(), sum(device.rows for device in self.devices.values())
        more = True
        while more and time.monotonic() - begun_s < within_s:
            more = False
            for device in self.devices.values():
                rows = device.rows
                self.zero_s = device.take(self.zero_s)
                more = more or device.rows > rows
        return self._read_header() or sum(device.rows for device in self.devices.values()) > before

    def _read_header(self) -> bool:
        """Read run.toml again if it was replaced."""
        stamp = self._stamp()
        if stamp == self._changed:
            return False
        self._changed = stamp
        with contextlib.suppress(DataError):
            self.header = read_run(self.folder).header
        return True

    def _stamp(self) -> int:
        try:
            return (self.folder / RUN_FILE).stat().st_mtime_ns
        except OSError:
            return 0


def planned_s(run: Run) -> float | None:
    """Return how long a run was to last by its request; None for a request without an end, or of an unknown kind.

    A run with typed readings has no planned end: nobody knows how long typing takes.
    """
    requested = run.header.requested
    if READINGS in run.header.devices:
        return None
    try:
        if "for_s" in requested:
            return float(requested["for_s"])
        if {"l", "n"} <= set(requested):
            return int(requested["n"]) * SAMPLE_S
        return StaircasePlan.of_run(run).duration_s
    except (KeyError, TypeError, ValueError):
        return None


def newest_run(runs_folder: Path) -> Path | None:
    """Return the run being recorded, else the last one; None where there is none."""
    folders = (path.parent for path in runs_folder.glob(f"*/{RUN_FILE}"))
    found = sorted(folders, key=lambda folder: (number_of(folder), folder.name), reverse=True)
    return next((folder for folder in found if _grows(folder)), found[0] if found else None)


def _grows(folder: Path) -> bool:
    """Return whether a run is being recorded, without reading a run that no process writes."""
    try:
        return is_written(folder) and read_run(folder).cut
    except DataError:
        return False


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
