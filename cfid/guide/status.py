"""The state of a campaign: every task with what was recorded and found, and the command that comes next."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from cfid.counted import counted
from cfid.guide.certainty import Certainty, certainty_of, percent
from cfid.guide.incomplete import completing, short_series, short_staircases
from cfid.guide.plan import Assignment, Task, Words, is_vehicle, tasks
from cfid.records.campaign import Campaign
from cfid.records.files import RIG_FILE
from cfid.records.parameters import Section, runs_of
from cfid.records.resumed import resumed_by
from cfid.records.rig_file import CampaignKind
from cfid.records.run import Run
from cfid.records.stale import Stale, is_blind, other_facts, stale_in
from cfid.records.tables.angle import ENCODER

_CONTRADICTS = "contradicts the others"  # the reason for leaving out a run

State = Literal["missing", "not fitted", "stale", "rejected", "accepted"]


@dataclass(frozen=True, kw_only=True)
class TaskStatus:
    """A task: what is still to be recorded, the state of its fit and why, and how certain its quantities are.

    `rarest` is what to record again after a rejected fit: among the recordings that the fit suspects, or else among
    all, the one made least often, and the last of several. `wrong` is the name of a run without which the other runs on
    its mount agree. `blind` means that a change of rig.toml since the fit cannot be detected. `unlike` states which
    facts differ between its recordings and the current rig.toml.
    """

    task: Task
    lacking: tuple[Assignment, ...]
    rarest: Assignment | None = None
    wrong: str = ""
    state: State
    reason: str
    found: tuple[Certainty, ...]
    blind: bool = False
    unlike: str = ""

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


def status_of(campaign: Campaign, *, kind: CampaignKind | None = None) -> tuple[TaskStatus, ...]:
    """Return the state of each task of a campaign. Raises DataError when parameters.toml is invalid."""
    runs, every = campaign.runs(), campaign.runs(complete=False)
    stale = stale_in(campaign.folder, every, campaign.rig)
    sections, rejected = campaign.sections(), campaign.rejected_sections()
    order = campaign.folder.resolve().name
    swings = [run.header.devices for run in runs if run.header.kind == "swing"]
    by_gyro = bool(swings) and ENCODER not in swings[-1]
    counts = [run.header for run in every if run.header.kind == "swing" and not run.header.excluded]
    begun = sorted(counts, key=lambda one: one.started)
    swung = [one.label.axis for one in begun if one.label.axis is not None and is_vehicle(one.label)]
    planned = tasks(campaign.rig, kind=kind, order=order, swung=swung, by_gyro=by_gyro)
    short = short_series(runs, every) | short_staircases(runs)
    found = (_status(task, runs, sections, rejected.get(task.section), stale, short=short) for task in planned)
    unlike = {name: other_facts(section, campaign.rig) for name, section in sections.items()}
    return tuple(
        replace(
            one,
            lacking=tuple(completing(left, every) for left in one.lacking),
            reason=one.reason or _being_recorded(one, every),
            unlike=unlike.get(one.task.section, ""),
        )
        for one in found
    )


def beside(campaign: Campaign, statuses: Sequence[TaskStatus]) -> tuple[str, ...]:
    """Return the fits in parameters.toml that the kind of campaign does not require, such as those of flights."""
    return tuple(name for name in campaign.sections() if name not in {one.task.section for one in statuses})


def unusable_in(campaign: Campaign, statuses: Sequence[TaskStatus]) -> tuple[Unusable, ...]:
    """Return the campaign's unusable runs whose recordings are still missing; for a resumed run, its last part."""
    lacking = [recording for one in statuses for recording in one.lacking if not (one.reason and recording.repeats)]
    found, usable, every = [], campaign.runs(), campaign.runs(complete=False)
    resumed = {resumed_by(run) for run in every if not run.header.excluded}
    for run in every:
        header = run.header
        if header.verdict is None or header.verdict.usable or header.excluded or run.folder.name in resumed:
            continue
        again = next((one for one in lacking if one.is_of(header.kind, header.label)), None)
        if again is None or any(_replaces(other, run, again) for other in usable):
            continue
        if again.completes in ("", run.folder.name):  # else the rest of another recording replaces it
            reason = header.verdict.text.removeprefix(f"{run.folder.name}: ")
            found.append(Unusable(run=run.folder.name, reason=reason, again=again))
    return tuple(found)


