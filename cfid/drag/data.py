"""Reduce recordings in wind, or a table of forces, to drag experiments.

Each command of a recording becomes a row of points: its mean force less the tare, its wind and its rotors' speed. The
tare is taken with the wind on and the rotors standing, so that it also contains the force of the wind on the body
(section 4.4.3). From the points in wind, the mean of the references at the same command is subtracted.
"""

import itertools
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from cfid.counted import counted
from cfid.drag.model import DragExperiments
from cfid.drag.plan import FASTEST_MPS, HIGHEST_DEG, KIND, WindSetting, setting_of
from cfid.errors import CfidError, ConfigError, DataError, FitError
from cfid.estimate.signals import quiet_mean
from cfid.estimate.staircase import Point, Words, reduce_single
from cfid.findings import Finding, joined, merged, note, rejection, texts, warning
from cfid.motors import data as motors
from cfid.motors.plan import StaircasePlan
from cfid.motors.points import rotor_speed_rad_s
from cfid.motors.vibration.data import Rotors, VibrationRecord
from cfid.recordings.read import read_recording
from cfid.recordings.resumed import resumed_by, steps_read_later
from cfid.recordings.sines import IndexRow
from cfid.recordings.sines import read_index as read_rows_of_index
from cfid.recordings.table import read_table
from cfid.recordings.vehicle import COMMANDS, READINGS, Rows, TakenBackError, holds, read_rows
from cfid.recordings.wrench import WrenchRecord, rotation_about_z, wrench_of
from cfid.records.parameters import Source
from cfid.records.rig_file import NONE_STATED, RigFacts, Tachometer, WindStand
from cfid.records.run import Run, refuse_contradiction, run_at, run_holding
from cfid.units import DEAD_COMMAND, FULL_COMMAND, ROTORS

Array = npt.NDArray[np.float64]
Window = tuple[float, float]

UNSTATED_WIND_STD = 0.05  # relative standard uncertainty, used if the spread of the wind's readings is not stated

INDEX_COLUMNS = ("command", "angle_deg", "wind_min_mps", "wind_max_mps", "tach_rpm", "loadcell")
INDEX_OPTIONAL = ("azimuth_deg", "from_s", "to_s")
TABLE_COLUMNS = (
    "command", "angle_deg", "vx_mps", "vy_mps", "vz_mps", "speed_sum_rad_s", "fx_n", "fy_n", "fz_n",
)  # fmt: skip
FORCE, FORCE_STD = ["fx_n", "fy_n", "fz_n"], ["fx_std_n", "fy_std_n", "fz_std_n"]

_THESIS_TARE = 500  # samples, C.3.1, prepare_data
_FEWEST = 16  # the least samples of a window
_ESTIMATED_S = 3.0  # of a window: long enough to find a speed to a thousandth
# At lower rates, the blade-pass line of a rotor at 3000 rad/s is aliased onto others.
_ESTIMATED_FROM_HZ = 1990.0
_ANY_FROM_HZ = 3300.0  # the same limit for 5000 rad/s
_SLOWEST_RAD_S, _USUAL_RAD_S = 200.0, 3000.0  # the rotors of a Crazyflie stay below the latter
_UNKNOWN = "no tachometer reading, and vibration does not show the rotors' speed"
_SAG = 0.005  # of the voltage: it changes thrust by a hundredth, which is as much as weak drag
_USABLE = 0.5  # of the commands of a run: the least part that has to give a force
_LARGEST = 1e6  # of a table, in its units: squares of larger values may overflow, and no vehicle has them
_SAME = 1e-6  # in m/s: velocities of a table closer than this are those of one wind setting
_AT_ONCE = 2  # files: one is averaged while another is read or parsed


@dataclass(frozen=True)
class WindReading:
    """How to average recordings.

    Facts of the rig that are `given` replace those that a run states; an index has those of `rig`.
    """

    method: Literal["default", "thesis"] = "default"
    given: RigFacts = NONE_STATED
    rig: RigFacts = NONE_STATED


