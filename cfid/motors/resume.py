"""The missing steps of an interrupted staircase."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

from cfid.console.selection import LAST
from cfid.errors import ConfigError, DataError
from cfid.records.campaign import Campaign
from cfid.records.run import Run, list_runs, read_run
from cfid.records.tables.table import Array
from cfid.records.tables.vehicle import COMMANDS, READINGS, holds, read_commands, read_rows
from cfid.rig.procedures import StaircasePlan

_ENOUGH = 0.98  # of the time that a step is held


def interrupted(word: Path, campaign: Campaign, *, kind: str) -> Path:
    """Return the folder of the run that an argument names: a path, a run of the campaign, or `last`, of its kind.

    Raises ConfigError when there is no run of this kind.
    """
    if str(word) != LAST:
        return word if word.exists() else campaign.runs_folder / word
    runs = [run for run in list_runs(campaign.runs_folder) if not isinstance(run, DataError)]
    of_kind = [run.folder for run in runs if run.header.kind.partition("_")[0] == kind]  # a sine's ends with its l
    if not of_kind:
        raise ConfigError(f"last: {campaign.runs_folder} has no run of `cfid log {kind}` yet.")
    return of_kind[-1]


def missing(folder: Path, *, kind: str) -> StaircasePlan:
    """Return the staircase of a run without the steps that it has a typed reading of, or held to their end.

    The latter counts where no reading was requested. Raises ConfigError when the run is no staircase
    of this kind, or is complete.
    """
    run = read_run(folder)
    asked = run.header.asked
    if run.header.kind != kind or not {"steps", "motors", "hold_s", "rest_s"} <= set(asked):
        raise ConfigError(f"{folder}: is no run of `cfid log {kind}` that could be resumed.")
    before = _stairs(run)
    if READINGS in run.header.devices:
        typed = read_rows(run, READINGS).columns["command"].tolist() if run.header.devices[READINGS].rows else []
        done = Counter(map(int, typed))
    else:
        done = Counter(held_steps(run))
    left = tuple(step for step in before.steps if not _was_done(step, done))
    if run.header.state == "complete" or not any(left):
        raise ConfigError(f"{folder}: is complete; nothing is left to record.")
    return replace(before, steps=left)


def held_steps(run: Run) -> list[int]:
    """Return the commands of a run's staircase that were held to their end, in any order."""
    if not holds(run, COMMANDS):
        return []
    rows, commands = read_commands(run)
    stairs = _stairs(run)
    done = _held(stairs, rows.time_s, commands)
    return [step for step in stairs.steps if _was_done(step, done)]


def _stairs(run: Run) -> StaircasePlan:
    asked = run.header.asked
    return StaircasePlan(
        steps=tuple(asked["steps"]), motors=tuple(asked["motors"]), hold_s=asked["hold_s"], rest_s=asked["rest_s"]
    )


def _held(stairs: StaircasePlan, time_s: Array, commands: Array) -> Counter[int]:
    """Return how often each command was held long enough."""
    column = commands[:-1, stairs.motors[0] - 1]
    long_enough = time_s[1:] - time_s[:-1] >= _ENOUGH * stairs.hold_s
    return Counter(column[long_enough].astype(int).tolist())


def _was_done(step: int, done: Counter[int]) -> bool:
    """Return whether a step was done and take it off."""
    if not done[step]:
        return False
    done[step] -= 1
    return True
