"""Series of sines and staircases that are not complete yet: which are too short for a fit, and what completes them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.guide.plan import Assignment, Words
from cfid.motors.missing_steps import missing
from cfid.motors.plan import FEWEST_COMMANDS
from cfid.records.resumed import recorded_steps, with_completed
from cfid.records.run import Run
from cfid.transfer.sines.plan import Sine, SineSweep, missing_sines
from cfid.units import DEAD_COMMAND


def completing(recording: Assignment, runs: Sequence[Run]) -> Assignment:
    """Return a recording, changed to complete its last run if this is a staircase or series that ended early."""
    same = [run for run in runs if not run.header.excluded and recording.is_of(run.header.kind, run.header.label)]
    if not same or same[-1].grows:
        return recording
    name = same[-1].folder.name
    words: Words = (*recording.words[:2], "--resume", name)
    if same[-1].header.family == "sine" and (lacks := _lacks(same[-1], runs)):
        if len(lacks) < len(_lacks(same[-1], runs, excluded=False)):  # --resume alone would repeat the excluded ones
            words = (*words, "--periods", ",".join(str(one.periods) for one in lacks))
        return replace(recording, words=words, questions=None, completes=name)
    try:
        missing(same[-1].folder, kind=same[-1].header.kind)
    except (ConfigError, DataError):  # the run is complete, or no staircase
        return recording
    return replace(recording, words=words, questions=None, completes=name)


def short_series(runs: Iterable[Run], every: Sequence[Run]) -> dict[str, str]:
    """Return, by run name, a sentence for each run of an incomplete series on how many of its sines are usable."""
    sentences = {}
    for run in runs:
        if run.header.family == "sine" and (lacks := _lacks(run, every)):
            count = len(SineSweep.of_run(run).periods)
            there = f"{count - len(lacks)} of {counted(count, 'sine')}"
            sentences[run.folder.name] = f"The series of {run.folder.name} is short: {there} are usable."
    return sentences


def short_staircases(runs: Sequence[Run]) -> dict[str, str]:
    """Return, by run name, a sentence for each staircase of a kind that has too few commands in total for a map."""
    sentences: dict[str, str] = {}
    for kind, needed in FEWEST_COMMANDS.items():
        steps = {run.folder.name: _commands(run) for run in runs if run.header.kind == kind}
        count = len({step for own in steps.values() for step in own})
        if 0 < count < needed:
            recorded = f"{counted(count, 'command')} above {DEAD_COMMAND} {'is' if count == 1 else 'are'} recorded"
            sentences |= dict.fromkeys(steps, f"{recorded}, and `cfid fit {kind}` takes at least {needed}.")
    return sentences


def _commands(run: Run) -> set[int]:
    """Return the commands at which motors turned in a staircase and in those that it completes, as a fit uses them.

    The set is empty if a run.toml states no staircase, or if a file cannot be read.
    """
    try:
        return {step for part in with_completed(run) for step in recorded_steps(part) if step > DEAD_COMMAND}
    except (KeyError, TypeError, ValueError, DataError):
        return set()


def _lacks(run: Run, every: Sequence[Run], *, excluded: bool = True) -> list[Sine]:
    """Return the sines of a run's series that have no usable run; none if its run.toml states no series.

    With `excluded`, a sine whose run was excluded is not missing, since the run may be kept for verification.
    """
    try:
        return missing_sines(SineSweep.of_run(run), every, simulated=run.header.simulated, excluded=excluded)
    except DataError:
        return []
