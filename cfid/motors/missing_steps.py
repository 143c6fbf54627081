"""The steps of a staircase of motor commands that an interrupted run lacks."""

from dataclasses import replace
from pathlib import Path

from cfid.errors import ConfigError
from cfid.motors.plan import StaircasePlan
from cfid.recordings.resumed import recorded_after, steps_lacking, steps_left
from cfid.records.run import read_run


def missing(folder: Path, *, kind: str) -> StaircasePlan:
    """Return the steps of an interrupted run that are still to be recorded, as a staircase.

    A step is recorded if it has a typed reading or, in a run without typed readings, if it was held to its end. Steps
    in later runs that resume this one count as recorded, too. Raises ConfigError when the run is no staircase of this
    kind, is complete, or has every step.
    """
    run = read_run(folder)
    if run.header.kind != kind or not {"steps", "motors", "hold_s", "rest_s"} <= set(run.header.requested):
        raise ConfigError(f"{folder}: is no run of `cfid log {kind}` that could be resumed.")
    try:
        before = StaircasePlan.of_run(run)
    except (TypeError, ValueError):
        raise ConfigError(f"{folder}: run.toml states no staircase that could be resumed.") from None
    if run.header.state == "complete":
        raise ConfigError(f"{folder}: is complete; nothing is left to record.")
    left = steps_left(run)
    if not any(left):
        raise ConfigError(
            f"{folder}: has every step, though it ended early; nothing is left to record. Name it to the fit: "
            f"{run.folder.resolve().name}."
        )
    later = recorded_after(run)
    lacking = steps_lacking(run, later)
    if not any(lacking):
        raise ConfigError(f"{folder}: {later[-1].folder.name} completes it; nothing is left to record.")
    return replace(before, steps=lacking, resumes=(later or [run])[-1].folder.resolve().name)
