"""Steady points from load-cell files and runs, and from the speeds that a run holds."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.console.options import LoadCellOptions, ReadingOptions
from cfid.errors import CfidError, DataError
from cfid.motors.maps.evidence import Evidence, Reduced, StandOptions, drift_of, line_of
from cfid.motors.vibration.data import RotorOptions, heard_speeds, told_speeds
from cfid.units import MOTORS

if TYPE_CHECKING:
    from cfid.estimate.staircase import Point, Staircase
    from cfid.records.run import Run


def of_file(
    command: int,
    path: Path,
    stand: StandOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    *,
    method: str,
    listening: RotorOptions | None = None,
) -> Evidence:
    """Reduce a load cell's file of one command between two rests, as the thesis has them."""
    from cfid.estimate.staircase import NeverRanError, reduce_single
    from cfid.records.tables.wrench import read_wrench

    record = read_wrench(path, scale.reading(reading))
    channels = _channels(record, stand)
    if command == 0:
        return _standing(record, stand)
    try:
        if method == "thesis" and stand.window_s is not None:
            return _as_the_thesis(command, record, channels, stand)
        found = reduce_single(
            time_s=record.time_s,
            channels=channels,
            command=command,
            status=record.status,
            window=stand.window_s,
        )
    except NeverRanError as error:
        return replace(_nothing(record), warnings=(*record.notes, f"{path}: {error} It is left out."))
    except CfidError as error:
        raise type(error)(f"{path}: {error}") from None
    return _evidence(found, record, channels, stand.motors or 1, listening=listening)


def _as_the_thesis(command: int, record: Any, channels: Any, stand: StandOptions) -> Evidence:
    import numpy as np

    from cfid.motors.maps.thesis import reduce_thesis
    from cfid.motors.points import MotorPoints, per_motor

    assert stand.window_s is not None
    from_s, to_s = stand.window_s
    thrust, torque = (reduce_thesis(record.time_s, channels[:, axis], from_s=from_s, to_s=to_s).mean for axis in (2, 5))
    points = MotorPoints(command=np.array([float(command)]), thrust_n=np.array([thrust]), torque_nm=np.array([torque]))
    return Evidence(
        points=per_motor(points, motors=stand.motors or 1),
        warnings=record.notes,
        sources=(record.source,),
        paths=(record.path,),
    )


def _standing(record: Any, stand: StandOptions) -> Evidence:
    """Return the point of command 0: motors that stand give nothing, whatever the cell's bias is."""
    import numpy as np

    from cfid.motors.points import MotorPoints

    zero = np.zeros(1)
    return Evidence(
        points=MotorPoints(command=zero, thrust_n=zero, torque_nm=zero),
        warnings=record.notes,
        sources=(record.source,),
        paths=(record.path,),
    )


def _nothing(record: Any) -> Evidence:
    """Return what a file gives in which no step settles, or none is seen: nothing, and where it was looked for."""
    import numpy as np

    from cfid.motors.points import MotorPoints

    return Evidence(
        points=MotorPoints(command=np.zeros(0)), warnings=record.notes, sources=(record.source,), paths=(record.path,)
    )


def of_run(
    path: Path,
    stand: StandOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    *,
    listening: RotorOptions | None = None,
) -> Evidence:
    """Take what a run measured of a motor: a staircase on the load cell, typed readings, or speeds it was told."""
    from cfid.records.tables.times import run_at
    from cfid.records.tables.vehicle import READINGS, VEHICLE_LOG, holds
    from cfid.records.tables.wrench import LOADCELL

    run = run_at(path)
    if run is None:
        raise DataError(f"{path}: no run folder; a file needs its command: write COMMAND={path}.")
    stand = stand.where(run.header.rig)
    if holds(run, LOADCELL):
        return _of_staircase(run, stand, reading, scale, listening)
    if holds(run, READINGS) and "rpm" in run.header.devices[READINGS].columns:
        return _of_readings(run, stand)
    if holds(run, VEHICLE_LOG):
        return _of_speeds(run)
    raise DataError(f"{path}: a run of {run.header.kind}, in which no motor was measured.")


def _of_staircase(
    run: "Run", stand: StandOptions, reading: ReadingOptions, scale: LoadCellOptions, listening: RotorOptions | None
) -> Evidence:
    """Reduce a staircase of the load cell by the commands that were logged beside it."""
    from cfid.estimate.staircase import reduce_staircase
    from cfid.records.tables.vehicle import COMMANDS, begin_s, holds, read_commands
    from cfid.records.tables.wrench import LOADCELL, read_wrench

    record = read_wrench(run.folder, scale.reading(reading))
    channels = _channels(record, stand)
    logged: dict[str, Any] = {}
    sources = []
    began_s = begin_s(run.device_file(LOADCELL))
    if holds(run, COMMANDS):
        rows, commands = read_commands(run)
        logged = {"command_time_s": rows.time_s - began_s, "commands": commands}
        sources.append(rows.source)
    try:
        found = reduce_staircase(time_s=record.time_s, channels=channels, status=record.status, **logged)
        found.steady()
    except CfidError as error:
        raise type(error)(f"{run.folder}: {error}") from None
    steps = tuple(int(step) for step in run.header.asked.get("steps", ()) if step)
    return _evidence(
        found, record, channels, None, run=run, began_s=began_s, sources=sources, expected=steps, listening=listening
    )