def _replaces(other: Run, run: Run, recording: Assignment) -> bool:
    """Return whether another run is a later run of the same recording."""
    return recording.is_of(other.header.kind, other.header.label) and other.header.started > run.header.started


def remarks_of(statuses: Iterable[TaskStatus], unusable: Iterable[Unusable], step: Next) -> tuple[str, ...]:
    """Return sentences on the state of fits, on what a repetition would show, and on unusable runs.

    A reason that the next `step` already states is left out.
    """
    statuses = tuple(statuses)
    reasons = [
        f"{one.task.section}: {one.reason}"
        for one in statuses
        if one.reason and not (step.why.startswith(one.task.section) and one.reason in step.why)
    ]
    bounded = [
        f"{found.aim.key} is known to {percent(found.std)} because of the {found.bounded_by}, as rig.toml states it: "
        "recording again alone does not change that. Measure it better and state it there first: what is stated of an "
        "instrument counts for later recordings."
        for one in statuses
        for found in one.found
        if found.bounded_by
    ]
    again = [f"{one.run}: NOT USABLE: {one.reason} Record it again: {one.again.command}" for one in unusable]
    blind = ", ".join(one.task.section for one in statuses if one.blind)
    unseen = (
        f"{blind}: fitted before fits kept what they take from {RIG_FILE}. Whether that changed since is not known: "
    )
    unlike = [f"{one.task.section}: {one.unlike}" for one in statuses if one.unlike]
    return (*reasons, *unlike, *([f"{unseen}fit again to be sure."] if blind else []), *bounded, *again)


def next_of(statuses: Sequence[TaskStatus], *, kind: CampaignKind | None = None) -> Next:
    """Return what comes next: the first step to record or fit, else to repeat, else to improve, else the report.

    The report is for the `kind` of campaign that was given in place of that in rig.toml.
    """
    report: Words = ("report", *(("--kind", kind) if kind else ()))
    for one in statuses:
        if one.wrong:
            left_out: Words = ("runs", "exclude", one.wrong, "--because", _CONTRADICTS)
            return Next(words=left_out, why=f"{one.task.section} was rejected: {one.reason}")
        if one.state == "missing":
            recording = one.lacking[0]
            why = f"{one.task.section}: {one.recorded} of {counted(len(one.task.recordings), 'run')} recorded."
            why = f"{why} {one.reason}".rstrip()
            return Next(words=recording.words, why=why, recording=recording)
        if one.state in ("not fitted", "stale"):
            return Next(words=one.task.fit, why=f"{one.task.section}: {one.reason}")
    for one in statuses:
        if one.state == "rejected":
            recording = one.rarest or one.task.recordings[-1]
            why = (
                f"{one.task.section} was rejected: {one.reason} Leave out a run that was wrong: cfid runs exclude RUN."
            )
            return Next(words=recording.words, why=why, recording=recording)
    unsure = [(found, one.task) for one in statuses for found in one.found if found.short_by > 1]
    if weak := [pair for pair in unsure if not pair[0].bounded_by]:
        found, task = max(weak, key=lambda pair: pair[0].short_by)
        enough = f"If it is enough: cfid {' '.join(report)}."
        why = f"{found.aim.key} is known to {percent(found.std)}; {found.aim.purpose}. {enough}"
        return Next(words=task.recordings[-1].words, why=why, recording=task.recordings[-1])
    return Next(
        words=report, why=f"everything is found, and {'as sure as rig.toml allows' if unsure else 'sure enough'}."
    )


