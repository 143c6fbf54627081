"""The state of a campaign: every task with what was recorded and found, and the command that comes next."""

import shlex
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from typing import Literal

from cfid.counted import counted
from cfid.errors import DataError
from cfid.guide.certainty import Certainty, certainty_of, percent
from cfid.guide.plan import Assignment, Task, Words, is_vehicle, tasks
from cfid.records.campaign import Campaign
from cfid.records.fits import Fit
from cfid.records.rig_file import CampaignKind
from cfid.records.run import Run, list_runs
from cfid.records.values import Values
from cfid.transfer.plan import SineSweep, missing_sines

_AS_BEFORE = "Leave the rig as it was for this run: what it lacks is recorded now."

State = Literal["missing", "not fitted", "stale", "rejected", "accepted"]


@dataclass(frozen=True, kw_only=True)
class TaskStatus:
    """A task: what is still to be recorded, the state of its fit and why, and how certain its quantities are.

    `suspects` are the runs without any of which the others of a rejected fit agree; `retry` is what to record again:
    what the last of them recorded, or else the recording that was made longest ago.
    """

    task: Task
    lacking: tuple[Assignment, ...]
    retry: Assignment | None = None
    suspects: tuple[str, ...] = ()
    state: State
    reason: str
    found: tuple[Certainty, ...] = ()

    @property
    def recorded(self) -> int:
        """The number of the task's runs that are recorded."""
        return len(self.task.recordings) - len(self.lacking)


@dataclass(frozen=True, kw_only=True)
class Next:
    """The command that comes next, the reason, and the recording that it makes, if any."""

    words: Words
    why: str
    recording: Assignment | None = None

    @property
    def command(self) -> str:
        """The command as it is shown."""
        return self.recording.command if self.recording else f"cfid {shlex.join(self.words)}"


