"""Reduce recordings in wind, from an index or from `cfid log wind`, to one mean force per command."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd  # noqa: F401  (before two threads load it at once)

from cfid.console.facts import assumed
from cfid.drag.wind.frames import AZIMUTH_DEG, MARKERS, YAW_DEG, std_turned_about_z
from cfid.drag.wind.index import IndexedRun
from cfid.drag.wind.mean_forces import MeanForce, mean_force, mean_force_thesis, of_point
from cfid.drag.wind.plan import KIND, WindSetting, setting_of
from cfid.drag.wind.reduction import WindForce
from cfid.errors import CfidError, DataError, FitError
from cfid.estimate.staircase import Point
from cfid.findings import Finding, joined, note, texts, warning
from cfid.motors import data as motors
from cfid.motors.points import rotor_speed_rad_s
from cfid.motors.vibration.data import Rotors, VibrationRecord
from cfid.recordings.read import read_recording
from cfid.recordings.vehicle import COMMANDS, READINGS, Rows, TakenBackError, holds, read_rows
from cfid.recordings.wrench import WrenchRecord, turn_about_z, wrench_of
from cfid.records.parameters import Source
from cfid.records.rig_file import NONE_STATED, RigFacts, WindStand
from cfid.records.run import refuse_contradiction, run_at, run_holding
from cfid.units import DEAD_COMMAND

_ESTIMATED_S = 3.0  # of a window: long enough to find a speed to a thousandth
# At lower rates, the blade-pass line of a rotor at 3000 rad/s is aliased onto others.
_ESTIMATED_FROM_HZ = 1990.0
_ANY_FROM_HZ = 3300.0  # the same limit for 5000 rad/s
_SLOWEST_RAD_S, _USUAL_RAD_S = 200.0, 3000.0  # the rotors of a Crazyflie stay below the latter
_UNKNOWN = "no tachometer reading, and vibration does not show the rotors' speed"
_BY_HAND = "The columns from_s and to_s of the index give a window by hand."
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


@dataclass(frozen=True, kw_only=True)
class ReducedRecording:
    """The mean forces of one recording, its files with the load cell's first, and findings about it.

    `rig` has the facts that were used; `by_tachometer` states whether tachometer readings give the rotors' speed.
    """

    forces: tuple[WindForce, ...]
    findings: tuple[Finding, ...]
    sources: tuple[Source, ...]
    rig: RigFacts
    by_tachometer: bool


def reduce_index(rows: Sequence[IndexedRun], how: WindReading) -> list[ReducedRecording]:
    """Reduce the recordings of an index, several at once. Raises DataError or FitError that name row and file."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        return list(pool.map(partial(_reduce_row, how=how), rows))


def reduce_run(path: Path, how: WindReading, *, read_later: frozenset[int] = frozenset()) -> ReducedRecording:
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
    points = staircase.reduced.steady()
    readings = None
    with suppress(TakenBackError):
        readings = read_rows(run, READINGS) if holds(run, READINGS) else None
    volts = staircase.volts(points)
    findings = [*_assumptions(facts, setting, typed=readings is not None), *(readings.findings if readings else ())]
    forces, unknown = [], []
    for place, point in enumerate(points):
        name, typed = f"{record.name} command {point.command}", _typed(readings, staircase.began_s, point)
        if typed is None and point.command in read_later:
            findings.append(_read_in_next(point.command))
            continue
        try:
            made = _force(of_point(point), record, typed, facts, name=name, command=point.command or 0, at=setting)
        except FitError as error:
            unknown.append(error)
            continue
        made = replace(made, at_s=staircase.began_s + (point.begin_s + point.end_s) / 2)
        findings += _vibration_used(typed, setting)
        forces.append(made if volts is None else replace(made, volts=float(volts[place])))
    if unknown and not forces:
        raise unknown[0]
    return ReducedRecording(
        forces=tuple(forces),
        findings=(
            *_notes(record),
            *(replace(one, quantities=("drag.*",)) for one in staircase.findings),
            *(one.at(record.name) for one in findings),
            *(warning("drag-rotor-speed-unknown", f"{error} It is left out.", "drag.*") for error in unknown),
        ),
        sources=(*staircase.sources, *([readings.source] if readings else [])),
        rig=_with_yaw(facts),
        by_tachometer=readings is not None,
    )