def _status(
    task: Task,
    runs: Sequence[Run],
    sections: Mapping[str, Section],
    refused: Section | None,
    stale: Stale,
    *,
    short: Mapping[str, str],
) -> TaskStatus:
    """Judge a task by its runs, the sections of parameters.toml, and its last fit that was rejected completely.

    `short` contains the runs of short series and staircases, by name with a sentence, which do not count as recorded.
    """
    section = sections.get(task.section)
    lacking = _lacking(task.recordings, [run for run in runs if run.folder.name not in short])
    short_of_runs = any(not one.repeats for one in lacking)
    own = [run for run in runs if any(one.is_of(run.header.kind, run.header.label) for one in task.recordings)]
    state: State = "accepted"
    reason, suspects = "", tuple[str, ...]()
    if section is not None and (rejected := [text for key, text in section.rejected.items() if _aimed(task, key)]):
        state, reason, suspects = "rejected", rejected[0], section.suspects
    elif section is not None and (reasons := stale(section)):
        state, reason = "missing" if short_of_runs else "stale", reasons[0]  # without these runs, a fit may always fail
    elif refused is not None and refused.suspects and _holds(refused, section, own, stale):
        state, reason, suspects = "rejected", next(iter(refused.rejected.values())), refused.suspects
    elif short_of_runs or (section is None and lacking):
        state = "missing"
        reason = next((short[run.folder.name] for run in reversed(own) if run.folder.name in short), "")
    elif refused is not None and _holds(refused, section, own, stale):
        state, reason = "rejected", next(iter(refused.rejected.values()))
    elif section is None:
        state, reason = "not fitted", "recorded, not fitted yet."
    elif newer := _newer(section, own):
        state, reason = "stale", f"{counted(newer, 'run was', 'runs were')} recorded after the fit."
    elif lacking:
        reason = f"`{lacking[0].command}` once more would show what drifted since the first."
    found = tuple(certainty_of(sections, aim) for aim in task.aims)
    return TaskStatus(
        task=task,
        lacking=lacking,
        rarest=_rarest(task.recordings, own, suspects),
        wrong=next((run.folder.name for run in own if run.folder.name in suspects), ""),
        state=state,
        reason=reason,
        found=found,
        blind=section is not None and is_blind(task.section, section),
    )


def _rarest(recordings: Sequence[Assignment], runs: Sequence[Run], suspects: Sequence[str]) -> Assignment | None:
    suspected = [one for one in recordings if one.label.axis in suspects]

    def made(recording: Assignment) -> int:
        return sum(recording.is_of(run.header.kind, run.header.label) for run in runs)

    return min(reversed(suspected or recordings), key=made, default=None)


def _being_recorded(status: TaskStatus, runs: Sequence[Run]) -> str:
    """Return a sentence if a run that a task lacks is being recorded, else ""."""
    lacking = [run for run in runs if any(one.is_of(run.header.kind, run.header.label) for one in status.lacking)]
    growing = [run.folder.name for run in lacking if run.grows]
    return f"{growing[-1]} is being recorded: wait until it has ended." if growing else ""


def _aimed(task: Task, key: str) -> bool:
    return any(aim.key == key for aim in task.aims)


def _lacking(recordings: Iterable[Assignment], runs: Sequence[Run]) -> tuple[Assignment, ...]:
    """Return the recordings that have no run of their own."""
    left, lacking = list(runs), []
    for recording in recordings:
        run = next((run for run in left if recording.is_of(run.header.kind, run.header.label)), None)
        if run is None:
            lacking.append(recording)
        else:
            left.remove(run)
    return tuple(lacking)


def _newer(section: Section, runs: Sequence[Run]) -> int:
    used = _used_by(section)
    return sum(run.folder.name not in used and run.header.started > section.found for run in runs)


def _holds(refused: Section, section: Section | None, runs: Sequence[Run], stale: Stale) -> bool:
    """Return whether a rejected fit is current: it used all runs as they are now, and no fit was accepted later."""
    latest = section is None or section.found < refused.found
    used_all = _used_by(refused) >= {run.folder.name for run in runs}
    return latest and used_all and bool(refused.rejected) and not stale(refused)


def _used_by(section: Section) -> set[str]:
    return set(runs_of(section.sources))
