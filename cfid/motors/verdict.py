"""Judge a staircase as soon as it is recorded: which commands the load cell or the instrument can tell."""

import numpy as np

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.motors.data import reduce_run
from cfid.motors.plan import StaircasePlan
from cfid.records.run import Run
from cfid.records.tables.vehicle import READINGS, holds, read_rows
from cfid.records.tables.wrench import AXES, WrenchReading, read_wrench

_SHARE = 0.5  # of the steps that must be there


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
        return "the vehicle's log has the speeds."
    (value,) = (column for name, column in read_rows(run, READINGS).columns.items() if name != "command")
    read = int(np.count_nonzero(np.isfinite(value)))
    if read < _SHARE * steps:
        raise DataError(f"only {read} of {steps} steps have a reading.")
    return f"{counted(read, 'reading')} at {counted(steps, 'step')}, from {value.min():g} to {value.max():g}."
