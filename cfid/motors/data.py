"""Staircases on the load cell: a record and its command log become steady steps, for maps, rotors and wind runs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import CfidError
from cfid.estimate.staircase import Point, Staircase, mean_in_windows, reduce_staircase
from cfid.findings import Finding, warning
from cfid.large import empty
from cfid.recordings.vehicle import (
    COMMANDS,
    VEHICLE_LOG,
    holds,
    read_commands,
    read_rows,
    reported_speeds_rad_s,
)
from cfid.recordings.wrench import AXES, WrenchRecord
from cfid.records.parameters import Source
from cfid.records.run import Run, read_run

Array = npt.NDArray[np.float64]


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
        return (*(one.at(self.record.name) for one in self.reduced.findings), *self.about_files)

    @property
    def about_files(self) -> tuple[Finding, ...]:
        """Findings about the lines of the run's commands and of the vehicle's log."""
        if self.run is None:
            return ()
        return tuple(
            finding
            for device in (COMMANDS, VEHICLE_LOG)
            if holds(self.run, device)
            for finding in read_rows(self.run, device).findings
        )

    def volts(self, points: Sequence[Point]) -> Array | None:
        """Return the battery's mean voltage (p,) at each point, or None if the vehicle logged no voltage."""
        if self.run is None or not holds(self.run, VEHICLE_LOG):
            return None
        rows = read_rows(self.run, VEHICLE_LOG)
        volts = rows.columns.get("pm.vbat")
        return None if volts is None else mean_in_windows(points, rows.time_s - self.began_s, volts)

    def reported_speeds(self, points: Sequence[Point]) -> Array | None:
        """Return the mean speeds (p,) in rad/s that the vehicle reported for rotors that ran; None if one is missing.

        A rotor with a dead sensor does not count.
        """
        if self.run is None or not holds(self.run, VEHICLE_LOG):
            return None
        rows = read_rows(self.run, VEHICLE_LOG)
        speeds, time_s = reported_speeds_rad_s(rows), rows.time_s - self.began_s
        alive = [without_dead(point.motors, speeds, self.record.name)[0] for point in points]
        if not all(own and all(motor in speeds for motor in own) for own in alive):
            return None
        pairs = zip(points, alive, strict=True)
        return np.array(
            [np.mean([mean_in_windows([p], time_s, speeds[motor])[0] for motor in own]) for p, own in pairs]
        )

    @property
    def dead(self) -> tuple[Finding, ...]:
        """A finding for each rotor that ran but whose sensor showed no speed."""
        if self.run is None or not holds(self.run, VEHICLE_LOG):
            return ()
        ran = sorted({motor for point in self.reduced.points for motor in point.motors})
        return without_dead(ran, reported_speeds_rad_s(read_rows(self.run, VEHICLE_LOG)), self.record.name)[1]


def without_dead(ran: Sequence[int], speeds: Mapping[int, Array], name: str) -> tuple[list[int], tuple[Finding, ...]]:
    """Return the motors that ran, except those whose sensor is dead, and a finding for each dead sensor.

    A sensor that shows 0 throughout while another rotor turns is dead.
    """
    shown = [motor for motor in ran if motor in speeds and np.any(speeds[motor] > 0)]
    dead = [motor for motor in ran if shown and motor in speeds and motor not in shown]
    text = "the speed of rotor {motor} is 0 throughout while others turn: its sensor is dead, and left out."
    findings = (warning("rotor-sensor-dead", text.format(motor=motor)).at(name) for motor in dead)
    return [motor for motor in ran if motor not in dead], tuple(findings)


def run_of(record: WrenchRecord) -> Run | None:
    """Return the run that a record was read from, None for a bare file."""
    return None if record.run is None else read_run(record.path.parent)


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
    run, began_s, sources = run_of(record), math.nan, [record.source]
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
        raise type(error)(f"{_place(record)}: {error}") from None
    return RunStaircase(
        record=record, reduced=_measured(reduced, record), run=run, began_s=began_s, sources=tuple(sources)
    )


def _measured(reduced: Staircase, record: WrenchRecord) -> Staircase:
    """Return a staircase with nan for the means of the axes that the load cell does not measure."""
    if record.axes == AXES:
        return reduced
    blind = np.array([0.0 if axis in record.axes else math.nan for axis in AXES])
    points = tuple(
        replace(point, mean=point.mean + blind, std_of_mean=point.std_of_mean + blind) for point in reduced.points
    )
    return replace(reduced, points=points)


def _place(record: WrenchRecord) -> Path:
    return record.path if record.run is None else record.path.parent
