"""Select the runs of a command: by names, globs or `last`, or all of a kind where the command names none."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.messages import note
from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.records.choose import LAST, Choice, Matches, choose, is_glob, is_last, is_named, without
from cfid.records.files import RUN_FILE

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.run import Run


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
    searches = [word for word in words or () if _is_search(word)]
    if words and not searches:
        return _whole(words, campaign)
    if campaign is None:
        raise ConfigError(f"there is no campaign here to look for runs in: name files or runs: {wanted}.")
    runs = _whole_runs(campaign, searches, suits)
    if not words:
        choice = _choice("*", runs, campaign, wanted)
        what, *more = wanted.split(" ", 1)  # for example "runs of cfid log thrust"
        which = " ".join([counted(len(choice.runs), f"complete {what.removesuffix('s')}", f"complete {what}"), *more])
        note(f"takes {which}" + (f"; left out: {without(choice.left_out)}." if choice.left_out else "."))
        return _whole([run.folder.name for run in choice.runs], campaign)
    included = [replace(run, header=run.header.model_copy(update={"excluded": ""})) for run in runs]
    names: dict[str, None] = {}  # two words may name the same run
    for word in words:
        if word in searches:
            choice = _choice(word, included if excluded and not is_last(word) else runs, campaign, wanted)
            note_left_out(word, choice)
            names |= dict.fromkeys(run.folder.name for run in choice.runs)
        else:
            names[word] = None
    return _whole(names, campaign)


def _whole_runs(campaign: "Campaign", searches: Sequence[str], suits: Matches) -> "list[Run]":
    """Return the runs that suit, without those that a later run completes."""
    from cfid.recordings.resumed import resumed_by

    runs = readable_runs(campaign.runs_folder)
    name_other_folders(campaign.runs_folder, searches)
    resumed = {resumed_by(run) for run in runs if not run.header.excluded}
    return [run for run in runs if suits(run) and run.folder.name not in resumed]


def _choice(word: str, runs: "Iterable[Run]", campaign: "Campaign", wanted: str) -> Choice:
    choice = choose(word, runs)
    if not choice.runs:
        unfit = f" ({without(choice.left_out)})" if choice.left_out else ""
        place = campaign.runs_folder if word == "*" or is_last(word) else word
        raise ConfigError(f"{place}: no complete {wanted}{unfit}: record one, or name runs.")
    return choice


def note_left_out(word: str, choice: Choice) -> None:
    """Print a note on the runs that a word leaves out, if there are any."""
    if choice.left_out and is_last(word):
        note(f"{word} is {choice.runs[0].folder.name}; newer ones are left out: {without(choice.left_out)}.")
    elif choice.left_out:
        note(f"{word}: left out: {without(choice.left_out)}.")


def _whole(words: Iterable[str], campaign: "Campaign | None") -> list[str]:
    """Return the words, with the interrupted runs that a run completes inserted before this run."""
    from cfid.recordings.resumed import with_completed
    from cfid.records.run import read_run

    names: dict[str, None] = {}
    for word in words:
        if campaign is not None and (campaign.runs_folder / word / RUN_FILE).is_file():
            parts = with_completed(read_run(campaign.runs_folder / word))[:-1]
            names |= dict.fromkeys(run.folder.name for run in parts)
        names[word] = None
    return list(names)


def _is_search(word: str) -> bool:
    """Return whether a word is `last` or a glob, and not an existing path."""
    return not Path(word).exists() and "=" not in word and (is_last(word) or is_glob(word))


def name_other_folders(runs_folder: Path, words: Sequence[str]) -> None:
    """Print a note on each folder among the runs that lacks a run.toml: only matching ones if words contain globs."""
    from cfid.records.run import folders_without_run

    patterns = [word if is_glob(word) else "*" for word in words] or ["*"]
    for folder in folders_without_run(runs_folder):
        if any(is_named(folder, pattern) for pattern in patterns):
            note(f"{folder} is left out: it has no {RUN_FILE}, so it is no run. Restore {RUN_FILE}, or move it away.")


def readable_runs(runs_folder: Path) -> "list[Run]":
    """Return a campaign's readable runs, oldest first; print a note on each unreadable one, which may be meant."""
    from cfid.records.run import Run, list_runs

    runs = []
    for run in list_runs(runs_folder):
        if isinstance(run, Run):
            runs.append(run)
        else:
            note(f"a run is left out: {run}")
    return runs


def interrupted(word: Path, campaign: "Campaign", *, kind: str) -> Path:
    """Return the folder of the run that --resume names: a path, a run of the campaign, or the `last` of this kind.

    A run to complete may be in any state, but not excluded. Raises ConfigError when there is no run of this kind.
    """
    if str(word) != LAST:
        return word if word.exists() else campaign.runs_folder / word
    runs = [run for run in readable_runs(campaign.runs_folder) if run.header.family == kind and not run.header.excluded]
    if not runs:
        raise ConfigError(f"last: {campaign.runs_folder} has no run of `cfid log {kind}` yet.")
    return runs[-1].folder