def _reduce_row(row: IndexedRun, how: WindReading) -> ReducedRecording:
    """Reduce a recording; forces at standing rotors are not needed."""
    _refuse_other_wind(row)
    facts = how.given.over(how.rig)
    read = wrench_of(read_recording(row.loadcell), gain=facts.loadcell.gain)
    moving = read.without_stuck()
    record = moving.without_outliers()
    findings = _assumptions(facts, row.setting, typed=bool(row.tach_rpm))
    if row.command > DEAD_COMMAND:
        try:
            mean = _averaged(row, record, how)
        except CfidError as error:
            if moving is read:
                raise
            return _left_out(record, facts, str(error))
        findings += [*mean.findings, *_vibration_used(row.tach_rpm, row.setting)]
        made = _force(mean, record, row.tach_rpm, facts, name=row.name, command=row.command, at=row.setting)
        if record.begin_s is not None:
            made = replace(made, at_s=record.begin_s + sum(mean.window_s) / 2)
    else:
        still = np.zeros(3)
        made = WindForce(name=row.name, command=row.command, setting=row.setting, force_n=still, force_std_n=still)
    return ReducedRecording(
        forces=(made,),
        findings=(*_notes(record), *(one.at(record.path.name) for one in findings)),
        sources=(record.source,),
        rig=_with_yaw(facts),
        by_tachometer=bool(row.tach_rpm),
    )


def _left_out(record: WrenchRecord, facts: RigFacts, fault: str) -> ReducedRecording:
    """Return no force for a recording whose load cell was stuck for most of it."""
    text = f"too little is left: {fault} The file is left out."
    return ReducedRecording(
        forces=(),
        findings=(*_notes(record), warning("drag-load-cell-stuck", text, "drag.*").at(record.path.name)),
        sources=(record.source,),
        rig=_with_yaw(facts),
        by_tachometer=False,
    )


def _with_yaw(facts: RigFacts) -> RigFacts:
    """Return the facts with the default yaw if none was stated."""
    return facts if facts.yaw_in_wind_deg is not None else RigFacts(wind=WindStand(yaw_deg=YAW_DEG)).over(facts)


def _refuse_other_wind(row: IndexedRun) -> None:
    """Raise ConfigError for a row of an index that contradicts the wind run that contains its file."""
    run = run_holding(row.loadcell)
    if run is None or run.header.kind != KIND:
        return
    given, own = row.setting, setting_of(run)
    names = ("angle_deg", "min_mps", "max_mps")
    refuse_contradiction(
        f"{row.where}: {row.loadcell}",
        {"command": row.command, **{name: getattr(given, name) for name in names}},
        {"command": run.header.requested.get("steps"), **{name: getattr(own, name) for name in names}},
    )


def _force(
    mean: MeanForce,
    record: WrenchRecord,
    typed_rpm: float | None,
    stated: RigFacts,
    *,
    name: str,
    command: int,
    at: WindSetting,
) -> WindForce:
    """Return a mean force in the body frame, with wind and rotor speed. Raises FitError for an unknown speed."""
    yaw_deg = YAW_DEG if stated.yaw_in_wind_deg is None else stated.yaw_in_wind_deg
    if typed_rpm:
        speed = float(rotor_speed_rad_s(typed_rpm, markers=stated.tachometer.markers or MARKERS))
    else:
        speed = 0.0 if at.is_reference else _speed_from_vibration(record, mean, name=name)
    return WindForce(
        name=name,
        command=command,
        setting=replace(at, azimuth_deg=stated.wind.azimuth_deg) if at.azimuth_deg is None else at,
        force_n=turn_about_z(mean.force_n * (1, 1, -1 if stated.loadcell.flip_fz else 1), yaw_deg=yaw_deg),
        force_std_n=std_turned_about_z(mean.std_n, yaw_deg=yaw_deg),
        rotor_rad_s=speed,
    )


