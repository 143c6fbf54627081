"""Steady points from load-cell files, runs and tables, and from the speeds that a run holds."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import CfidError, ConfigError, DataError, FitError
from cfid.estimate.staircase import FZ, NeverRanError, reduce_single
from cfid.findings import Finding, warning
from cfid.motors.data import RunStaircase, channels_of, reduce_run, without_dead
from cfid.motors.maps.evidence import (
    Evidence,
    Reduced,
    Stand,
    line_of,
    speed_findings,
    staircase_findings,
    together,
)
from cfid.motors.maps.table_data import of_table
from cfid.motors.maps.thesis import reduce_thesis
from cfid.motors.maps.warm_up import warm_up
from cfid.motors.points import MotorPoints, per_motor, rotor_speed_rad_s
from cfid.motors.stand_points import points_of, reduce_speeds
from cfid.motors.vibration.data import Rotors, speeds_from_vibration
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from cfid.recordings.resumed import with_completed
from cfid.recordings.stand import StandTable, holds_stand, read_stand, stand_of
from cfid.recordings.vehicle import (
    READINGS,
    SCALES,
    TACHOMETER,
    VEHICLE_LOG,
    Rows,
    holds,
    read_commands,
    read_rows,
    reported_speeds_rad_s,
    shown_at_commands,
)
from cfid.recordings.wrench import LOADCELL, WrenchRecord, wrench_of
from cfid.records.run import Run, refuse_contradiction, run_at
from cfid.units import MOTORS

Array = npt.NDArray[np.float64]
One = Evidence | StandTable | Run | Path | str
Points = One | Sequence[One]


def evidence_of(points: Points, stand: Stand | None = None, rotors: Rotors | None = None) -> Evidence:
    """Return the steady points of all runs and tables. Raises ConfigError where none is given."""
    many = [points] if isinstance(points, One) else list(points)
    if not many:
        raise ConfigError("nothing to fit: give at least one run or table.")
    return together([_evidence_in(one, stand or Stand(), rotors) for one in many])


def _evidence_in(one: One, stand: Stand, rotors: Rotors | None) -> Evidence:
    if isinstance(one, Evidence):
        return one
    if isinstance(one, StandTable):
        return of_table(one, stand)
    path = one.folder if isinstance(one, Run) else Path(one)
    run = run_at(path)
    if run is not None and not holds_stand(path):
        return of_run(run, stand, rotors=rotors)
    how = How(motors=stand.motors)
    return of_table(stand_of(read_stand(path, how), how), stand)


def of_file(command: int, path: Path, stand: Stand, *, method: str, rotors: Rotors | None = None) -> Evidence:
    """Reduce a load cell's file of one command between two pauses, as the thesis recorded them."""
    record = wrench_of(read_recording(path), gain=stand.facts.loadcell.gain)
    if command == 0:  # motors at rest give no thrust, whatever the cell's bias is
        zero = np.zeros(1)
        return _plain(record, MotorPoints(command=zero, thrust_n=zero, torque_nm=zero))
    channels = channels_of(record, flip_fz=bool(stand.flip_fz))
    try:
        if method == "thesis" and stand.window_s is not None:
            return _plain(record, _thesis_point(command, record.time_s, channels, stand.window_s, stand.motors or 1))
        found = reduce_single(
            time_s=record.time_s, channels=channels, command=command, status=record.status, window=stand.window_s
        )
    except NeverRanError as error:
        left_out = warning("file-left-out", f"{error} It is left out.").at(str(path))
        return _plain(record, MotorPoints(command=np.zeros(0)), left_out)
    except CfidError as error:
        raise type(error)(f"{path}: {error}") from None
    staircase = RunStaircase(record=record, reduced=found, run=None, began_s=math.nan, sources=(record.source,))
    return _evidence(staircase, stand, motors=stand.motors or 1, rotors=rotors)


def _thesis_point(
    command: int, time_s: Array, channels: Array, window_s: tuple[float, float], motors: int
) -> MotorPoints:
    thrust, torque = (
        reduce_thesis(time_s, channels[:, at], from_s=window_s[0], to_s=window_s[1]).mean for at in (2, 5)
    )
    points = MotorPoints(command=np.array([float(command)]), thrust_n=np.array([thrust]), torque_nm=np.array([torque]))
    return per_motor(points, motors=motors)


def _plain(record: WrenchRecord, points: MotorPoints, *findings: Finding) -> Evidence:
    """Return points of a file that needs no reduction, or none."""
    return Evidence(
        points=points,
        findings=(*record.findings, *findings),
        sources=(record.source,),
        paths=(record.path,),
    )


def of_run(run: Run, stand: Stand, *, rotors: Rotors | None = None) -> Evidence:
    """Return what a run measured of a motor: a staircase on the load cell, typed readings, or speeds it reported."""
    ran = run.header.requested.get("motors")
    refuse_contradiction(run.folder.name, {"`motors`": stand.motors}, {"`motors`": ran and len(ran)})
    stand = stand.where(run.header.rig)
    if holds(run, LOADCELL):
        return of_staircase(wrench_of(read_recording(run.folder)), stand, rotors)
    if holds(run, READINGS) and "rpm" in _typed(run):
        return _of_readings(run, stand)
    if holds(run, TACHOMETER):
        return _of_tachometer(run, stand)
    if SCALES in run.header.devices or "grams" in _typed(run):
        raise DataError(
            f"{run.folder}: a run of scales gives no map of its own. `cfid fit thrust` verifies one of other runs with "
            f"it: `verify` {run.folder.name}."
        )
    if _typed(run):
        raise DataError(f"{run.folder}: no reading was typed in it.")
    if holds(run, VEHICLE_LOG):
        return _of_speeds(run)
    raise DataError(f"{run.folder}: a run of {run.header.kind}, in which no motor was measured.")


