"""Steady points from tables: settled points as they are, a thrust stand's record reduced."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.inputs import Workplace
from cfid.console.options import ReadingOptions
from cfid.errors import CfidError, DataError
from cfid.motors.maps.evidence import Evidence, Reduced, StandOptions, line_of, recording, staircase_findings

if TYPE_CHECKING:
    from cfid.records.tables.stand import StandTable


def of_table(path: Path, stand: StandOptions, reading: ReadingOptions, workplace: Workplace) -> Evidence:
    """Read a table and take its points, or reduce it where it is a record over time."""
    from cfid.records.tables.stand import read_stand_table

    table = read_stand_table(
        path,
        gravity_mps2=workplace.rig.site.gravity_mps2,
        rate_hz=reading.rate_hz,
        skip_lines=reading.skip_lines,
    )
    return _of_record(table, stand) if table.time_s is not None else _of_points(table, stand)


def _of_points(table: "StandTable", stand: StandOptions) -> Evidence:
    """Take a table of settled points; several series of one rotor are as many points."""
    import numpy as np

    from cfid.motors.points import MotorPoints, joined, per_motor

    share = 1 if table.motors is not None else stand.motors or 1
    points = per_motor(
        MotorPoints(command=table.command, thrust_n=table.thrust_n, torque_nm=table.torque_nm), motors=share
    )
    speeds, vbat = table.speeds_rad_s, table.vbat_v
    if speeds is not None:
        one_speed = table.square_mean_speed_rad_s
        assert one_speed is not None
        series = list(speeds.T) if table.speeds == "series" else [one_speed]
        sets = [MotorPoints(command=table.command, speed_rad_s=one / stand.markers) for one in series]
        if table.thrust_n is None:
            points = joined(*sets)
        elif len(sets) == 1:
            points = MotorPoints(**{**vars(points), "speed_rad_s": sets[0].speed_rad_s})
        else:
            points = joined(points, *sets)
    if vbat is not None:
        vbat = np.resize(vbat, len(points.command)) if len(points.command) % len(vbat) == 0 else None
    return Evidence(
        points=points, vbat_v=vbat, findings=recording(table.notes), sources=(table.source,), paths=(table.path,)
    )


def _of_record(table: "StandTable", stand: StandOptions) -> Evidence:
    """Reduce a thrust stand's record over time: thrust, speed and battery in the steady window of each command."""
    import numpy as np

    from cfid.estimate.staircase import mean_beside, reduce_staircase
    from cfid.motors.points import per_motor
    from cfid.motors.stand_points import points_of

    assert table.time_s is not None
    if table.thrust_n is None:
        raise DataError(f"{table.path}: a record over time without a thrust cannot be reduced.")
    changes = np.flatnonzero(np.diff(table.command, prepend=np.nan))
    try:
        found = reduce_staircase(
            time_s=table.time_s,
            channels=table.thrust_n[:, np.newaxis],
            command_time_s=table.time_s[changes],
            commands=np.outer(table.command[changes], (1, 0, 0, 0)),  # whoever ran: the table knows how many
            thrust=0,
        )
        settled = found.steady()
    except CfidError as error:
        raise type(error)(f"{table.path}: {error}") from None
    shown, volts = (
        None if column is None else mean_beside(settled, table.time_s, column)
        for column in (table.square_mean_speed_rad_s, table.vbat_v)
    )
    points = per_motor(points_of(settled, thrust=0), motors=1 if table.motors is not None else stand.motors or 1)
    return Evidence(
        points=replace(points, speed_rad_s=None if shown is None else shown / stand.markers),
        vbat_v=volts,
        lines=tuple(line_of(point, table.path.name) for point in found.points),
        findings=(*recording(table.notes), *staircase_findings(found, table.path.name)),
        sources=(table.source,),
        reduced=(
            Reduced(name=table.path.stem, time_s=table.time_s, thrust_n=table.thrust_n, staircase=found, thrust=0),
        ),
        paths=(table.path,),
    )