AS_THEY_ARE = WindReading()
# A verdict on forces and speeds needs no mount, which rig.toml may state later.
_ANYHOW = WindReading(given=RigFacts(wind=WindStand(yaw_deg=0, azimuth_deg=0), tachometer=Tachometer(markers=1)))


class Reduced(NamedTuple):
    """A recording as rows of points, with findings, its files (the load cell's first) and the facts of its rig.

    `by_tachometer` states whether tachometer readings give the rotors' speed.
    """

    points: list[dict[str, Any]]
    findings: tuple[Finding, ...]
    sources: tuple[Source, ...]
    rig: RigFacts
    by_tachometer: bool


def read_runs(
    runs: Sequence[Run | Path | str], *, index: Path | None = None, how: WindReading = AS_THEY_ARE
) -> DragExperiments:
    """Reduce runs of `cfid log wind`, and the recordings that an index lists, to experiments.

    Where a run was interrupted before a reading, the reading comes from the run that completes it; a run that ended
    before a motor turned, and that another run completes, is left out with a warning. Raises DataError and FitError
    that name file, line or run.
    """
    findings, sources, recordings = list[Finding](), list[Source](), list[Reduced]()
    if index is not None:
        rows, source, noted = read_wind_index(index)
        findings += noted
        sources.append(source)
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            recordings += pool.map(partial(reduce_row, how=how), rows.to_dict("records"))
    paths = [run.folder if isinstance(run, Run) else Path(run) for run in runs]
    known = {path: run for path in paths if (run := run_at(path)) is not None}
    completed = {resumed_by(run) for run in known.values()}
    for path in paths:
        later = steps_read_later(known[path], list(known.values())) if path in known else frozenset[int]()
        try:
            recordings.append(reduce_run(path, how, read_later=later))
        except (DataError, FitError) as error:
            if path.resolve().name not in completed:
                raise
            findings.append(warning("run-left-out", f"{error} It is left out.", "drag.*"))
    paths_by_content: dict[str, str] = {}
    for source in (recording.sources[0] for recording in recordings):
        if source.sha256 in paths_by_content:
            first = paths_by_content[source.sha256]
            raise DataError(f"{source.path}: the same recording as {first}: name each once.")
        paths_by_content[source.sha256] = source.path
    experiments = reduce_points(pd.DataFrame([point for recording in recordings for point in recording.points]))
    findings += [finding for recording in recordings for finding in recording.findings]
    return replace(
        experiments,
        findings=merged((*findings, *experiments.findings)),
        sources=(*sources, *(file for recording in recordings for file in recording.sources)),
        rigs=tuple(dict.fromkeys(recording.rig for recording in recordings)),
        tachometers=tuple(dict.fromkeys(recording.rig for recording in recordings if recording.by_tachometer)),
    )


def read_index(path: Path, *, how: WindReading = AS_THEY_ARE) -> DragExperiments:
    """Reduce the recordings that an index lists, a CSV file with one row per recording."""
    return read_runs((), index=path, how=how)


def verdict(run: Run) -> str:
    """State how many commands of a new run give a mean force. Raises DataError or FitError where few do."""
    points, steps = reduce_run(run.folder, _ANYHOW).points, len(StaircasePlan.of_run(run).steps)
    if len(points) < _USABLE * steps:
        raise FitError(f"only {len(points)} of {steps} commands give a force with the rotors' speed.")
    std_n = float(pd.DataFrame(points)[FORCE_STD].to_numpy().max())
    return f"{len(points)} of {steps} commands give a force, each to {1e3 * std_n:.2g} mN or better."


# From a recording to points


