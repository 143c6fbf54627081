"""Recordings of commands in wind, of an index or of `cfid log wind`, to one mean force each."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.cli.drag_files import WindRow
from cfid.cli.motor_hearing import Ear, RotorOptions
from cfid.cli.options import positive
from cfid.cli.wind_run import setting_of
from cfid.errors import CfidError, DataError, FitError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cfid.analysis.drag_recording import MeanForce
    from cfid.analysis.drag_reduction import WindRun
    from cfid.analysis.staircase import Point
    from cfid.flight import Rows
    from cfid.parameters import Source
    from cfid.run import Run
    from cfid.wrench import WrenchReading, WrenchRecord

_STANDING_UP_TO = 1000  # the command up to which rotors stand (section 3.3.2)
_RAD_S_TO_RPM = 9.549296585513721  # 60/(2 pi)
_ROTORS = 4
_UNHEARD = "no tachometer reading, and vibration does not tell the rotors' speed"
_SAG = 0.005  # of the voltage: thrust then changes by a hundredth, which is as much as weak drag


class WindReader:
    """Reads recordings, and keeps what they said in `runs`, `sources` and `paths`."""

    def __init__(self, reading: "WrenchReading", *, method: str, markers: int) -> None:
        """Take how files are read and averaged, and the markers that a tachometer counted."""
        self.runs: list[WindRun] = []
        self.sources: list[Source] = []
        self.paths: list[Path] = []
        self._reading, self._method, self._markers = reading, method, markers
        self._notes: Counter[str] = Counter()
        self._said: list[str] = []
        self._volts: list[tuple[WindRun, float]] = []

    @property
    def warnings(self) -> list[str]:
        """What is to be said of the recordings: what holds for several, once."""
        counted = [f"{count} recording(s): {note}" for note, count in self._notes.items()]
        return [*counted, *self._said, *_sagged(self._volts)]

    def add_row(self, row: WindRow) -> None:
        """Reduce the recording of an index' row. Raises DataError or FitError that name row and file."""
        record = self._read(row.loadcell)
        self._notes.update(note.removeprefix(f"{record.path.name}: ") for note in record.notes)
        setting = {
            "name": f"{row.where} {row.loadcell.name}",
            "command": row.command,
            "angle_deg": row.angle_deg,
            "min_mps": row.min_mps,
            "max_mps": row.max_mps,
            "azimuth_rad": row.azimuth_rad,
        }
        if row.command <= _STANDING_UP_TO:
            self._add_standing(setting)
            return
        try:
            mean = self._averaged(record, row)
        except CfidError as error:
            raise type(error)(f"{row.where}: {row.loadcell}: {error}") from None
        self._add(record, mean, row.tach_rpm, setting)

    def add_run(self, path: Path) -> None:
        """Reduce each command of a run of `cfid log wind`. Raises DataError or FitError that name the run."""
        from cfid.analysis.drag_recording import of_point
        from cfid.flight import READINGS, begin_s, holds, read_rows
        from cfid.stamps import run_at
        from cfid.wrench import LOADCELL

        run = run_at(path)
        if run is None:
            raise DataError(f"{path}: no run folder; recordings of others are named in an --index FILE.")
        setting, record = setting_of(run), self._read(path)
        began_s = begin_s(run.device_file(LOADCELL))
        settled = self._settled(run, record, began_s)
        readings = read_rows(run, READINGS) if holds(run, READINGS) else None
        self.sources += [readings.source] if readings else []
        self.paths.append(path)
        self._said += record.notes
        for point, volts in zip(settled, _volts(run, began_s, settled), strict=True):
            place = {
                "name": f"{record.name} command {point.command}",
                "command": point.command or 0,
                "angle_deg": setting.angle_deg,
                "min_mps": setting.min_mps,
                "max_mps": setting.max_mps,
                "azimuth_rad": setting.azimuth_rad,
            }
            self._add(record, of_point(point), _typed(readings, began_s, point), place)
            self._volts.append((self.runs[-1], volts))

    def _read(self, path: Path) -> "WrenchRecord":
        from cfid.wrench import read_wrench

        record = read_wrench(path, self._reading)
        self.sources.append(record.source)
        return record

    def _averaged(self, record: "WrenchRecord", row: WindRow) -> "MeanForce":
        from cfid.analysis.drag_recording import mean_force, mean_force_thesis

        mean = (mean_force_thesis if self._method == "thesis" else mean_force)(
            time_s=record.time_s,
            force_n=record.force_n,
            command=row.command,
            status=record.status,
            window_s=row.window_s,
        )
        self._notes.update([mean.note] if mean.note else [])
        return mean

    def _settled(self, run: "Run", record: "WrenchRecord", began_s: float) -> "tuple[Point, ...]":
        """Reduce the staircase of a run: its rests give the tare, in the wind and with still rotors."""
        from cfid.analysis.staircase import reduce_staircase
        from cfid.flight import read_commands

        rows, commands = read_commands(run)
        self.sources.append(rows.source)
        try:
            found = reduce_staircase(
                time_s=record.time_s,
                channels=record.force_n,
                status=record.status,
                command_time_s=rows.time_s - began_s,
                commands=commands,
            )
        except CfidError as error:
            raise type(error)(f"{run.folder}: {error}") from None
        left_out = [
            f"command {point.command}: {point.reason}; it is left out." for point in found.points if point.reason
        ]
        self._said += [f"{record.name}: {said}" for said in (*found.warnings, *left_out)]
        return found.steady()

    def _add(self, record: "WrenchRecord", mean: "MeanForce", tach_rpm: float | None, setting: dict[str, Any]) -> None:
        from cfid.analysis.drag_reduction import WindRun

        shown = self._shown_rpm(tach_rpm, record, mean, setting)
        self.runs.append(WindRun(**setting, shown_rpm=shown, force_n=mean.force_n, force_std_n=mean.std_n))

    def _add_standing(self, setting: dict[str, Any]) -> None:
        """Add a run whose rotors stood: nobody looks at its force."""
        import numpy as np

        from cfid.analysis.drag_reduction import WindRun

        self.runs.append(WindRun(**setting, shown_rpm=0.0, force_n=np.zeros(3), force_std_n=np.zeros(3)))

    def _shown_rpm(
        self, tach_rpm: float | None, record: "WrenchRecord", mean: "MeanForce", setting: dict[str, Any]
    ) -> float:
        """Return a tachometer's reading, or what it would show by what is heard; a reference needs none."""
        if tach_rpm:
            return positive(tach_rpm, "tachometer reading")
        if not setting["max_mps"] > 0:
            return 0.0
        try:
            heard = Ear(record, RotorOptions()).hear(*mean.window_s, rotors=_ROTORS)
        except CfidError as error:
            raise FitError(f"{setting['name']}: {_UNHEARD}: {error} Give the reading.") from None
        if not heard.believed:
            raise FitError(f"{setting['name']}: {_UNHEARD}: {' '.join(heard.doubts)} Give the reading.")
        self._notes.update(["without a tachometer reading: the rotors' speed is heard in the vibration."])
        return _RAD_S_TO_RPM * self._markers * heard.speed_rad_per_s


