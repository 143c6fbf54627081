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
from cfid.transfer.plan import Sine, SineSweep, missing_sines

State = Literal["missing", "not fitted", "stale", "rejected", "accepted"]


@dataclass(frozen=True, kw_only=True)
class TaskStatus:
    """A task: what is still to be recorded, the state of its fit and why, and how certain its quantities are.

    `retry` is what to record again after a rejected fit: the recording that was made longest ago.
    """

    task: Task
    lacking: tuple[Assignment, ...]
    retry: Assignment | None = None
    state: State
    reason: str
    found: tuple[Certainty, ...] = ()

    @property
    def recorded(self) -> int:
        """The number of the task's runs that are recorded."""
        return len(self.task.recordings) - len(self.lacking)


@dataclass(frozen=True, kw_only=True)
class Unusable:
    """A run that was judged not usable and that no later run replaces: why, and how to record it again."""

    run: str
    reason: str
    again: Assignment


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
    """A campaign's tasks; its unusable runs; fits `beside` the plan; and unreadable runs, as sentences.

    `kind` is the kind of campaign if that of rig.toml was replaced.
    """

    tasks: tuple[TaskStatus, ...]
    unusable: tuple[Unusable, ...] = ()
    beside: tuple[str, ...] = ()
    unreadable: tuple[str, ...] = ()
    kind: CampaignKind | None = None

    @cached_property
    def next(self) -> Next:
        """What comes next."""
        return next_of(self.tasks, kind=self.kind)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on the state of fits, on what a repetition would show, and on unusable runs.

        A reason that the next step already states is left out.
        """
        why = self.next.why
        reasons = [
            f"{status.task.section}: {status.reason}"
            for status in self.tasks
            if status.reason and not (why.startswith(status.task.section) and status.reason in why)
        ]
        bounded = [
            f"{found.key} is known to {percent(found.std)} because of the {found.bounded_by}, as rig.toml states it: "
            "recording again alone does not change that. Measure it better and state it there first: what is stated of "
            "an instrument counts for later recordings."
            for status in self.tasks
            for found in status.found
            if found.bounded_by
        ]
        again = [f"{one.run}: NOT USABLE: {one.reason} Record it again: {one.again.command}" for one in self.unusable]
        return (*reasons, *bounded, *again)


def status_of(campaign: Campaign, *, kind: CampaignKind | None = None) -> Status:
    """Return the state of a campaign, for which each run.toml and each fit is read once."""
    listed = list_runs(campaign.runs_folder)
    runs = [run for run in listed if isinstance(run, Run)]
    values = campaign.values(runs)
    swings = [run for run in runs if run.header.kind == "swing" and not run.header.excluded]
    by_gyro = ["encoder" not in run.header.devices for run in swings if run.usable]
    planned = tasks(
        campaign.rig,
        kind=kind,
        swung=[run.header.label.axis or "" for run in swings if is_vehicle(run.header.label)],
        by_gyro=bool(by_gyro) and by_gyro[-1],
    )
    statuses = tuple(
        replace(_status(task, runs, values), found=tuple(certainty_of(values, key) for key in task.aims))
        for task in planned
    )
    names = {status.task.section for status in statuses}
    return Status(
        tasks=statuses,
        unusable=_unusable(statuses, runs),
        beside=tuple(dict.fromkeys(fit.name for fit in values.by_fit if fit.name not in names)),
        unreadable=tuple(str(error) for error in listed if not isinstance(error, Run)),
        kind=kind,
    )


def next_of(statuses: Sequence[TaskStatus], *, kind: CampaignKind | None = None) -> Next:
    """Return what comes next: the first step to record or fit, else to repeat, else to improve, else the report.

    The report is for the `kind` of campaign that was given in place of that in rig.toml.
    """
    report: Words = ("report", *(("--kind", kind) if kind else ()))
    for status in statuses:
        name, reason = status.task.section, status.reason
        if status.state == "missing":
            recording = status.lacking[0]
            why = f"{name}: {status.recorded} of {counted(len(status.task.recordings), 'run')} recorded. {reason}"
            return Next(words=recording.words, why=why.rstrip(), recording=recording)
        if status.state in ("not fitted", "stale"):
            return Next(words=status.task.fit, why=f"{name}: {reason}")
    for status in statuses:
        if status.state == "rejected":
            recording = status.retry or status.task.recordings[-1]
            advice = "Leave out a run that was wrong: cfid runs exclude RUN."
            why = f"{status.task.section} was rejected: {status.reason} {advice}"
            return Next(words=recording.words, why=why, recording=recording)
    unsure = [(found, status.task) for status in statuses for found in status.found if found.short_by > 1]
    if weak := [pair for pair in unsure if not pair[0].bounded_by]:
        found, task = max(weak, key=lambda pair: pair[0].short_by)
        enough = f"If it is enough: cfid {' '.join(report)}."
        why = f"{found.key} is known to {percent(found.std)}; {found.aim.purpose}. {enough}"
        return Next(words=task.recordings[-1].words, why=why, recording=task.recordings[-1])
    return Next(
        words=report, why=f"everything is found, and {'as sure as rig.toml allows' if unsure else 'sure enough'}."
    )


def _status(task: Task, runs: Sequence[Run], values: Values) -> TaskStatus:
    """Judge a task by the campaign's runs, its fit in force, and its last fit if that was rejected completely."""
    fit = values.in_force.get(task.section)
    section = None if fit is None else fit.section
    last = next((fit for fit in reversed(values.fits) if fit.name == task.section), None)
    own = [run for run in runs if any(_is_made_by(recording, run) for recording in task.recordings)]
    lacking = _lacking(task.recordings, runs)
    short_of_runs = any(not recording.repeats for recording in lacking)
    rejected = [] if section is None else [section.rejected[key] for key in task.aims if key in section.rejected]
    usable = [run for run in own if run.usable]
    state: State = "accepted"
    reason = ""
    if rejected:
        state, reason = "rejected", rejected[0]
    elif fit is not None and (reasons := values.outdated(fit)):
        state, reason = "missing" if short_of_runs else "stale", reasons[0]  # without these runs, a fit may always fail
    elif short_of_runs or (section is None and lacking):
        state, reason = "missing", _being_recorded(own)
    elif last is not None and _holds(last, usable, values) and (fit is None or not last.recordings <= fit.recordings):
        state, reason = "rejected", next(iter(last.section.rejected.values()))
    elif fit is None:
        state, reason = "not fitted", "recorded, not fitted yet."
    elif newer := _newer(fit, usable, values):
        state, reason = "stale", f"{counted(newer, 'run was', 'runs were')} recorded after the fit."
    elif lacking:
        reason = f"`{lacking[0].command}` once more would show what drifted since the first."
    return TaskStatus(
        task=task,
        lacking=lacking,
        retry=min(task.recordings, key=lambda recording: _last_made(recording, own)),
        state=state,
        reason=reason,
    )