def reduce_run(path: Path, how: WindReading = AS_THEY_ARE, *, read_later: frozenset[int] = frozenset()) -> Reduced:
    """Reduce each command of a run of `cfid log wind`; commands without the rotors' speed are left out.

    A command without a reading in this run is skipped if it is in `read_later`: a run that completes this one has it.
    Raises DataError or FitError that name the run; FitError is for runs in which all commands lack the speed.
    """
    run = run_at(path)
    if run is None:
        raise DataError(f"{path}: not a run folder; other recordings are listed in an index file.")
    setting, record = setting_of(run), wrench_of(read_recording(path))
    record.require("Fx", "Fy", "Fz", purpose="drag")
    facts = how.given.over(run.header.rig)
    if not holds(run, COMMANDS):
        raise DataError(f"{run.device_file(COMMANDS)}: has no rows.")
    staircase = motors.reduce_run(record)  # its pauses give the tare, with wind and standing rotors
    steps = staircase.reduced.steady()
    readings = None
    with suppress(TakenBackError):
        readings = read_rows(run, READINGS) if holds(run, READINGS) else None
    volts = staircase.volts(steps)
    _refuse_unstated(record.name, facts, setting, typed=readings is not None)
    findings = [*(readings.findings if readings else ())]
    points, unknown = [], []
    for place, step in enumerate(steps):
        rpm = _typed_rpm(readings, staircase.began_s, step)
        if rpm is None and step.command in read_later:
            continue
        name, window_s = f"{record.name} command {step.command}", (step.begin_s, step.end_s)
        try:
            speed = _rotor_rad_s(record, window_s, rpm, facts, setting, name=name)
        except FitError as error:
            unknown.append(error)
            continue
        if rpm is None and not setting.is_reference:
            findings.append(_FROM_VIBRATION)
        point = _point(step.mean[:3], step.std_of_mean[:3], facts, setting)
        at = {"name": name, "command": step.command or 0, "rotor_rad_s": speed}
        points.append({**point, **at, "volts": math.nan if volts is None else float(volts[place])})
    if unknown and not points:
        raise unknown[0]
    return Reduced(
        points=points,
        findings=(
            *about_drag(record.findings),
            *about_drag(staircase.findings),
            *(finding.at(record.name) for finding in findings),
            *(warning("drag-rotor-speed-unknown", f"{error} It is left out.", "drag.*") for error in unknown),
        ),
        sources=(*staircase.sources, *([readings.source] if readings else [])),
        rig=facts,
        by_tachometer=readings is not None,
    )


def _typed_rpm(readings: Rows | None, began_s: float, step: Point) -> float | None:
    """Return the tachometer's reading at a step, None where there is none."""
    if readings is None:
        return None
    at_step = (readings.columns["command"] == step.command) & (readings.time_s - began_s >= step.begin_s)
    typed = readings.columns["rpm"][at_step]
    return float(typed[0]) if len(typed) else None


def read_wind_index(path: Path) -> tuple[pd.DataFrame, Source, tuple[Finding, ...]]:
    """Read an index of recordings in wind and without: a CSV file with one row per recording, each of one command.

    Empty fields become nan. Raises DataError with file and line for a value that is missing or not a number, and for a
    file in two rows.
    """
    rows, source, findings = read_rows_of_index(path, columns=INDEX_COLUMNS, optional=INDEX_OPTIONAL)
    table = pd.DataFrame([_indexed(row) for row in rows])
    repeated = table[table["loadcell"].duplicated()]
    if len(repeated):
        row = repeated.iloc[0]
        first = table["where"][table["loadcell"] == row["loadcell"]].iloc[0]
        raise DataError(f"{row['where']}: {row['loadcell']} is the file of {first} too: name it in one row.")
    return table, source, about_drag(findings)


def _indexed(row: IndexRow) -> dict[str, Any]:
    def maybe(column: str) -> float:
        return row.number(column) if row.fields.get(column) else math.nan

    from_s, to_s = maybe("from_s"), maybe("to_s")
    if not (math.isnan(from_s) and math.isnan(to_s)) and not 0 <= from_s < to_s:
        raise row.fault("a window begins at from_s, 0 or later, and ends at a later to_s.")
    return {
        "where": f"{row.path.name}:{row.line}",
        "command": row.whole("command", 0, FULL_COMMAND),
        "angle_deg": maybe("angle_deg"),
        "min_mps": row.number("wind_min_mps"),
        "max_mps": row.number("wind_max_mps"),
        "tach_rpm": maybe("tach_rpm"),
        "loadcell": row.file("loadcell"),
        "azimuth_deg": maybe("azimuth_deg"),
        "from_s": from_s,
        "to_s": to_s,
    }


