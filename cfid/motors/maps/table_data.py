"""Steady points from tables: settled points, and a thrust stand's record over time."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import CfidError, ConfigError, DataError, FitError
from cfid.estimate.staircase import NoBaselineError, Point, Staircase, mean_in_windows, reduce_staircase
from cfid.findings import Finding, of_recording
from cfid.large import chosen_rows, side_by_side
from cfid.motors.maps.evidence import Evidence, Reduced, Stand, line_of, speed_findings, staircase_findings
from cfid.motors.points import MotorPoints, joined, per_motor
from cfid.motors.stand_points import points_of, reduce_speeds
from cfid.recordings.stand import USUAL_ESC_US, StandTable
from cfid.records.rig_file import NONE_STATED, RigFacts
from cfid.units import DEAD_COMMAND, FULL_COMMAND

Array = npt.NDArray[np.float64]

_LEAST_HELD_S = 0.2  # five time constants of the fastest rotor
_TOGETHER = 0.8  # share of the rows with a thrust that also have a torque
_MOST_NAMED = 8  # steps left out, up to which each has its own sentence


def of_table(table: StandTable, stand: Stand, facts: RigFacts = NONE_STATED) -> Evidence:
    """Return a table's points, or reduce its record over time.

    Raises ConfigError where the speeds are those of another number of rotors than the thrust, and no number is stated.
    """
    _ask_motors(table, stand.motors)
    tachometer = _is_tachometers(table)
    stand = stand.where(facts) if tachometer else replace(stand, markers=stand.markers or 1)
    found = _of_record(table, stand) if table.time_s is not None else _of_points(table, stand)
    if stand.motors is not None and table.thrust_n is None and table.torque_nm is None:
        unused = of_recording(table.path.name, ["`motors` is not used: the table has no thrust and no torque."])
        found = replace(found, findings=(*found.findings, *unused))
    motors = np.full(len(found.points.command), float(table.motors or stand.motors or 1))
    return replace(found, motors=motors, tachometers=(stand.facts,) if tachometer else ())


def _ask_motors(table: StandTable, motors: int | None) -> None:
    """Raise ConfigError where the number of motors of thrust and torque is not known, or was stated too late."""
    if table.thrust_n is None and table.torque_nm is None:
        return
    quantity = "torque" if table.thrust_n is None else "thrust"
    head = next(table.columns[name] for name in ("thrust_n", "weight_g", "torque_nm") if name in table.columns)
    named, usual = f"{table.path}: '{head}'", table.motors or 1
    if motors is None and not table.are_stated and table.rotors not in (None, usual):
        raise ConfigError(
            f"{named} is usually the {quantity} of {counted(usual, 'motor')}, but the file has the speed of "
            f"{counted(table.rotors, 'rotor')}. Give `motors`, the number of motors whose {quantity} it is."
        )
    if motors is not None and table.motors not in (None, motors):
        raise ConfigError(
            f"{named} was read as the {quantity} of {table.motors} motors: read the table with `motors` {motors}."
        )


def _is_tachometers(table: StandTable) -> bool:
    """Return whether speeds are those of a tachometer, which counts markers; a thrust stand reports rotors' speeds."""
    return table.speeds == "series"


def _of_points(table: StandTable, stand: Stand) -> Evidence:
    """Return a table's settled points; several series of one rotor give as many points."""
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
    """Reduce a thrust stand's record over time: thrust, torque, speed and battery where each command is steady."""
    assert table.time_s is not None
    if table.thrust_n is None:
        return _of_speeds(table, stand)
    channels, known = _forces(table)
    command_time_s, commands = _log(table)
    try:
        found = reduce_staircase(
            time_s=chosen_rows(table.time_s, known),
            channels=chosen_rows(channels, known),
            command_time_s=command_time_s,
            commands=commands,
            thrust=0,
        )
        settled = found.steady()
    except NoBaselineError as error:
        raise DataError(f"{table.path}: {error}{_longer_rest(table)}") from None
    except CfidError as error:
        raise type(error)(f"{table.path}: {error}") from None
    shown, volts = (
        None if column is None else _mean_of_known(settled, table.time_s, column)
        for column in (table.square_mean_speed_rad_s, table.vbat_v)
    )
    speed, findings = (None, ()) if shown is None else stand.divided(shown, table.path.name)
    points = points_of(settled, thrust=0)
    if channels.shape[1] > 1:
        points = replace(
            points,
            torque_nm=np.array([step.mean[1] for step in settled]),
            torque_std_nm=np.array([step.std_of_mean[1] for step in settled]),
            torque_shared_nm=np.array([step.tare_shares[:, 1] for step in settled]),
        )
    if commands is None:
        points = replace(points, command=np.full(len(settled), np.nan))
    points = per_motor(points, motors=1 if table.motors is not None else stand.motors or 1)
    return Evidence(
        points=replace(points, speed_rad_s=speed),
        vbat_v=volts,
        lines=tuple(line_of(point, table.path.name) for point in settled),
        findings=(*table.findings, *findings, *_few(staircase_findings(found, table.path.name), found)),
        sources=(table.source,),
        reduced=(
            Reduced(
                name=table.path.stem,
                time_s=chosen_rows(table.time_s, known),
                thrust_n=chosen_rows(table.thrust_n, known),
                staircase=found,
                thrust=0,
            ),
        ),
        paths=(table.path,),
    )