def _is_made_by(recording: Assignment, run: Run) -> bool:
    return not run.header.excluded and recording.is_of(run.header)


def _last_made(recording: Assignment, runs: Iterable[Run]) -> tuple[int, float, str]:
    """Return the place of a recording's newest run, before all places if there is none."""
    return max((run.place for run in runs if recording.is_of(run.header)), default=(-1, 0.0, ""))


def _lacking(recordings: Iterable[Assignment], runs: Sequence[Run]) -> tuple[Assignment, ...]:
    """Return the recordings that have no usable run of their own, or the rest of one that ended early."""
    left, lacking = [run for run in runs if run.usable], []
    for recording in recordings:
        run = next((run for run in left if recording.is_of(run.header)), None)
        rest = _rest(recording, runs) if run is None or run.header.family == "sine" else None
        if rest is not None or run is None:
            lacking.append(rest or recording)
        else:
            left.remove(run)
    return tuple(lacking)


def _rest(recording: Assignment, runs: Sequence[Run]) -> Assignment | None:
    """Return what completes the newest run of a recording, None unless this is a series or staircase that is short."""
    run = next((run for run in reversed(runs) if _is_made_by(recording, run)), None)
    if run is None or run.grows:
        return None
    words: Words = (*recording.words[:2], "--resume", run.folder.name)
    if run.header.family == "sine":
        lacks, without_excluded = _missing_sines(run, runs, excluded=True), _missing_sines(run, runs, excluded=False)
        if not lacks:
            return None
        if len(lacks) < len(without_excluded):  # --resume alone would repeat the excluded ones
            words = (*words, "--periods", ",".join(str(sine.periods) for sine in lacks))
    elif run.header.state == "complete" or not _steps_left(run):
        return None
    return replace(recording, words=words, questions=None)


def _missing_sines(run: Run, runs: Sequence[Run], *, excluded: bool) -> list[Sine]:
    """Return the sines of a run's series that have no usable run, or with `excluded` no excluded one either."""
    try:
        return missing_sines(SineSweep.of_run(run), runs, simulated=run.header.simulated, excluded=excluded)
    except DataError:  # its run.toml states no series
        return []


def _steps_left(run: Run) -> bool:
    """Return whether an interrupted run lacks steps of a staircase above zero."""
    from cfid.recordings.resumed import steps_left

    with suppress(KeyError, TypeError, ValueError, DataError):  # it is no staircase, or cannot be read
        return any(steps_left(run))
    return False


def _being_recorded(runs: Iterable[Run]) -> str:
    growing = [run.folder.name for run in runs if run.grows]
    return f"{growing[-1]} is being recorded: wait until it has ended." if growing else ""


def _unusable(statuses: Iterable[TaskStatus], runs: Sequence[Run]) -> tuple[Unusable, ...]:
    """Return the newest runs of what is lacking that were judged not usable."""
    unusable: dict[str, Unusable] = {}
    for recording in (recording for status in statuses for recording in status.lacking):
        run = next((run for run in reversed(runs) if _is_made_by(recording, run)), None)
        if run is not None and run.header.verdict is not None and not run.header.verdict.usable:
            reason = run.header.verdict.text.removeprefix(f"{run.folder.name}: ")
            unusable.setdefault(run.folder.name, Unusable(run=run.folder.name, reason=reason, again=recording))
    return tuple(unusable.values())


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