def of_completed(run: Run) -> dict[str, Evidence]:
    """Return the runs that a run completes, by name and as its fit takes them, without those that give nothing.

    Raises DataError where the run.toml of one is invalid.
    """
    found: dict[str, Evidence] = {}
    for part in with_completed(run)[:-1]:
        with suppress(DataError, FitError):
            found[part.folder.resolve().name] = of_run(part, Stand())
    return {name: evidence for name, evidence in found.items() if len(evidence.points.command)}


def _typed(run: Run) -> tuple[str, ...]:
    """Return the columns of the readings that were requested of the operator."""
    return run.header.devices[READINGS].columns if READINGS in run.header.devices else ()


def of_staircase(record: WrenchRecord, stand: Stand, rotors: Rotors | None = None) -> Evidence:
    """Return the steps of a run on the load cell."""
    found = reduce_run(record, flip_fz=bool(stand.flip_fz))
    assert found.run is not None
    expected = tuple(int(step) for step in found.run.header.requested.get("steps", ()) if step)
    return _evidence(found, stand, motors=None, expected=expected, rotors=rotors)


def _evidence(
    found: RunStaircase,
    stand: Stand,
    *,
    motors: int | None,
    expected: tuple[int, ...] = (),
    rotors: Rotors | None = None,
) -> Evidence:
    """Return a reduced record's settled points, per motor; speeds are from vibration where none were reported."""
    record, settled = found.record, [point for point in found.reduced.points if point.settled]
    points = MotorPoints(command=np.zeros(0))
    about_speed: tuple[Finding, ...] = ()
    if settled:
        speed, std = found.reported_speeds(settled), None
        if speed is None and rotors is not None:
            speed, std, about_speed = speeds_from_vibration(settled, record, rotors, motors=motors)
        points = replace(points_of(settled, motors=motors), speed_rad_s=speed, speed_std_rad_s=std)
    thrust_n = record.force_n[:, FZ] * (-1 if stand.flip_fz else 1)
    vbat_v = found.volts(settled)
    middle_s = np.array([(point.begin_s + point.end_s) / 2 for point in settled])
    drifts, about_drift = warm_up(points, middle_s, vbat_v, record.name)
    return Evidence(
        points=points,
        vbat_v=vbat_v,
        motors=np.array([float(len(point.motors) or motors or 1) for point in settled]),
        lines=tuple(line_of(point, record.name) for point in found.reduced.points),
        findings=(
            *record.findings,
            *staircase_findings(found.reduced, record.name),
            *found.about_files,
            *found.dead,
            *about_speed,
            *about_drift,
        ),
        sources=found.sources,
        reduced=(Reduced(name=record.name, time_s=record.time_s, thrust_n=thrust_n, staircase=found.reduced),),
        paths=(record.path,),
        expected=expected,
        loadcells=(stand.facts,),
        drifts=drifts,
    )


def _of_readings(run: Run, stand: Stand) -> Evidence:
    """Return the tachometer readings that the operator typed."""
    rows = read_rows(run, READINGS)
    return _of_shown(run, stand, rows, rows.columns["command"], rows.columns["rpm"])


def _of_tachometer(run: Run, stand: Stand) -> Evidence:
    """Return what a tachometer sent at each command, but not in the pauses: some keep showing the last speed."""
    rows, command, rpm = shown_at_commands(run, TACHOMETER, "rpm")
    ran = command > 0
    if not ran.any():
        raise DataError(f"{run.folder}: no command was held to its end.")
    return _of_shown(run, stand, rows, command[ran], rpm[ran])


def _of_shown(run: Run, stand: Stand, rows: Rows, command: Array, rpm: Array) -> Evidence:
    speed, findings = stand.divided(rotor_speed_rad_s(rpm, markers=1), run.folder.name)
    return Evidence(
        points=MotorPoints(command=command, speed_rad_s=speed),
        findings=(*rows.findings, *findings),
        sources=(rows.source,),
        paths=(run.folder,),
        tachometers=(stand.facts,),
    )


def _of_speeds(run: Run) -> Evidence:
    """Reduce the speeds that the vehicle reported, as a staircase, to the mean of the motors that ran."""

    rows, (log, commands) = read_rows(run, VEHICLE_LOG), read_commands(run)
    speeds = reported_speeds_rad_s(rows)
    ran, dead = without_dead([motor for motor in MOTORS if commands[:, motor - 1].any()], speeds, run.folder.name)
    if not ran or not all(motor in speeds for motor in ran):
        raise DataError(f"{run.folder}: the vehicle's log has no speeds: an RPM deck or brushless motors report them.")
    try:
        begin_s, turning = rows.time_s[0], np.column_stack([speeds[motor] for motor in ran])
        found = reduce_speeds(rows.time_s - begin_s, turning, log.time_s - begin_s, commands)
    except CfidError as error:
        raise type(error)(f"{run.folder}: {error}") from None
    settled = found.steady()
    return Evidence(
        points=MotorPoints(
            command=np.array([float(point.command or 0) for point in settled]),
            speed_rad_s=np.array([point.mean.mean() for point in settled]),
            speed_std_rad_s=np.array([np.sqrt((point.std_of_mean**2).sum()) / len(ran) for point in settled]),
        ),
        lines=tuple(line_of(point, run.folder.name) for point in found.points),
        findings=(*rows.findings, *log.findings, *dead, *speed_findings(found, run.folder.name)),
        sources=(rows.source, log.source),
        paths=(run.folder,),
        expected=tuple(int(step) for step in run.header.requested.get("steps", ()) if step),
    )