def _longer_rest(table: StandTable) -> str:
    """Return a sentence for a table whose range of pulse widths was assumed, and that has no motor at rest."""
    if not any(finding.code == "esc-range-assumed" for finding in table.findings) or not np.nanmin(table.command) > 0:
        return ""
    low, high = USUAL_ESC_US
    least_us = low + np.nanmin(table.command) / FULL_COMMAND * (high - low)
    stands = f" If motors stand at its shortest pulses, of {least_us:.0f} us, give their range"
    return f"{stands}: `esc_us` {least_us:.0f},{high:g}."


def _forces(table: StandTable) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return thrust, with torque where both were recorded (n, 1 or 2), and the rows (n,) in which they are known.

    A stand may read its load cells less often than the rest.
    """
    assert table.thrust_n is not None
    known = np.isfinite(table.thrust_n)
    if table.torque_nm is None:
        return table.thrust_n[:, np.newaxis], known
    both = known & np.isfinite(table.torque_nm)
    if both.sum() < _TOGETHER * known.sum():
        return table.thrust_n[:, np.newaxis], known
    return side_by_side([table.thrust_n, table.torque_nm]), both


def _log(table: StandTable) -> tuple[Array | None, Array | None]:
    """Return when commands begin (m,) and the commands (m, 4), both None where the table has none.

    Raises FitError for a recording in which no command is held, which is motion and has no steps.
    """
    assert table.time_s is not None
    if np.isnan(table.command).all():
        return None, None
    changes = np.flatnonzero(np.diff(table.command, prepend=np.nan))
    begin_s, command = table.time_s[changes], table.command[changes]
    held_s = np.diff(begin_s, append=table.time_s[-1])[command > DEAD_COMMAND]
    if len(held_s) and held_s.max() < _LEAST_HELD_S:
        raise FitError(
            f"{table.path}: unsteady: of {len(held_s)} commands none is held for longer than {held_s.max():.2g} s, and "
            f"a rotor settles in no less than {_LEAST_HELD_S:g} s. Hold each command for some seconds."
        )
    return begin_s, np.outer(command, (1, 0, 0, 0))  # the table states how many motors ran


def _mean_of_known(settled: Sequence[Point], time_s: Array, value: Array) -> Array:
    """Return the means (p,) of the known values (n,) in the windows of points."""
    known = np.isfinite(value)
    return mean_in_windows(settled, chosen_rows(time_s, known), chosen_rows(value, known))


def _few(findings: Sequence[Finding], found: Staircase) -> tuple[Finding, ...]:
    """Return the findings, with many left-out steps merged into one."""
    left_out = [one for one in findings if one.code == "step-left-out"]
    if len(left_out) <= _MOST_NAMED:
        return tuple(findings)
    others = [one for one in findings if one.code != "step-left-out"]
    text = f"{len(left_out)} of {counted(len(found.points), 'step')} left out. The first: {left_out[0].text}"
    return (*others, replace(left_out[0], sentence=text, where=()))


def _of_speeds(table: StandTable, stand: Stand) -> Evidence:
    """Reduce a record over time that has speeds alone."""
    shown = table.square_mean_speed_rad_s
    if table.time_s is None or shown is None:
        raise DataError(f"{table.path}: a record over time without a thrust or a speed cannot be reduced.")
    command_time_s, commands = _log(table)
    if command_time_s is None or commands is None:
        raise DataError(f"{table.path}: speeds alone without commands give no map.")
    try:
        found = reduce_speeds(table.time_s, shown[:, np.newaxis], command_time_s, commands)
        settled = found.steady()
    except CfidError as error:
        raise type(error)(f"{table.path}: {error}") from None
    speed, findings = stand.divided(np.array([point.mean[0] for point in settled]), table.path.name)
    return Evidence(
        points=MotorPoints(command=np.array([float(point.command or 0) for point in settled]), speed_rad_s=speed),
        lines=tuple(line_of(point, table.path.name) for point in found.points),
        findings=(*table.findings, *findings, *_few(speed_findings(found, table.path.name), found)),
        sources=(table.source,),
        paths=(table.path,),
    )