def reduce_row(row: dict[str, Any], how: WindReading) -> Reduced:
    """Reduce a recording of an index; forces at standing rotors are not needed."""
    setting = WindSetting(
        angle_deg=None if math.isnan(row["angle_deg"]) else row["angle_deg"],
        min_mps=row["min_mps"],
        max_mps=row["max_mps"],
        azimuth_deg=None if math.isnan(row["azimuth_deg"]) else row["azimuth_deg"],
    )
    _refuse_other_wind(row, setting)
    facts = how.given.over(how.rig)
    rpm = None if math.isnan(row["tach_rpm"]) or not row["tach_rpm"] else row["tach_rpm"]
    name = f"{row['where']} {row['loadcell'].name}"
    read = wrench_of(read_recording(row["loadcell"]), gain=facts.loadcell.gain)
    record = read.without_stuck()
    _refuse_unstated(name, facts, setting, typed=rpm is not None)
    findings: list[Finding] = []
    points = []
    try:
        speed = 0.0
        mean = MeanForce(np.zeros(3), np.zeros(3), (0.0, 0.0), ())
        if row["command"] > DEAD_COMMAND:
            mean = _averaged(row, record, how)
            findings += mean.findings
            speed = _rotor_rad_s(record, mean.window_s, rpm, facts, setting, name=name)
            if rpm is None and not setting.is_reference:
                findings.append(_FROM_VIBRATION)
        at = {"name": name, "command": row["command"], "rotor_rad_s": speed, "volts": math.nan}
        points.append({**_point(mean.force_n, mean.std_n, facts, setting), **at})
    except CfidError as error:
        if record is read:
            raise
        text = f"too little is left: {error} The file is left out."
        findings = [warning("drag-load-cell-stuck", text, "drag.*")]
    return Reduced(
        points=points,
        findings=(*about_drag(record.findings), *(finding.at(record.path.name) for finding in findings)),
        sources=(record.source,),
        rig=facts,
        by_tachometer=bool(points) and rpm is not None,
    )


def _refuse_other_wind(row: dict[str, Any], setting: WindSetting) -> None:
    """Raise ConfigError for a row of an index that contradicts the wind run that contains its file."""
    run = run_holding(row["loadcell"])
    if run is None or run.header.kind != KIND:
        return
    stated, names = setting_of(run), ("angle_deg", "min_mps", "max_mps")
    refuse_contradiction(
        f"{row['where']}: {row['loadcell']}",
        {"command": row["command"], **{name: getattr(setting, name) for name in names}},
        {"command": run.header.requested.get("steps"), **{name: getattr(stated, name) for name in names}},
    )


class MeanForce(NamedTuple):
    """Mean force (3,) in the load cell's frame, N, with its standard uncertainty (3,), and its window."""

    force_n: Array
    std_n: Array
    window_s: Window
    findings: tuple[Finding, ...]


def _averaged(row: dict[str, Any], record: WrenchRecord, how: WindReading) -> MeanForce:
    window_s = None if math.isnan(row["from_s"]) else (row["from_s"], row["to_s"])
    average = mean_force
    if how.method == "thesis":
        average, record = mean_force_thesis, record.without_outliers()
    try:
        return average(
            time_s=record.time_s,
            force_n=record.force_n,
            command=row["command"],
            status=record.status,
            window_s=window_s,
        )
    except CfidError as error:
        by_hand = " The columns from_s and to_s of the index give a window." if isinstance(error, FitError) else ""
        raise type(error)(f"{row['where']}: {row['loadcell']}: {error}{by_hand}") from None


