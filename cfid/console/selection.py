"""Select the runs of a command: by names, globs or `last`, or by kind where the command names none."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.messages import note
from cfid.counted import counted
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.run import Run

LAST = "last"
RUN_FILE = "run.toml"

Matches = Callable[["Run"], bool]


def chosen(
    words: Sequence[str] | None,
    campaign: "Campaign | None",
    *,
    suits: Matches,
    wanted: str,
    excluded: bool = False,
) -> list[str]:
    """Return the words, with `last` and globs replaced by run names; without words, return all runs that match.

    Globs, `last` and the kind select only complete runs that are not excluded, and a note names the others. Words that
    are paths, or have the form NAME=FILE, stay unchanged. An interrupted run is selected together with the run that
    completed it. `wanted` describes the expected runs in messages; with `excluded`, a glob selects excluded runs too.
    Raises ConfigError when a word matches nothing.
    """
    from cfid.records.resumed import resumed_by

    words = words or ()
    finding = not words or any(_is_search(word) for word in words)
    there = readable_runs(campaign.runs_folder) if campaign is not None and finding else []
    if campaign is not None and finding:
        name_other_folders(campaign.runs_folder, words)
    resumed = {resumed_by(run) for run in there if not run.header.excluded}
    runs = [run for run in there if suits(run) and run.folder.name not in resumed]
    named = [_included(run) for run in runs] if excluded else runs
    if not words:
        return _whole(_every(runs, campaign, wanted), campaign)
    found: list[str] = []
    for word in words:
        if not _is_search(word):
            found.append(word)
            continue
        names = [_latest(runs, campaign, wanted)] if word == LAST else _matching(word, named, campaign, wanted)
        found += [name for name in names if name not in found]  # two words may name the same run
    return _whole(found, campaign)


def _included(run: "Run") -> "Run":
    return replace(run, header=run.header.model_copy(update={"excluded": ""}))


def _whole(words: Sequence[str], campaign: "Campaign | None") -> list[str]:
    """Return the words, with the interrupted runs that a run completes inserted before this run."""
    found: list[str] = []
    for word in words:
        found += [part for part in (*_completed_by(word, campaign), word) if part not in found]
    return found


def _completed_by(word: str, campaign: "Campaign | None") -> list[str]:
    """Return the names of the runs that a run completes, none for a word that names no run."""
    from cfid.records.resumed import with_completed
    from cfid.records.run import read_run

    if campaign is None or not (campaign.runs_folder / word / RUN_FILE).is_file():
        return []
    return [run.folder.name for run in with_completed(read_run(campaign.runs_folder / word))[:-1]]


def _is_search(word: str) -> bool:
    """Return whether a word is `last` or a glob, and not an existing path."""
    return not Path(word).exists() and "=" not in word and (word == LAST or is_glob(word))


def name_other_folders(runs_folder: Path, words: Sequence[str]) -> None:
    """Print a note on each folder among the runs that lacks a run.toml: only matching ones if words contain globs."""
    from cfid.records.run import folders_without_run

    patterns = [word if is_glob(word) else "*" for word in words if _is_search(word)] or ["*"]
    for folder in folders_without_run(runs_folder):
        if any(is_named(folder, pattern) for pattern in patterns):
            note(f"{folder} is left out: it has no {RUN_FILE}, so it is no run. Restore {RUN_FILE}, or move it away.")


def is_glob(word: str) -> bool:
    """Return whether a word is a pattern for names."""
    return bool(set(word) & set("*?["))


def is_named(folder: Path, glob: str) -> bool:
    """Return whether a glob matches the name of a run folder, or its path if the glob itself contains folders."""
    if Path(glob).name == glob:
        return fnmatch(folder.name, glob)
    path = folder.absolute() if Path(glob).is_absolute() else os.path.relpath(folder)
    return fnmatch(os.path.normpath(path), os.path.normpath(glob))


def labelled(kind: str, *bodies: str) -> Matches:
    """Return a predicate for runs of a kind and, if given, of some bodies; a run without a body is of the vehicle."""
    return lambda run: run.header.kind == kind and (not bodies or (run.header.label.body or "crazyflie") in bodies)


def _every(runs: "Sequence[Run]", campaign: "Campaign | None", wanted: str) -> list[str]:
    taken = _taken(runs, campaign, wanted)
    left = _left(runs)
    what, *more = wanted.split(" ", 1)  # for example "runs of cfid log thrust"
    which = " ".join([counted(len(taken), f"complete {what.removesuffix('s')}", f"complete {what}"), *more])
    note(f"takes {which}" + (f"; left out: {left}." if left else "."))
    return taken


def _latest(runs: "Sequence[Run]", campaign: "Campaign | None", wanted: str) -> str:
    last = _taken(runs, campaign, wanted)[-1]
    if newer := _left([run for run in runs if run.folder.name > last]):
        note(f"{LAST} is {last}; newer ones are left out: {newer}.")
    return last


def _taken(runs: "Sequence[Run]", campaign: "Campaign | None", wanted: str) -> list[str]:
    if campaign is None:
        raise ConfigError(f"there is no campaign here to look for runs in: name files or runs: {wanted}.")
    taken = [run.folder.name for run in runs if run.usable]
    if not taken:
        unfit = f" ({_left(runs)})" if runs else ""
        raise ConfigError(f"{campaign.runs_folder}: no complete {wanted}{unfit}: record one, or name runs.")
    return taken


def _matching(glob: str, runs: "Sequence[Run]", campaign: "Campaign | None", wanted: str) -> list[str]:
    if campaign is None:
        raise ConfigError(f"{glob}: there is no campaign here whose runs it could match.")
    named = [run for run in runs if is_named(run.folder, glob)]
    taken, left = [run.folder.name for run in named if run.usable], _left(named)
    if not taken:
        unfit = f" but {left}" if left else ""
        raise ConfigError(f"{glob}: no complete {wanted} in {campaign.runs_folder} matches{unfit}.")
    if left:
        note(f"{glob}: left out: {left}.")
    return taken


def readable_runs(runs_folder: Path) -> "list[Run]":
    """Return a campaign's readable runs; print a note on each unreadable run, which the operator may have meant."""
    from cfid.records.run import Run, list_runs

    found = list_runs(runs_folder)
    for fault in found:
        if not isinstance(fault, Run):
            note(f"a run is left out: {fault}")
    return [run for run in found if isinstance(run, Run)]


def _left(runs: "Sequence[Run]") -> str:
    """Return which runs are left out, and why."""
    return ", ".join(_why_left(run) for run in runs if not run.usable)


def _why_left(run: "Run") -> str:
    excluded = run.header.excluded
    return f"{run.folder.name} ({f'excluded: {excluded}' if excluded else run.outcome})"


def interrupted(word: Path, campaign: "Campaign", *, kind: str) -> Path:
    """Return the folder of the run that --resume names: a path, a run of the campaign, or the `last` run of this kind.

    Raises ConfigError when there is no run of this kind.
    """
    from cfid.records.run import Run, list_runs

    if str(word) != LAST:
        return word if word.exists() else campaign.runs_folder / word
    runs = [run for run in list_runs(campaign.runs_folder) if isinstance(run, Run)]
    of_kind = [run.folder for run in runs if run.header.family == kind]
    if not of_kind:
        raise ConfigError(f"last: {campaign.runs_folder} has no run of `cfid log {kind}` yet.")
    return of_kind[-1]
