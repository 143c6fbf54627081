"""Judge a staircase as soon as it is recorded: which commands the load cell or the instrument can tell."""

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.motors.data import reduce_run
from cfid.motors.plan import StaircasePlan
from cfid.records.run import Run
from cfid.records.tables.vehicle import READINGS, VEHICLE_LOG, holds, read_rows, shown_at_commands, told_speeds_rad_s
from cfid.records.tables.wrench import AXES, WrenchReading, read_wrench

_SHARE = 0.5  # of the steps that must be there
_RISES = 0.02  # of the largest: what an instrument has to show more at the highest command than at the lowest
_SHOWN = {"tachometer": ("rpm", "rpm"), "scales": ("grams", "g")}  # of each instrument the column, and its unit


def of_forces(run: Run) -> str:
    """Say how many steps of a load cell's staircase are steady. Raises DataError or FitError where few are."""
    steps = sum(command > 0 for command in StaircasePlan.of_run(run).steps)  # at 0 it is the tare
    record = read_wrench(run.folder, WrenchReading())
    axis, reduced = record.main_axis, reduce_run(record).reduced
    points = reduced.steady()
    left_out = [f"command {point.command} is not: {point.reason}" for point in reduced.points if not point.settled]
    if len(points) < _SHARE * steps:
        raise FitError(f"only {len(points)} of {steps} steps are steady: hold them longer, or let the rig settle.")
    unit = "mN" if axis.startswith("F") else "mNm"
    least, most = (1e3 * float(end(point.mean[AXES.index(axis)] for point in points)) for end in (min, max))
    found = f"{len(points)} of {steps} steps are steady, {axis} from {least:.0f} to {most:.0f} {unit}"
    return "; ".join([found, *left_out[:1]]) + "."


def of_readings(run: Run) -> str:
    """Say how many steps have a reading. Raises DataError where few have."""
    steps = len(StaircasePlan.of_run(run).steps)
    if not holds(run, READINGS):
        return _of_instrument(run)
    (value,) = (column for name, column in read_rows(run, READINGS).columns.items() if name != "command")
    read = int(np.count_nonzero(np.isfinite(value)))
    if read < _SHARE * steps:
        raise DataError(f"only {read} of {steps} steps have a reading.")
    return f"{counted(read, 'reading')} at {counted(steps, 'step')}, from {value.min():g} to {value.max():g}."


def _of_instrument(run: Run) -> str:
    """Say what a tachometer or scales showed, or the vehicle's log. Raises DataError where that follows no command."""
    for device, (column, unit) in _SHOWN.items():
        if holds(run, device):
            _, command, value = shown_at_commands(run, device, column)
            driven = command > 0
            if not driven.any() or not np.any(value[driven]):
                raise DataError(f"the {device} shows 0 {unit} at every command: is it pointed at what it measures?")
            low, high = value[driven][np.argmin(command[driven])], value[driven][np.argmax(command[driven])]
            if np.ptp(command[driven]) > 0 and abs(high - low) < _RISES * np.abs(value[driven]).max():
                raise DataError(
                    f"the {device} shows {low:.4g} {unit} at the lowest command and {high:.4g} at the highest."
                )
            return f"the {device} shows {low:.4g} {unit} at the lowest command and {high:.4g} at the highest."
    speeds = told_speeds_rad_s(read_rows(run, VEHICLE_LOG)) if holds(run, VEHICLE_LOG) else {}
    if not any(np.any(speed > 0) for speed in speeds.values()):
        raise DataError("the vehicle's log has no speed above 0.")
    return "the vehicle's log has the speeds."