@dataclass(frozen=True, kw_only=True)
class Status:
    """A campaign's tasks, fits `beside` the plan, and unreadable runs, as sentences.

    `kind` is the kind of campaign if that of rig.toml was replaced.
    """

    tasks: tuple[TaskStatus, ...]
    beside: tuple[str, ...] = ()
    unreadable: tuple[str, ...] = ()
    kind: CampaignKind | None = None

    @cached_property
    def next(self) -> Next:
        """What comes next: the first step to record, fit or repeat, else to improve, else the report."""
        for status in self.tasks:
            name, reason = status.task.section, status.reason
            if status.state == "missing":
                why = f"{name}: {status.recorded} of {counted(len(status.task.recordings), 'run')} recorded. {reason}"
                if name == "inertia" and not status.recorded:
                    why += "Mounts come in a random order, so that no drift over the day looks like one of them."
                return _recorded_next(status.lacking[0], why.rstrip())
            if status.state in ("not fitted", "stale"):
                return Next(words=status.task.fit, why=f"{name}: {reason}")
            if status.state == "rejected":
                why = f"{name} was rejected: {reason}"
                if len(status.suspects) == 1:  # another recording cannot help while this one stays in
                    return Next(words=("runs", "exclude", status.suspects[0]), why=f"{why} Leave it out.")
                why += " Leave out a run that was wrong: cfid runs exclude RUN."
                return _recorded_next(status.retry or status.task.recordings[-1], why)
        report: Words = ("report", *(("--kind", self.kind) if self.kind else ()))
        unsure = [
            (certainty, status.task) for status in self.tasks for certainty in status.found if certainty.short_by > 1
        ]
        if weak := [(certainty, task) for certainty, task in unsure if not certainty.bounded_by]:
            certainty, task = max(weak, key=lambda pair: pair[0].short_by)
            aim, enough = certainty.aim, f"If it is enough: cfid {' '.join(report)}."
            needed = f"{percent(aim.std)} is needed for {aim.purpose}"
            why = f"{certainty.key} is known to {percent(certainty.std)}; {needed}. {enough}"
            return _recorded_next(task.recordings[-1], why)
        sure = "as sure as rig.toml allows" if unsure else "sure enough"
        return Next(words=report, why=f"everything is found, and {sure}.")

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on the state of fits and on what a repetition would show.

        A reason that the next step already states is left out.
        """
        why = self.next.why
        reasons = [
            f"{status.task.section}: {status.reason}"
            for status in self.tasks
            if status.reason and not (why.startswith(status.task.section) and status.reason in why)
        ]
        bounded = [
            f"{certainty.key} is known to {percent(certainty.std)} because of the {certainty.bounded_by}, as rig.toml "
            "states it: recording again alone does not change that. Measure it better and state it there first: what "
            "is stated of an instrument counts for later recordings."
            for status in self.tasks
            for certainty in status.found
            if certainty.bounded_by
        ]
        return (*reasons, *bounded)


def status_of(campaign: Campaign, *, kind: CampaignKind | None = None) -> Status:
    """Return the state of a campaign, for which each run.toml and each fit is read once."""
    listed = list_runs(campaign.runs_folder)
    runs = [run for run in listed if isinstance(run, Run)]
    included = [run for run in runs if not run.header.excluded]
    values = campaign.values(runs)
    swings = [run for run in included if run.header.kind == "swing"]
    by_gyro = ["encoder" not in run.header.devices for run in swings if run.usable]
    planned = tasks(
        campaign.rig,
        kind=kind,
        swung=[run.header.label.axis or "" for run in swings if is_vehicle(run.header.label)],
        by_gyro=bool(by_gyro) and by_gyro[-1],
    )
    statuses = tuple(_status(task, included, runs, values) for task in planned)
    names = {task.section for task in planned}
    return Status(
        tasks=statuses,
        beside=tuple(dict.fromkeys(fit.name for fit in values.by_fit if fit.name not in names)),
        unreadable=tuple(str(error) for error in listed if not isinstance(error, Run)),
        kind=kind,
    )


def _recorded_next(recording: Assignment, why: str) -> Next:
    return Next(words=recording.words, why=why, recording=recording)


def _status(task: Task, included: Sequence[Run], runs: Sequence[Run], values: Values) -> TaskStatus:
    """Judge a task by the campaign's runs, its fit in force, and its last fit if that was rejected completely."""
    made = [run for run in included if any(recording.is_of(run.header) for recording in task.recordings)]
    usable = [run for run in made if run.usable]
    lacking = _lacking(task.recordings, included, runs)
    short_of_runs = any(not recording.repeats for recording in lacking)
    fit = values.in_force.get(task.section)
    last = next((fit for fit in reversed(values.fits) if fit.name == task.section), None)
    rejected = [] if fit is None else [reason for key, reason in fit.section.rejected.items() if key in task.aims]
    state: State = "accepted"
    reason = ""
    if rejected:
        state, reason = "rejected", rejected[0]
    elif fit is not None and (reasons := values.outdated(fit)):
        state, reason = "missing" if short_of_runs else "stale", reasons[0]  # without these runs, a fit may always fail
    elif short_of_runs or (fit is None and lacking):
        state, reason = "missing", _why_missing(made, _newest(lacking[0], included))
    elif last is not None and _holds(last, usable, values) and (fit is None or not last.recordings <= fit.recordings):
        state, reason = "rejected", next(iter(last.section.rejected.values()))
    elif fit is None:
        state, reason = "not fitted", "recorded, not fitted yet."
    elif newer := _newer(fit, [*usable, *_besides(task, usable, included)], values):
        state, reason = "stale", f"{counted(newer, 'run was', 'runs were')} recorded after the fit."
    elif lacking:
        reason = f"`{lacking[0].command}` once more would show what drifted since the first."

    def last_made(recording: Assignment) -> tuple[int, float, str]:
        return max((run.place for run in made if recording.is_of(run.header)), default=(-1, 0.0, ""))

    named = () if state != "rejected" or last is None else last.section.suspects
    suspects = [run for run in usable if run.folder.name in named]
    again = [recording for recording in task.recordings if suspects and recording.is_of(suspects[-1].header)]
    return TaskStatus(
        task=task,
        lacking=lacking,
        retry=again[0] if again else min(task.recordings, key=last_made),
        suspects=tuple(run.folder.name for run in suspects),
        state=state,
        reason=reason,
        found=tuple(certainty_of(values, key) for key in task.aims),
    )


