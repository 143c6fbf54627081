"""Judge a staircase of the load cell as soon as it is recorded: which commands it can tell, and what a map lacks."""

import numpy as np

from cfid.errors import FitError
from cfid.motors.data import reduce_run
from cfid.motors.plan import FEWEST_COMMANDS, StaircasePlan
from cfid.motors.points import Array
from cfid.records.run import Run
from cfid.records.tables.wrench import AXES, WrenchReading, read_wrench
from cfid.units import DEAD_COMMAND

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
    commands = np.array([point.command or 0 for point in points], dtype=np.float64)
    return "; ".join([found, *left_out[:1]]) + "." + too_few(commands, FEWEST_COMMANDS["thrust"], "cfid fit thrust")


def too_few(command: Array, coefficients: int, fit: str) -> str:
    """Return that a map needs points at more commands than these (n,), "" where they suffice."""
    there = len(np.unique(command[command > DEAD_COMMAND]))
    if there >= coefficients:
        return ""
    return (
        f" Too short for a map of its own: `{fit}` takes at least {coefficients} commands above {DEAD_COMMAND}, from "
        f"this run and others, and {'here is 1' if there == 1 else f'here are {there}'}."
    )