def _typed(readings: "Rows | None", began_s: float, point: "Point") -> float | None:
    """Return the reading that was typed at a point, None where there is none."""
    if readings is None:
        return None
    there = (readings.columns["command"] == point.command) & (readings.time_s - began_s >= point.begin_s)
    typed = readings.columns["rpm"][there]
    return float(typed[0]) if len(typed) else None


def _volts(run: "Run", began_s: float, points: "Sequence[Point]") -> "list[float]":
    """Return the battery's mean voltage at each point, nan where the vehicle logged none."""
    from cfid.analysis.staircase import mean_beside
    from cfid.flight import VEHICLE_LOG, holds, read_rows

    rows = read_rows(run, VEHICLE_LOG) if holds(run, VEHICLE_LOG) else None
    if rows is None or "pm.vbat" not in rows.columns:
        return [float("nan")] * len(points)
    return [float(mean) for mean in mean_beside(points, rows.time_s - began_s, rows.columns["pm.vbat"])]


def _sagged(volts: "list[tuple[WindRun, float]]") -> list[str]:
    """Say where the battery was not at the voltage of its reference: the thrust without wind is another one then."""
    references = {run.command: level for run, level in volts if not run.windy}
    off = {
        run.name: level / references[run.command] - 1
        for run, level in volts
        if run.windy and run.command in references and abs(level / references[run.command] - 1) > _SAG
    }
    if not off:
        return []
    name, most = max(off.items(), key=lambda item: abs(item[1]))
    return [
        f"{len(off)} run(s) had another battery voltage than their reference, {name} by {100 * most:+.1f} %: thrust "
        "follows it, and passes for drag along z. Feed the vehicle from a supply of constant voltage."
    ]
