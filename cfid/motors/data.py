"""Staircases of motors: a record and its command log become steady steps, for maps, rotors and wind runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.errors import CfidError
from cfid.estimate.staircase import Point, Staircase, mean_in_windows, reduce_staircase
from cfid.findings import Finding, warning
from cfid.large import chosen_rows, empty, some_steps, stored
from cfid.recordings.vehicle import (
    COMMANDS,
    VEHICLE_LOG,
    Rows,
    holds,
    read_commands,
    read_rows,
    reported_speeds_rad_s,
)
from cfid.recordings.wrench import AXES, WrenchRecord
from cfid.records.parameters import Source
from cfid.records.run import Run, read_run

Array = npt.NDArray[np.float64]

_STANDING_S = 2.0  # of rotors at rest, put before a record that begins with turning rotors


@dataclass(frozen=True, kw_only=True, eq=False)
class RunStaircase:
    """A reduced load cell record; `run` is None for a bare file, and `began_s` is the Unix time of the first sample."""

    record: WrenchRecord
    reduced: Staircase
    run: Run | None
    began_s: float
    sources: tuple[Source, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the steps, each with the record's name, and about the run's other files."""
        steps = tuple(finding.at(self.record.name) for finding in self.reduced.findings)
        if self.run is None:
            return steps
        files = [read_rows(self.run, device) for device in (COMMANDS, VEHICLE_LOG) if holds(self.run, device)]
        return (*steps, *(finding for rows in files for finding in rows.findings))

    @property
    def log(self) -> Rows | None:
        """The rows of the vehicle's log, None where the run has none."""
        return read_rows(self.run, VEHICLE_LOG) if self.run is not None and holds(self.run, VEHICLE_LOG) else None

    def volts(self, points: Sequence[Point]) -> Array | None:
        """Return the battery's mean voltage (p,) at each point, or None if the vehicle logged no voltage."""
        if (log := self.log) is None or "pm.vbat" not in log.columns:
            return None
        return mean_in_windows(points, log.time_s - self.began_s, log.columns["pm.vbat"])

    def reported_speeds(self, points: Sequence[Point]) -> Array | None:
        """Return the mean speeds (p,) in rad/s that the vehicle reported for rotors that ran; None if one is missing.

        A rotor with a dead sensor does not count.
        """
        if (log := self.log) is None:
            return None
        speeds, time_s = reported_speeds_rad_s(log), log.time_s - self.began_s
        means = []
        for point in points:
            alive, _ = without_dead(point.motors, speeds, self.record.name)
            if not alive or not all(motor in speeds for motor in alive):
                return None
            means.append(np.mean([mean_in_windows([point], time_s, speeds[motor])[0] for motor in alive]))
        return np.array(means)

    @property
    def dead(self) -> tuple[Finding, ...]:
        """A finding for each rotor that ran but whose sensor showed no speed."""
        if (log := self.log) is None:
            return ()
        ran = sorted({motor for point in self.reduced.points for motor in point.motors})
        return without_dead(ran, reported_speeds_rad_s(log), self.record.name)[1]


def without_dead(ran: Sequence[int], speeds: Mapping[int, Array], name: str) -> tuple[list[int], tuple[Finding, ...]]:
    """Return the motors that ran, except those whose sensor is dead, and a finding for each dead sensor.

    A sensor that shows 0 throughout while another rotor turns is dead.
    """
    turning = [motor for motor in ran if motor in speeds and np.any(speeds[motor] > 0)]
    dead = [motor for motor in ran if turning and motor in speeds and motor not in turning]
    text = "the speed of rotor {motor} is 0 throughout while others turn: its sensor is dead, and left out."
    findings = (warning("rotor-sensor-dead", text.format(motor=motor)).at(name) for motor in dead)
    return [motor for motor in ran if motor not in dead], tuple(findings)


def channels_of(record: WrenchRecord, *, flip_fz: bool = False) -> Array:
    """Return forces and torques (n, 6) in N and N m, with the z axes reversed where they count downwards."""
    channels = empty(len(record.time_s), 6)
    channels[:, :3], channels[:, 3:] = record.force_n, record.torque_nm
    if flip_fz:
        channels[:, 2::3] *= -1
    return channels


def reduce_run(record: WrenchRecord, *, flip_fz: bool = False) -> RunStaircase:
    """Reduce a load cell's record to steady steps, by the commands logged with it or else by the changes it shows.

    Steps are found in Fz, or in the first axis of a load cell that has no Fz; the means of axes that it does not
    measure are nan. Raises DataError, or FitError where no step settles; both name the recording.
    """
    run = None if record.run is None else read_run(record.path.parent)
    began_s, sources = math.nan, [record.source]
    command_time_s, commands = None, None
    if run is not None and holds(run, COMMANDS):
        began_s = math.nan if record.begin_s is None else record.begin_s  # by the cell's own clock, where it has one
        rows, commands = read_commands(run)
        command_time_s = rows.time_s - began_s
        sources.append(rows.source)
    try:
        reduced = reduce_staircase(
            time_s=record.time_s,
            channels=np.nan_to_num(channels_of(record, flip_fz=flip_fz)),
            command_time_s=command_time_s,
            commands=commands,
            status=record.status,
            thrust=AXES.index(record.main_axis),
        )
        reduced.steady()
    except CfidError as error:
        raise type(error)(f"{record.path if run is None else record.path.parent}: {error}") from None
    if record.axes != AXES:
        blind = np.array([0.0 if axis in record.axes else math.nan for axis in AXES])
        points = tuple(
            replace(point, mean=point.mean + blind, std_of_mean=point.std_of_mean + blind) for point in reduced.points
        )
        reduced = replace(reduced, points=points)
    return RunStaircase(record=record, reduced=reduced, run=run, began_s=began_s, sources=tuple(sources))


def reduce_speeds(time_s: Array, speeds_rad_s: Array, command_time_s: Array, commands: Array) -> Staircase:
    """Reduce speeds (n, k), nan where missing, at times (n,) by commands (m, 4) that hold from `command_time_s` (m,).

    A rotor at rest has speed 0, so the pause before the first command need not be recorded. The speed of a rotor that
    idles in a pause, such as that of an armed Brushless, is not subtracted. Raises what `reduce_staircase` raises.
    """
    known = np.asarray(np.isfinite(speeds_rad_s).all(axis=1))
    time_s, speeds_rad_s = chosen_rows(time_s, known), chosen_rows(speeds_rad_s, known)
    begins_running = len(time_s) > 1 and np.any(commands[command_time_s <= time_s[0]][-1:])
    if begins_running:
        step_s = float(np.median(some_steps(time_s)))
        before_s = time_s[0] - step_s * np.arange(round(_STANDING_S / step_s), 0, -1)
        time_s = stored(np.concatenate([before_s, time_s]))
        speeds_rad_s = stored(np.vstack([np.zeros((len(before_s), speeds_rad_s.shape[1])), speeds_rad_s]))
        command_time_s = np.concatenate([before_s[:1], command_time_s])
        commands = np.vstack([np.zeros((1, commands.shape[1])), commands])
    return reduce_staircase(
        time_s=time_s, channels=speeds_rad_s, command_time_s=command_time_s, commands=commands, thrust=0, tared=False
    )
