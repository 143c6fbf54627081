"""Read sine runs of a campaign, or of files that an index lists, by the name of their series."""

import math
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from cfid.errors import ConfigError, DataError
from cfid.estimate.held_readings import first_rows, rows_a_reading
from cfid.findings import Finding, merged, rejection, warning
from cfid.large import empty, parts, usual_step
from cfid.quantities.registry import Range
from cfid.recordings.read import read_recording
from cfid.recordings.sines import CROSSINGS, CrossingRecord, IndexRow, read_crossings, read_index
from cfid.recordings.wrench import WrenchRecord, turn_about_z, wrench_of
from cfid.records.parameters import Source
from cfid.records.plausibility import Given, implausible_inputs
from cfid.records.rig_file import NONE_STATED, LoadCellMount, RigFacts
from cfid.records.run import Run, losses, refuse_contradiction, run_at, run_holding
from cfid.transfer.alignment import Array, RecordedSine, Reports
from cfid.transfer.plan import SAMPLE_S, Sine
from cfid.units import MM, MOTOR_AZIMUTH_DEG
from cfid.wire.app import MIDDLE

Channel = Literal["Fz", "Tx", "Ty", "arm"]

_AXES_OF: Mapping[Channel, tuple[str, ...]] = {"Fz": ("Fz",), "Tx": ("Tx",), "Ty": ("Ty",), "arm": ("Tx", "Ty")}
_COLUMNS = ("l", "n", "amplitude", "motor", "loadcell", "crossings")
_STATED = _COLUMNS[:4]  # by an index and by run.toml
_MOST_SAMPLES = 2**32 - 1
_ARM = Range(0.015, 0.3, "a Crazyflie has 0.046")
_GAINS = (
    "tf.static_gain_n", "tf.numerator", "tf.series.*.static_gain_n", "tf.series.*.numerator", "tf.frequency_response",
)  # fmt: skip
_UNKNOWN = "no rig.toml stated how far {} when this was recorded: give `{}`."
_LOOKED_AT = 100_000  # the number of samples that are examined for repeated readings
_FARTHEST_DEG = 20.0  # from the arm, more than cross-talk and a mount aligned by eye; a gain is then 6 % too small
_CLEAR = 9.0  # the least ratio of the powers along and across the torque's direction, for the direction to be clear


@dataclass(frozen=True, kw_only=True)
class SineSet:
    """Recorded sines by the name of their series, in order, and the findings about their files.

    `rigs` are the facts of the rig during the recordings, with the arm that was used.
    """

    series: dict[str, list[RecordedSine]]
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()
    channel: Channel = "arm"
    rigs: tuple[RigFacts, ...] = ()

    @property
    def runs(self) -> list[RecordedSine]:
        """All runs."""
        return [run for own in self.series.values() for run in own]


def read_sines(
    runs: Sequence[Run | Path | str] = (),
    *,
    index: Path | None = None,
    channel: Channel = "arm",
    arm_m: float | None = None,
    arm_std_m: float | None = None,
    yaw_deg: float | None = None,
    facts: RigFacts = NONE_STATED,
    middle: float = MIDDLE,
) -> SineSet:
    """Return runs of `cfid log sine` and the runs of an index, a CSV file with one row per run, as thrust of one motor.

    `arm_m`, `arm_std_m` and `yaw_deg` of the load cell override those that a run states; `facts` apply to files, and so
    does `middle`, B of eq. 3.6. Paths of an index are relative to it. Raises ConfigError when there is nothing to read,
    and DataError with the name of a file that cannot be read or that is given twice.
    """
    if index is None and not runs:
        raise ConfigError("no sine to read: name runs or an index.")
    reader = _Reader(channel, arm_m, arm_std_m, yaw_deg, middle, facts.loadcell.gain)
    if index is not None:
        listed = read_index(index, columns=_COLUMNS, optional=("series",))
        reader.sources.append(listed.source)
        reader.findings += listed.findings
        reader.read_cells(row.file("loadcell") for row in listed.rows)
        for row in listed.rows:
            reader.add_row(row, facts)
    read = [_run(run) for run in runs]
    sines = [_sine(run) for run in read]
    reader.read_cells(run.folder for run in read)
    for run, sine in zip(read, sines, strict=True):
        reader.add_run(run, sine)
    return reader.result()