def _channels(record: Any, stand: StandOptions) -> Any:
    """Return forces and torques (n, 6), the z axes turned round where they count downwards."""
    import numpy as np

    sign = np.array([1, 1, -1, 1, 1, -1]) if stand.flip_fz else 1
    return np.column_stack([record.force_n, record.torque_nm]) * sign


def _evidence(
    found: "Staircase",
    record: Any,
    channels: Any,
    motors: int | None,
    *,
    run: "Run | None" = None,
    began_s: float = 0.0,
    sources: Sequence[Any] = (),
    expected: tuple[int, ...] = (),
    listening: RotorOptions | None = None,
) -> Evidence:
    """Return the settled points of a reduced record, per motor."""
    from cfid.motors.stand_points import points_of

    settled = [point for point in found.points if point.settled]
    points = _nothing(record).points
    said: tuple[str, ...] = ()
    if settled:
        speed, speed_std, said = _speeds(settled, record, motors, run=run, began_s=began_s, listening=listening)
        points = replace(points_of(settled, motors=motors), speed_rad_s=speed, speed_std_rad_s=speed_std)
    unsettled = [point for point in found.points if not point.settled]
    return Evidence(
        points=points,
        vbat_v=None if run is None else _volts(run, settled, began_s),
        lines=tuple(line_of(point, record.name) for point in found.points),
        warnings=(
            *record.notes,
            *found.warnings,
            *drift_of(found, record.name),
            *said,
            *(f"{record.name}: command {point.command}: {point.reason}; it is left out." for point in unsettled),
        ),
        sources=(record.source, *sources),
        reduced=(Reduced(name=record.name, time_s=record.time_s, thrust_n=channels[:, 2], staircase=found),),
        paths=(record.path,),
        expected=expected,
    )


def _volts(run: "Run", settled: "Sequence[Point]", began_s: float) -> Any:
    """Return the battery's mean voltage in each window, None where the vehicle logged none."""
    from cfid.estimate.staircase import mean_beside
    from cfid.records.tables.vehicle import VEHICLE_LOG, holds, read_rows

    if not holds(run, VEHICLE_LOG):
        return None
    rows = read_rows(run, VEHICLE_LOG)
    volts = rows.columns.get("pm.vbat")
    return None if volts is None else mean_beside(settled, rows.time_s - began_s, volts)


def _speeds(
    settled: "Sequence[Point]",
    record: Any,
    motors: int | None,
    *,
    run: "Run | None",
    began_s: float,
    listening: RotorOptions | None,
) -> tuple[Any, Any, tuple[str, ...]]:
    """Return speeds and deviations as the vehicle told them, else heard where that is wanted, and what to say."""
    told = None if run is None else told_speeds(run, settled, began_s)
    if told is not None or listening is None:
        return told, None, ()
    return heard_speeds(settled, record, listening, motors=motors)


def _of_readings(run: "Run", stand: StandOptions) -> Evidence:
    """Take the tachometer readings that the operator typed."""
    from cfid.motors.points import MotorPoints, rotor_speed_rad_s
    from cfid.records.tables.vehicle import READINGS, read_rows

    rows = read_rows(run, READINGS)
    speed, notes = stand.divided(rotor_speed_rad_s(rows.columns["rpm"], markers=1))
    return Evidence(
        points=MotorPoints(command=rows.columns["command"], speed_rad_s=speed),
        warnings=tuple(f"{run.folder.name}: {note}" for note in notes),
        sources=(rows.source,),
        paths=(run.folder,),
    )


def _of_speeds(run: "Run") -> Evidence:
    """Reduce the speeds that the vehicle told itself, as a staircase; the mean of the motors that ran."""
    import numpy as np

    from cfid.estimate.staircase import reduce_staircase
    from cfid.motors.points import MotorPoints
    from cfid.records.tables.vehicle import VEHICLE_LOG, read_commands, read_rows, told_speeds_rad_s

    rows, (log, commands) = read_rows(run, VEHICLE_LOG), read_commands(run)
    told = told_speeds_rad_s(rows)
    ran = [motor for motor in MOTORS if commands[:, motor - 1].any()]
    if not ran or not all(motor in told for motor in ran):
        raise DataError(f"{run.folder}: the vehicle's log has no speeds: an RPM deck or brushless motors tell them.")
    try:
        found = reduce_staircase(
            time_s=rows.time_s - rows.time_s[0],
            channels=np.column_stack([told[motor] for motor in ran]),
            command_time_s=log.time_s - rows.time_s[0],
            commands=commands,
            thrust=0,
        )
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
        warnings=found.warnings,
        sources=(rows.source, log.source),
        paths=(run.folder,),
        expected=tuple(int(step) for step in run.header.asked.get("steps", ()) if step),
    )
