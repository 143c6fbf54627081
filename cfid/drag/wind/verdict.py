"""Judge a recording in wind as soon as it ends: which commands give a force."""

from cfid.drag.wind.data import AS_THEY_ARE, reduce_run
from cfid.errors import FitError
from cfid.motors.plan import StaircasePlan
from cfid.records.run import Run

_SHARE = 0.5  # of the commands: the least part that has to give a force


def verdict(run: Run) -> str:
    """State how many commands give a mean force. Raises DataError or FitError where few do."""
    forces, steps = reduce_run(run.folder, AS_THEY_ARE).forces, len(StaircasePlan.of_run(run).steps)
    if len(forces) < _SHARE * steps:
        raise FitError(f"only {len(forces)} of {steps} commands give a force with the rotors' speed.")
    std_n = max(float(force.force_std_n.max()) for force in forces)
    return f"{len(forces)} of {steps} commands give a force, each to {1e3 * std_n:.2g} mN or better."