def _speed_from_vibration(record: WrenchRecord, mean: MeanForce, *, name: str) -> float:
    """Return the speed of the loudest rotor, which represents all four, as a rotor at a tachometer does (C.3.1).

    Raises FitError when it cannot be found.
    """
    rate_hz = (len(record.time_s) - 1) / float(record.time_s[-1] - record.time_s[0])
    if rate_hz < _ESTIMATED_FROM_HZ:
        raise FitError(f"{name}: {_UNKNOWN}, sampled at {rate_hz:.0f} Hz: 2000 are needed. Give the reading.")
    begin_s, end_s = mean.window_s
    # At low rates, the blade pass of faster rotors would be aliased.
    expected = (_SLOWEST_RAD_S, _USUAL_RAD_S) if rate_hz < _ANY_FROM_HZ else None
    try:
        vibration = VibrationRecord(record, Rotors(expected_rad_per_s=expected))
        found = vibration.speed_in(begin_s, min(begin_s + _ESTIMATED_S, end_s), rotors=1)
    except CfidError as error:
        raise FitError(f"{name}: {_UNKNOWN}: {error} Give the reading.") from None
    if not found.accepted:
        raise FitError(f"{name}: {_UNKNOWN}: {joined(texts(found.findings, 'rejection'))} Give the reading.")
    return float(found.speed_rad_per_s)


def _averaged(row: IndexedRun, record: WrenchRecord, how: WindReading) -> MeanForce:
    try:
        return (mean_force_thesis if how.method == "thesis" else mean_force)(
            time_s=record.time_s,
            force_n=record.force_n,
            command=row.command,
            status=record.status,
            window_s=row.window_s,
        )
    except CfidError as error:
        by_hand = f" {_BY_HAND}" if isinstance(error, FitError) else ""
        raise type(error)(f"{row.where}: {row.loadcell}: {error}{by_hand}") from None


def _typed(readings: Rows | None, began_s: float, point: Point) -> float | None:
    """Return the tachometer's reading at a point, None where there is none."""
    if readings is None:
        return None
    there = (readings.columns["command"] == point.command) & (readings.time_s - began_s >= point.begin_s)
    typed = readings.columns["rpm"][there]
    return float(typed[0]) if len(typed) else None


def _read_in_next(command: int) -> Finding:
    text = (
        f"command {command} was held here and its reading was typed in the run that completes this one: it is taken "
        "from there."
    )
    return note("drag-reading-in-next-run", text, "drag.*")


def _notes(record: WrenchRecord) -> list[Finding]:
    return [replace(one, quantities=("drag.*",)) for one in record.findings]


def _vibration_used(typed_rpm: float | None, at: WindSetting) -> list[Finding]:
    if typed_rpm or at.is_reference:
        return []
    text = "without a tachometer reading the rotors' speed is estimated from vibration."
    return [note("drag-speed-from-vibration", text, "drag.*")]


def _assumptions(stated: RigFacts, at: WindSetting, *, typed: bool) -> list[Finding]:
    """Return notes on facts that a run in wind or a reference needs and that were not stated."""
    windy = not at.is_reference
    needed: Mapping[str, tuple[str, bool]] = {
        "yaw_deg": (f"a yaw of {YAW_DEG:g} degrees on the load cell is", stated.yaw_in_wind_deg is None),
        "azimuth_deg": (
            f"an azimuth of {AZIMUTH_DEG:.2f} degrees is",
            windy and at.azimuth_deg is None and stated.wind.azimuth_deg is None,
        ),
        "markers": (
            f"{MARKERS} markers of the tachometer are",
            windy and typed and stated.tachometer.markers is None,
        ),
    }
    return [note("fact-assumed", assumed(what, name), "drag.*") for name, (what, missing) in needed.items() if missing]
