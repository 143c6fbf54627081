"""Steady points from tables: settled points, a thrust stand's record over time, readings of scales."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import CfidError, DataError
from cfid.estimate.staircase import mean_beside, reduce_staircase
from cfid.motors.maps.evidence import Evidence, Reduced, Stand, line_of, speed_findings, staircase_findings
from cfid.motors.points import MotorPoints, joined, per_motor
from cfid.motors.stand_points import points_of, reduce_speeds
from cfid.records.facts import NONE_STATED, RigFacts
from cfid.records.run import Run
from cfid.records.tables.stand import StandTable, read_stand_table
from cfid.records.tables.times import run_at
from cfid.records.tables.vehicle import READINGS, holds, read_commands, read_rows

Array = npt.NDArray[np.float64]


def of_table(table: StandTable, stand: Stand, facts: RigFacts = NONE_STATED) -> Evidence:
    """Take a table's points, or reduce a record over time."""
    tachometer = _is_tachometers(table)
    stand = stand.where(facts) if tachometer else replace(stand, markers=stand.markers or 1)
    found = _of_record(table, stand) if table.time_s is not None else _of_points(table, stand)
    return replace(found, tachometers=(stand.facts,)) if tachometer else found


def _is_tachometers(table: StandTable) -> bool:
    """Return whether speeds are a tachometer's, which counts markers; a thrust stand reports speeds of rotors."""
    return table.speeds == "series"


def _of_points(table: StandTable, stand: Stand) -> Evidence:
    """Take a table of settled points; several series of one rotor are as many points."""
    share = 1 if table.motors is not None else stand.motors or 1
    points = per_motor(
        MotorPoints(command=table.command, thrust_n=table.thrust_n, torque_nm=table.torque_nm), motors=share
    )
    speeds, vbat, findings = table.speeds_rad_s, table.vbat_v, table.findings
    if speeds is not None:
        one_speed = table.square_mean_speed_rad_s
        assert one_speed is not None
        series = list(speeds.T) if table.speeds == "series" else [one_speed]
        divided = [stand.divided(one, table.path.name) for one in series]
        sets = [MotorPoints(command=table.command, speed_rad_s=one) for one, _ in divided]
        findings += divided[0][1]
        if table.thrust_n is None:
            points = joined(*sets)
        elif len(sets) == 1:
            points = MotorPoints(**{**vars(points), "speed_rad_s": sets[0].speed_rad_s})
        else:
            points = joined(points, *sets)
    if vbat is not None:
        vbat = np.resize(vbat, len(points.command)) if len(points.command) % len(vbat) == 0 else None
    return Evidence(points=points, vbat_v=vbat, findings=findings, sources=(table.source,), paths=(table.path,))


def _of_record(table: StandTable, stand: Stand) -> Evidence:
    """Reduce a thrust stand's record over time: thrust, speed and battery in the steady window of each command."""
    assert table.time_s is not None
    if table.thrust_n is None:
        return _of_speeds(table, stand)
    changes = np.flatnonzero(np.diff(table.command, prepend=np.nan))
    try:
        found = reduce_staircase(
            time_s=table.time_s,
            channels=table.thrust_n[:, np.newaxis],
            command_time_s=table.time_s[changes],
            commands=np.outer(table.command[changes], (1, 0, 0, 0)),  # the table states how many motors ran
            thrust=0,
        )
        settled = found.steady()
    except CfidError as error:
        raise type(error)(f"{table.path}: {error}") from None
    shown, volts = (
        None if column is None else mean_beside(settled, table.time_s, column)
        for column in (table.square_mean_speed_rad_s, table.vbat_v)
    )
    speed, findings = (None, ()) if shown is None else stand.divided(shown, table.path.name)
    points = per_motor(points_of(settled, thrust=0), motors=1 if table.motors is not None else stand.motors or 1)
    return Evidence(
        points=replace(points, speed_rad_s=speed),
        vbat_v=volts,
        lines=tuple(line_of(point, table.path.name) for point in found.points),
        findings=(*table.findings, *findings, *staircase_findings(found, table.path.name)),
        sources=(table.source,),
        reduced=(
            Reduced(name=table.path.stem, time_s=table.time_s, thrust_n=table.thrust_n, staircase=found, thrust=0),
        ),
        paths=(table.path,),
    )


def _of_speeds(table: StandTable, stand: Stand) -> Evidence:
    """Reduce a record over time of speeds alone."""
    shown = table.square_mean_speed_rad_s
    if table.time_s is None or shown is None:
        raise DataError(f"{table.path}: a record over time without a thrust or a speed cannot be reduced.")
    changes = np.flatnonzero(np.diff(table.command, prepend=np.nan))
    try:
        found = reduce_speeds(
            table.time_s, shown[:, np.newaxis], table.time_s[changes], np.outer(table.command[changes], (1, 0, 0, 0))
        )
        settled = found.steady()
    except CfidError as error:
        raise type(error)(f"{table.path}: {error}") from None
    speed, findings = stand.divided(np.array([point.mean[0] for point in settled]), table.path.name)
    return Evidence(
        points=MotorPoints(command=np.array([float(point.command or 0) for point in settled]), speed_rad_s=speed),
        lines=tuple(line_of(point, table.path.name) for point in found.points),
        findings=(*table.findings, *findings, *speed_findings(found, table.path.name)),
        sources=(table.source,),
        paths=(table.path,),
    )


class ScalesRecord(NamedTuple):
    """What scales showed: commands (n,), grams (n,), how many motors ran, and the facts of the rig."""

    command: Array
    grams: Array
    motors: int
    facts: RigFacts


def read_scales(path: Path, motors: int | None, facts: RigFacts) -> ScalesRecord:
    """Read a run of scales, or a table, which was recorded with `facts`. Raises DataError."""
    run = run_at(path)
    if run is not None:
        return _scales_of_run(run)
    table = read_stand_table(path)
    if table.grams is None:
        raise DataError(f"{path}: no column 'grams': the scales' display at each cmd.")
    return ScalesRecord(table.command, table.grams, motors or 1, facts)


def _scales_of_run(run: Run) -> ScalesRecord:
    """Take typed readings, or the mean of what the scales sent in the second half of each step."""
    motors = len(run.header.asked.get("motors", ())) or 1
    if holds(run, READINGS):
        rows = read_rows(run, READINGS)
        if "grams" not in rows.columns:
            raise DataError(f"{rows.source.path}: no column 'grams': this is no run of `cfid log scales`.")
        return ScalesRecord(rows.columns["command"], rows.columns["grams"], motors, run.header.rig)
    if not holds(run, "scales"):
        raise DataError(f"{run.folder}: holds no scales: `cfid log scales` records them.")
    shown, (log, commands) = read_rows(run, "scales"), read_commands(run)
    ends_s = np.append(log.time_s[1:], shown.time_s[-1])
    command, grams = [], []
    for begin_s, end_s, step in zip(log.time_s, ends_s, commands.max(axis=1), strict=True):
        inside = (shown.time_s > (begin_s + end_s) / 2) & (shown.time_s <= end_s)
        if inside.any():
            command.append(step)
            grams.append(shown.columns["grams"][inside].mean())
    return ScalesRecord(np.array(command), np.array(grams), motors, run.header.rig)