def mean_force(
    *, time_s: Array, force_n: Array, command: int, status: Words | None = None, window_s: Window | None = None
) -> MeanForce:
    """Average forces (n, 3) at times (n,) where they are steady, less the tare before and, if there is one, after.

    A given window is used unchanged. Raises DataError or FitError when there is no tare before the command, when no
    command is found, or when nothing is steady.
    """
    staircase = reduce_single(time_s=time_s, channels=force_n, command=command, status=status, window=window_s)
    (step,) = staircase.steady()
    return MeanForce(step.mean, step.std_of_mean, (step.begin_s, step.end_s), about_drag(staircase.findings))


def mean_force_thesis(
    *, time_s: Array, force_n: Array, command: int, status: Words | None = None, window_s: Window | None = None
) -> MeanForce:
    """Average forces (n, 3) as prepare_data of C.3.1 does: over a given window, less the mean of the first 500 samples.

    Without a given window, the steady one is used. Raises DataError when the record or its window is too short.
    """
    if len(time_s) <= _THESIS_TARE:
        raise DataError(f"{len(time_s)} samples: the thesis takes its tare from the first {_THESIS_TARE}.")
    begin_s, end_s = window_s or mean_force(time_s=time_s, force_n=force_n, command=command, status=status).window_s
    first, last = np.searchsorted(time_s, (begin_s, end_s))
    if last - first < _FEWEST:
        raise DataError(f"the window from {begin_s:g} to {end_s:g} s has {last - first} samples; {_FEWEST} are needed.")
    rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
    tare, steady = force_n[:_THESIS_TARE], force_n[first:last]
    std = [quiet_mean(part.T, rate_hz=rate_hz).std for part in (tare, steady)]
    return MeanForce(steady.mean(axis=0) - tare.mean(axis=0), np.hypot(*std), (begin_s, end_s), ())


def _rotor_rad_s(
    record: WrenchRecord, window_s: Window, rpm: float | None, facts: RigFacts, setting: WindSetting, *, name: str
) -> float:
    """Return the rotors' speed by a tachometer's reading, else from vibration; 0 for a reference.

    The loudest rotor represents all four, as the rotor at a tachometer does (C.3.1). Raises FitError when its speed
    cannot be found.
    """
    if rpm:
        return float(rotor_speed_rad_s(rpm, markers=facts.tachometer.markers or 1))
    if setting.is_reference:
        return 0.0
    rate_hz = (len(record.time_s) - 1) / float(record.time_s[-1] - record.time_s[0])
    if rate_hz < _ESTIMATED_FROM_HZ:
        raise FitError(f"{name}: {_UNKNOWN}, sampled at {rate_hz:.0f} Hz: 2000 are needed. Give the reading.")
    begin_s, end_s = window_s
    # At low rates, the blade pass of faster rotors would be aliased.
    expected = (_SLOWEST_RAD_S, _USUAL_RAD_S) if rate_hz < _ANY_FROM_HZ else None
    try:
        vibration = VibrationRecord(record, Rotors(expected_rad_per_s=expected))
        estimate = vibration.speed_in(begin_s, min(begin_s + _ESTIMATED_S, end_s), rotors=1)
    except CfidError as error:
        raise FitError(f"{name}: {_UNKNOWN}: {error} Give the reading.") from None
    if not estimate.accepted:
        raise FitError(f"{name}: {_UNKNOWN}: {joined(texts(estimate.findings, 'rejection'))} Give the reading.")
    return float(estimate.speed_rad_per_s)


def _point(force_n: Array, std_n: Array, facts: RigFacts, setting: WindSetting) -> dict[str, Any]:
    """Return the wind, and a force (3,) in the load cell's frame turned into the body frame, as a row."""
    turn = rotation_about_z(facts.yaw_in_wind_deg or 0.0)
    signed = force_n * (1, 1, -1 if facts.loadcell.flip_fz else 1)
    azimuth = facts.wind.azimuth_deg if setting.azimuth_deg is None else setting.azimuth_deg
    return {
        "angle_deg": math.nan if setting.angle_deg is None else setting.angle_deg,
        "min_mps": setting.min_mps,
        "max_mps": setting.max_mps,
        "azimuth_deg": azimuth or 0.0,  # a reference needs none
        **dict(zip(FORCE, turn @ signed, strict=True)),
        **dict(zip(FORCE_STD, np.sqrt(turn**2 @ std_n**2), strict=True)),
    }