def _besides(task: Task, usable: Sequence[Run], included: Sequence[Run]) -> list[Run]:
    """Return the runs that a task's fit takes besides its own: rotors' speeds, where a load cell measured thrust."""
    own = {recording.kind for recording in task.recordings}
    if not any(run.header.kind in own for run in usable):
        return []
    return [run for run in included if run.usable and run.header.kind in task.besides]


def _why_missing(made: Sequence[Run], newest: Run | None) -> str:
    """Return which run is being recorded, or why the newest run of what is lacking is of no use; "" for neither."""
    growing = [run.folder.name for run in made if run.grows]
    if growing:
        return f"{growing[-1]} is being recorded: wait until it has ended."
    verdict = None if newest is None else newest.header.verdict
    if newest is None or verdict is None or verdict.usable:
        return ""
    return f"{newest.folder.name} is not usable: {verdict.text.removeprefix(f'{newest.folder.name}: ')}"


def _newest(recording: Assignment, included: Sequence[Run]) -> Run | None:
    return next((run for run in reversed(included) if recording.is_of(run.header)), None)


def _lacking(recordings: Iterable[Assignment], included: Sequence[Run], runs: Sequence[Run]) -> tuple[Assignment, ...]:
    """Return the recordings that have no usable run of their own, or the rest of one that ended early."""
    free, lacking = [run for run in included if run.usable], []
    for recording in recordings:
        run = next((run for run in free if recording.is_of(run.header)), None)
        rest = _rest(recording, included, runs) if run is None or run.header.family == "sine" else None
        if rest is not None or run is None:
            lacking.append(rest or recording)
        else:
            free.remove(run)
    return tuple(lacking)


def _rest(recording: Assignment, included: Sequence[Run], runs: Sequence[Run]) -> Assignment | None:
    """Return what completes the newest run of a recording, None unless this is a series or staircase that is short."""
    run = _newest(recording, included)
    if run is None or run.grows:
        return None
    words: Words = (*recording.words[:2], "--resume", run.folder.name)
    with suppress(KeyError, TypeError, ValueError, DataError):  # it is no series or staircase, or cannot be read
        if run.header.family == "sine":
            sweep, simulated = SineSweep.of_run(run), run.header.simulated
            lacks = missing_sines(sweep, runs, simulated=simulated, excluded=True)
            if len(lacks) < len(missing_sines(sweep, runs, simulated=simulated)):  # --resume would repeat excluded ones
                words = (*words, "--hz", ",".join(f"{sine.hz:g}" for sine in lacks))
            return replace(recording, words=words, questions=None, reminder=_AS_BEFORE) if lacks else None
        from cfid.recordings.resumed import steps_left

        if run.header.state != "complete" and any(steps_left(run)):
            return replace(recording, words=words, questions=None, reminder=_AS_BEFORE)
    return None


def _newer(fit: Fit, runs: Sequence[Run], values: Values) -> int:
    """Return how many runs that no kept fit of its kind used were recorded after a fit.

    Where the clock was set back, these are the runs after the last one that the fit used.
    """
    used = {name for other in values.fits if other.name == fit.name for name in other.recordings}
    last = max((run.header.number or 0 for run in runs if run.folder.name in fit.recordings), default=0)
    newer, latest = 0, datetime.min.replace(tzinfo=UTC)
    for run in runs:
        set_back = run.header.started < latest
        after = (run.header.number or 0) > last if set_back else run.header.started > fit.section.found
        newer += after and run.folder.name not in used
        latest = max(latest, run.header.started)
    return newer


def _holds(last: Fit, runs: Sequence[Run], values: Values) -> bool:
    """Return whether the last fit of a kind was rejected as a whole, and used all runs as they are now."""
    used_all = last.recordings >= {run.folder.name for run in runs}
    rejected = not last.section.accepted and not last.section.parameters and bool(last.section.rejected)
    return rejected and used_all and not values.outdated(last)