@dataclass
class _Reader:
    """A reader that reads each file once and collects findings about them."""

    channel: Channel
    arm_m: float | None
    arm_std_m: float | None
    yaw_deg: float | None
    middle: float
    gain: tuple[float, ...] | None  # of a load cell whose file is no run
    series: dict[str, list[RecordedSine]] = field(default_factory=dict)
    sources: list[Source] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    _cells: dict[Path, WrenchRecord] = field(default_factory=dict)
    _thrusts: dict[tuple[Path, int], tuple[Array, Array]] = field(default_factory=dict)
    _names: dict[str, str] = field(default_factory=dict)  # the name of the run, by the hash of its crossings
    _moments: dict[float, Array] = field(default_factory=dict)  # the torque's moments, by yaw
    _rigs: list[RigFacts] = field(default_factory=list)

    def add_row(self, row: IndexRow, facts: RigFacts) -> None:
        """Add the run in a row of an index."""
        samples = row.whole("n", 1, _MOST_SAMPLES)
        crossings = read_crossings(row.file("crossings"))
        sine = Sine(
            periods=row.whole("l", 0, samples // 2),
            samples=samples,
            amplitude=row.number("amplitude"),
            motor=row.whole("motor", 0, 4),
            middle=self.middle,
            series=row.fields.get("series"),
        )
        name = f"l = {row.fields['l']} ({crossings.path.name})"
        for path in (crossings.path, row.file("loadcell")):
            if (run := run_holding(path)) is not None and run.header.family == "sine":
                stated = ({key: one.to_run()[key] for key in _STATED} for one in (sine, _sine(run)))
                refuse_contradiction(f"{name}: {path}", *stated)
        self._add(name, sine, crossings, row.file("loadcell"), facts)

    def add_run(self, run: Run, sine: Sine) -> None:
        """Add a run of `cfid log sine`."""
        crossings = read_crossings(run.folder)
        lost = losses(run, run.header.devices[CROSSINGS], len(crossings.host_s))
        self.findings += [one.at(run.folder.name) for one in lost]
        self._add(f"{sine.hz:g} Hz ({run.folder.name})", sine, crossings, run.folder, run.header.rig)

    def read_cells(self, paths: Iterable[Path]) -> None:
        """Read the load cells' files in parallel: parsing them takes longer than everything after it."""
        new = list(dict.fromkeys(path for path in paths if path not in self._cells))
        with ThreadPoolExecutor(max_workers=2) as pool:
            cells = list(pool.map(self._cell, new))
        self._cells |= dict(zip(new, cells, strict=True))
        for cell in cells:
            self.findings += cell.findings
            self.sources.append(cell.source)

    def _cell(self, path: Path) -> WrenchRecord:
        """Read a load cell's file, with the first row of each reading: one that repeats it shows an earlier force."""
        cell = wrench_of(read_recording(path), gain=self.gain).without_outliers().with_stuck_named()
        readings = cell.values_of(cell.main_axis)
        rows = rows_a_reading(readings[:_LOOKED_AT])
        if rows == 1:
            return cell
        rate_hz = 1 / usual_step(cell.time_s)
        text = (
            f"each reading of the load cell is repeated in about {rows} rows: {rate_hz:.3g} rows a second show "
            f"{rate_hz / rows:.3g} readings. The first row of each counts, which may be up to {1e3 / rate_hz:.3g} ms "
            "late."
        )
        return cell.kept(first_rows(readings, rows=rows), warning("sine-forces-repeated", text, "tf.*"))

    def result(self) -> SineSet:
        """Return everything that was added."""
        return SineSet(
            series=self.series,
            findings=(
                *merged(self.findings),
                *(one for yaw_deg, own in self._moments.items() for one in mount_findings(own, yaw_deg=yaw_deg)),
            ),
            sources=tuple(dict.fromkeys(self.sources)),
            channel=self.channel,
            rigs=tuple(dict.fromkeys(self._rigs)),
        )

    def _add(self, name: str, sine: Sine, crossings: CrossingRecord, loadcell: Path, facts: RigFacts) -> None:
        if (known := self._names.get(crossings.source.sha256)) is not None:
            raise DataError(f"{name}: its crossings are those of {known} too: name each run once.")
        self._names[crossings.source.sha256] = name
        time_s, force_n = self._thrust(loadcell, sine.motor, facts)
        reports = Reports(crossings.host_s, crossings.command, crossings.sample, crossings.vehicle_us)
        self._add_moments(self._cells[loadcell], time_s, reports, sine, facts)
        own_clock = self._cells[loadcell].run is None
        recorded = RecordedSine(
            name=name, sine=sine, reports=reports, time_s=time_s, force_n=force_n, own_clock=own_clock
        )
        self.series.setdefault(sine.series or f"motor{sine.motor}", []).append(recorded)
        self.findings += crossings.findings
        self.sources.append(crossings.source)

    def _add_moments(self, cell: WrenchRecord, time_s: Array, reports: Reports, sine: Sine, facts: RigFacts) -> None:
        """Add the torque's moments at a sine's frequency, over its reports' time span, if projected on the arm."""
        if self.channel != "arm" or sine.motor == 0 or not sine.periods or not len(reports.host_s):
            return
        own = slice(*np.searchsorted(time_s, (reports.host_s.min(), reports.host_s.max())))
        if len(time_s[own]) < 2:
            return
        yaw_deg = self._mount(facts)[1]
        moments = torque_moments(
            time_s[own],
            cell.torque_nm[own],
            frequency_hz=sine.periods / (sine.samples * SAMPLE_S),
            motor=sine.motor,
            yaw_deg=yaw_deg,
        )
        self._moments[yaw_deg] = self._moments.get(yaw_deg, 0) + moments

    def _thrust(self, path: Path, motor: int, facts: RigFacts) -> tuple[Array, Array]:
        """Return the host's times (n,) in s and thrust (n,) in N, with its bias, from a load cell's file or run."""
        if (path, motor) not in self._thrusts:
            cell = self._cells[path]
            if cell.begin_s is None:
                raise ConfigError(f"{path}: has no times, which tie a load cell to the vehicle's reports.")
            cell.require(*_AXES_OF[self.channel], purpose=f"thrust by the channel {self.channel}")
            arm_m, yaw_deg = self._mount(facts)
            time_s, thrust = empty(len(cell.time_s)), empty(len(cell.time_s))
            np.add(cell.time_s, cell.begin_s, out=time_s)
            for part in parts(len(thrust)):
                force_n, torque_nm = cell.force_n[part], cell.torque_nm[part]
                thrust[part] = thrust_of(self.channel, force_n, torque_nm, arm_m=arm_m, motor=motor, yaw_deg=yaw_deg)
            thrust /= 4 if motor == 0 else 1
            std_mm = None if self.arm_std_m is None else self.arm_std_m / MM
            arm_mm = None if self.channel == "Fz" else arm_m / MM
            self._rigs.append(RigFacts(loadcell=LoadCellMount(arm_mm=arm_mm, arm_std_mm=std_mm)).over(facts))
            self._thrusts[path, motor] = time_s, thrust
        return self._thrusts[path, motor]

    def _mount(self, facts: RigFacts) -> tuple[float, float]:
        """Return arm in m and yaw in degrees; the channel Fz needs neither, the cell's own torques no yaw.

        Raises ConfigError where one that the channel needs is not stated.
        """
        mount = facts.loadcell
        arm_m = self.arm_m
        if arm_m is None and mount.arm_mm is not None:
            arm_m = MM * mount.arm_mm
        yaw_deg = mount.yaw_deg if self.yaw_deg is None else self.yaw_deg
        if arm_m is None and self.channel != "Fz":
            raise ConfigError(_UNKNOWN.format("a motor lies from the load cell's z axis", "arm_mm"))
        if yaw_deg is None and self.channel == "arm":
            raise ConfigError(_UNKNOWN.format("the load cell's x axis is turned from the vehicle's", "yaw_deg"))
        if arm_m is not None:
            self.findings += implausible_inputs([Given("arm", arm_m, _ARM, "m")], None, *_GAINS)
        return arm_m or 1.0, yaw_deg or 0.0


def _run(run: Run | Path | str) -> Run:
    if isinstance(run, Run):
        return run
    found = run_at(Path(run))
    if found is None:
        raise DataError(f"{run}: no run folder; files of sines need an index.")
    return found


def _sine(run: Run) -> Sine:
    try:
        return Sine.of_run(run.header.kind, run.header.requested)
    except DataError as error:
        raise DataError(f"{run.folder}: {error}") from None


def thrust_of(
    channel: Channel, force_n: Array, torque_nm: Array, *, arm_m: float, motor: int = 1, yaw_deg: float
) -> Array:
    """Return a motor's thrust (n,) in N by a channel, from forces and torques (n, 3) in N and N m.

    `yaw_deg` turns the cell's vectors into the vehicle's frame (see `turn_about_z`). The thesis turned the vehicle left
    by 45 degrees on the load cell, a yaw of -45, so that motor 1 lies on the cell's x axis, 4 on y, 3 on -x and 2 on
    -y. A thrust f up at (x, y) causes Tx = y f and Ty = -x f: motors 1 and 3 load Ty with -1 and +1 times f `arm_m`, 2
    and 4 load Tx with -1 and +1. C.2.5 has that minus for motor 1. "Tx" and "Ty", the cell's own, are divided by the
    arm and keep their sign; "arm" projects on the motor's own arm for any `yaw_deg`, with thrust positive.
    """
    if channel == "Fz":
        return force_n[:, 2]
    if motor not in MOTOR_AZIMUTH_DEG:
        raise DataError("all motors together make no torque about an arm: use the channel Fz.")
    if channel == "arm":
        angle, torque_nm = math.radians(MOTOR_AZIMUTH_DEG[motor]), turn_about_z(torque_nm, yaw_deg=yaw_deg)
        return np.asarray((math.sin(angle) * torque_nm[:, 0] - math.cos(angle) * torque_nm[:, 1]) / arm_m)
    return np.asarray(torque_nm[:, 0 if channel == "Tx" else 1] / arm_m)


def torque_moments(time_s: Array, torque_nm: Array, *, frequency_hz: float, motor: int, yaw_deg: float) -> Array:
    """Return the second moments (2, 2) of torque (n, 3) at a frequency, across the motor's arm and along it.

    The component across the arm is that of thrust. `yaw_deg` turns the cell's vectors into the vehicle's frame.
    """
    angle = math.radians(MOTOR_AZIMUTH_DEG[motor])
    axes = np.array([[math.sin(angle), -math.cos(angle)], [math.cos(angle), math.sin(angle)]])
    both = axes @ turn_about_z(torque_nm, yaw_deg=yaw_deg)[:, :2].T
    wave = np.hanning(len(time_s)) * np.exp(-2j * math.pi * frequency_hz * (time_s - time_s[0])) / len(time_s)
    at = (both - both.mean(axis=1, keepdims=True)) @ wave
    return np.asarray(np.outer(at, at.conj()).real)


def mount_findings(moments: Array, *, yaw_deg: float) -> tuple[Finding, ...]:
    """Reject gains where the torque, with moments (2, 2) summed over all sines, does not match the motor's arm."""
    across, along = np.linalg.eigvalsh(moments)
    off_deg = math.degrees(0.5 * math.atan2(2 * moments[0, 1], moments[0, 0] - moments[1, 1]))
    if along < _CLEAR * across or abs(off_deg) <= _FARTHEST_DEG:
        return ()
    lost = 100 * (1 - math.cos(math.radians(off_deg)))
    text = (
        f"the torque of the sines lies {abs(off_deg):.0f} degrees off that of the motor's arm (limit "
        f"{_FARTHEST_DEG:g}), and the gain would be {lost:.0f} % too small: is the load cell's yaw "
        f"{yaw_deg - off_deg:.0f} degrees, not {yaw_deg:g}, or did another motor run?"
    )
    return (rejection("sine-torque-off-arm", text, *_GAINS),)