_FROM_VIBRATION = note(
    "drag-speed-from-vibration",
    "without a tachometer reading the rotors' speed is estimated from vibration.",
    "drag.*",
)


def about_drag(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings about a recording as such about drag."""
    return tuple(replace(finding, quantities=("drag.*",)) for finding in findings)


def _refuse_unstated(name: str, stated: RigFacts, setting: WindSetting, *, typed: bool) -> None:
    """Raise ConfigError for a fact that a run in wind or a reference needs and that nothing states."""
    windy = not setting.is_reference
    azimuth_stated = setting.azimuth_deg is not None or stated.wind.azimuth_deg is not None
    lacking = {
        "yaw_deg": (stated.yaw_in_wind_deg is None, "the load cell's yaw"),
        "azimuth_deg": (windy and not azimuth_stated, "the wind's azimuth"),
        "markers": (windy and typed and stated.tachometer.markers is None, "the tachometer's markers"),
    }
    for setting_name, (is_missing, what) in lacking.items():
        if is_missing:
            raise ConfigError(f"{name}: no rig.toml stated {what} when it was recorded: give `{setting_name}`.")


# From points to experiments


def reduce_points(points: pd.DataFrame) -> DragExperiments:
    """Subtract the mean of the references at the same command (section 4.4.3).

    A row is the mean force at one command in one wind setting, in the body frame. References apply to all angles: the
    thesis has one series without wind for all three. Standing rotors have no rotor drag, so their forces are left out,
    as in the thesis.

    Raises DataError, with names, when a reference, an angle or a reading is missing.
    """
    nothing = DataError("no run has both wind and turning rotors: without them there is no drag to identify.")
    if points.empty:
        raise nothing
    refuse_impossible(points)
    still = points[points["max_mps"] == 0].groupby("command")
    reference = (
        still[[*FORCE, "volts"]]
        .mean()
        .join(still[FORCE_STD].agg(lambda std: np.linalg.norm(std) / len(std)), how="left")
        .join(still["name"].agg(", ".join))
    )
    windy = points[(points["max_mps"] > 0) & (points["command"] > DEAD_COMMAND)]
    if windy.empty:
        raise nothing
    findings = list[Finding]()
    lacking = windy[~windy["command"].isin(reference.index)]
    if len(lacking):
        text = (
            f"no run without wind at command {', '.join(map(str, sorted(set(lacking['command']))))}: "
            f"{counted(len(lacking), 'run in wind needs', 'runs in wind need')} it, as its thrust is subtracted from "
            "theirs. Record it with wind 0,0."
        )
        if len(lacking) == len(windy):
            raise DataError(text)
        findings.append(warning("drag-reference-missing", f"{text} They are left out.", "drag.*"))
        windy = windy.drop(lacking.index)
    thrust = reference.loc[windy["command"]]
    middle = (windy["min_mps"] + windy["max_mps"]).to_numpy() / 2
    # The wind has any speed between its lowest and highest reading. A single reading does not show the spread.
    spread = (windy["max_mps"] - windy["min_mps"]).to_numpy() / math.sqrt(12) / middle
    single = spread == 0
    if single.any():
        usual = UNSTATED_WIND_STD if single.all() else float(np.median(spread[~single]))
        spread = np.where(single, usual, spread)
        text = (
            f"{counted(int(single.sum()), 'run states', 'runs state')} a single wind speed: a relative standard "
            f"uncertainty of {100 * usual:.2g} % is taken, "
            f"{'by default' if single.all() else 'as in the median of the others'}."
        )
        findings.append(note("drag-wind-single-reading", text, "drag.*"))
    std = windy[FORCE_STD].to_numpy()
    noise_known = bool(np.all(std > 0))
    speed = windy["rotor_rad_s"].to_numpy()
    experiments = DragExperiments(
        command=windy["command"].to_numpy(np.float64),
        angle_deg=windy["angle_deg"].to_numpy(),
        velocity_mps=velocity_in_air(
            middle, angle_deg=windy["angle_deg"].to_numpy(), azimuth_deg=windy["azimuth_deg"].to_numpy()
        ),
        speed_sum_rad_s=ROTORS * speed,
        force_n=windy[FORCE].to_numpy() - thrust[FORCE].to_numpy(),
        force_std_n=std if noise_known else np.ones_like(std),
        reference_std_n=thrust[FORCE_STD].to_numpy() if noise_known else np.ones_like(std),
        noise_known=noise_known,
        setting=windy.groupby(["angle_deg", "azimuth_deg", "min_mps", "max_mps"]).ngroup().to_numpy(np.intp),
        wind_relative_std=spread,
        names=tuple(windy["name"]),
    )
    findings = [*_sagged(windy, thrust), *findings, *_out_of_order(reference)]
    return replace(experiments, findings=tuple(findings))


def refuse_impossible(points: pd.DataFrame) -> None:
    """Raise DataError for the first point that cannot be, and for an angle at which no run has wind.

    A missing wind speed would turn the runs of an angle into references. An empty field may have been filled with 0.
    """
    low, high, angle = points["min_mps"], points["max_mps"], points["angle_deg"]
    windy, turning = high > 0, points["command"] > DEAD_COMMAND
    for wrong, sentence in (
        (low.isna() | high.isna(), "no wind speed: give its lowest and highest reading, 0 and 0 for a reference."),
        (high > FASTEST_MPS, f"wind of {{max_mps:g}} m/s: give it in m/s, up to {FASTEST_MPS:g}."),
        (
            ~((low >= 0) & (low <= high)),
            "wind between {min_mps:g} and {max_mps:g} m/s: give the lowest reading, then the highest, none below zero.",
        ),
        (
            ~np.isfinite(points[[*FORCE, *FORCE_STD]]).all(axis=1),
            "its mean force is not a number: check the recording and its window.",
        ),
        (windy & angle.isna(), "wind of {max_mps:g} m/s without an angle: give the wind generator's."),
        (
            windy & ~angle.between(0, HIGHEST_DEG),
            f"an angle of {{angle_deg:g}} degrees: it counts from 0, straight above, to {HIGHEST_DEG:g}; the side is "
            "the azimuth's.",
        ),
        (
            windy & turning & ~(points["rotor_rad_s"] > 0),
            "a rotor speed of {rotor_rad_s:g} rad/s at command {command}: measure it, as drag grows with it.",
        ),
    ):
        if wrong.any():
            point = points[wrong].iloc[0]
            raise DataError(f"{point['name']}: {sentence.format(**point)}")
    for degrees, runs in points.groupby("angle_deg"):
        if degrees and not runs["max_mps"].any():
            raise DataError(
                f"{counted(len(runs), 'run')} at {degrees:g} degrees, none with wind ({runs['name'].iloc[0]}): give "
                "their wind speeds, or no angle where they are references."
            )


def velocity_in_air(speed_mps: Array, *, angle_deg: Array, azimuth_deg: Array) -> Array:
    """Return the vehicle's velocity relative to the air (n, 3) in the body frame, m/s (C.3.1)."""
    angle, azimuth = np.radians(angle_deg), np.radians(azimuth_deg)
    lateral = speed_mps * np.sin(angle)
    return np.stack([lateral * np.cos(azimuth), -lateral * np.sin(azimuth), speed_mps * np.cos(angle)], axis=-1)


def _sagged(windy: pd.DataFrame, thrust: pd.DataFrame) -> list[Finding]:
    """Warn where the battery's voltage differs from that of the reference: the thrust without wind then differs too."""
    change = windy["volts"].to_numpy() / thrust["volts"].to_numpy() - 1
    off = np.abs(change) > _SAG  # false where the voltage was not logged
    if not off.any():
        return []
    largest = int(np.nanargmax(np.abs(change)))
    text = (
        f"{counted(int(off.sum()), 'run')} had another battery voltage than their reference, "
        f"{windy['name'].iloc[largest]} by {100 * change[largest]:+.1f} %: thrust follows it, and counts as drag along "
        "z. Feed the vehicle from a supply of constant voltage."
    )
    return [warning("drag-battery-differs", text, "drag.*")]


def _out_of_order(reference: pd.DataFrame) -> list[Finding]:
    findings = []
    for low, high in itertools.pairwise(reference.index):
        if reference["fz_n"][high] <= reference["fz_n"][low]:
            text = (
                f"without wind, command {low} lifts {reference['fz_n'][low]:.4f} N ({reference['name'][low]}) and "
                f"command {high} no more than {reference['fz_n'][high]:.4f} N ({reference['name'][high]}): were their "
                "files exchanged?"
            )
            findings.append(rejection("drag-references-out-of-order", text, "drag.*"))
    return findings


# From a table of forces to experiments


def read_forces(path: Path) -> DragExperiments:
    """Read a CSV file of reduced forces. Raises DataError with the file, and the line of an invalid number."""
    try:
        table = read_table(path)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file.", code="no-file") from None
    missing = [name for name in TABLE_COLUMNS if name not in table.heads]
    if missing:
        heads = ", ".join(table.heads)
        raise DataError(
            f"{path}: no column {', '.join(missing)} among {heads}: its header should be {','.join(TABLE_COLUMNS)}.",
            code="no-column",
        )
    values = {column.head: column.values for column in reversed(table.columns) if column.head in TABLE_COLUMNS}
    lines = [f"{path}:{table.line_of_row(row)}" for row in range(len(values["command"]))]
    experiments = experiments_from_table(pd.DataFrame(values), lines)
    findings = tuple(finding.at(path.name) for finding in experiments.findings)
    return replace(experiments, findings=findings, sources=(table.source,))


def experiments_from_table(table: pd.DataFrame, names: Sequence[str] | None = None) -> DragExperiments:
    """Return experiments of a table of reduced forces; rows with standing rotors or without wind are left out.

    Such a table states no noise: all forces count equally, half of each variance is that of the reference, which was
    subtracted at the same command, and the noise is estimated from the models' residuals. Rows of equal velocity form
    one wind setting, whose speed has a relative standard uncertainty of 5 %. `names` (n,) are those of the rows.

    Raises DataError when a row has a value that no experiment has, or when nothing is left to fit.
    """
    rows = table[list(TABLE_COLUMNS)].astype(np.float64).reset_index(drop=True)
    labels = np.array([f"row {row + 1}" for row in range(len(rows))] if names is None else names)
    for column, values in rows.items():
        finite = np.isfinite(values)
        if not finite.all():
            raise DataError(f"{labels[~finite][0]}: no number in column '{column}'.", code="no-number")
        wrong = (values.abs() > _LARGEST) | ((values < 0) & (column == "speed_sum_rad_s"))
        if wrong.any():
            raise DataError(f"{labels[wrong][0]}: {column} is {values[wrong].iloc[0]:g}: no vehicle has that.")
    velocity = rows[["vx_mps", "vy_mps", "vz_mps"]].to_numpy()
    used = (np.linalg.norm(velocity, axis=1) > _SAME) & (rows["speed_sum_rad_s"].to_numpy() > 0)
    if not used.any():
        raise DataError("no row has both wind and turning rotors: without them there is no drag.")
    rows, velocity, labels = rows[used], velocity[used], labels[used]
    command, speed_sum = rows["command"].to_numpy(), rows["speed_sum_rad_s"].to_numpy()
    return DragExperiments(
        command=command,
        angle_deg=rows["angle_deg"].to_numpy(),
        velocity_mps=velocity,
        speed_sum_rad_s=speed_sum,
        force_n=rows[FORCE].to_numpy(),
        force_std_n=np.ones_like(velocity),
        reference_std_n=np.ones_like(velocity),
        noise_known=False,
        setting=np.unique(np.rint(velocity / _SAME), axis=0, return_inverse=True)[1].reshape(-1),
        wind_relative_std=np.full(len(rows), UNSTATED_WIND_STD),
        names=tuple(labels.tolist()),
    )
