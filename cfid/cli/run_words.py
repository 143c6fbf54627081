"""Which runs the words on a command line stand for: names, globs, `last`, or no word at all."""

from collections.abc import Callable, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.cli.speech import note
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.campaign import Campaign
    from cfid.run import Run

LAST = "last"
RUN_FILE = "run.toml"

Suits = Callable[["Run"], bool]


def chosen(words: Sequence[str] | None, campaign: "Campaign | None", *, suits: Suits, wanted: str) -> list[str]:
    """Return the words with `last` and globs in the names of the campaign's runs; without words all that suit.

    Only complete runs that were not excluded are found so, and what is left out is said. Words that are paths, or of
    the form NAME=FILE, stay as they are. `wanted` is what a suitable run is, for a person. Raises ConfigError when a
    word finds nothing.
    """
    if not words:
        return _every(campaign, suits, wanted)
    found: list[str] = []
    for word in words:
        if Path(word).exists() or "=" in word:
            found.append(word)
        elif word == LAST:
            found.append(_every(campaign, suits, wanted, quietly=True)[-1])
        elif is_glob(word):
            found += _matching(word, campaign, suits, wanted)
        else:
            found.append(word)
    return found


def is_glob(word: str) -> bool:
    """Return whether a word is a pattern of names."""
    return bool(set(word) & set("*?["))


def labelled(kind: str, *bodies: str) -> Suits:
    """Return what tells runs of a kind, and of some bodies; one that says no body is of the vehicle."""
    return lambda run: run.header.kind == kind and (not bodies or (run.header.label.body or "crazyflie") in bodies)


def _every(campaign: "Campaign | None", suits: Suits, wanted: str, *, quietly: bool = False) -> list[str]:
    if campaign is None:
        raise ConfigError(f"there is no campaign here to look for runs in: name files or runs: {wanted}.")
    runs = [run for run in _readable(campaign) if suits(run)]
    taken = [run.folder.name for run in runs if _is_taken(run)]
    if not taken:
        unfit = f" ({', '.join(map(_why_left, runs))})" if runs else ""
        raise ConfigError(f"{campaign.runs_folder}: no complete {wanted}{unfit}: record one, or name runs.")
    if not quietly:
        left = [_why_left(run) for run in runs if not _is_taken(run)]
        note(f"takes {len(taken)} complete {wanted}" + (f"; left out: {', '.join(left)}." if left else "."))
    return taken


def _matching(glob: str, campaign: "Campaign | None", suits: Suits, wanted: str) -> list[str]:
    if campaign is None:
        raise ConfigError(f"{glob}: there is no campaign here whose runs it could stand for.")
    runs = [run for run in _readable(campaign) if fnmatch(run.folder.name, glob) and suits(run)]
    taken = [run.folder.name for run in runs if _is_taken(run)]
    if not taken:
        unfit = f" but {', '.join(map(_why_left, runs))}" if runs else ""
        raise ConfigError(f"{glob}: no complete {wanted} in {campaign.runs_folder} has such a name{unfit}.")
    left = [_why_left(run) for run in runs if not _is_taken(run)]
    if left:
        note(f"{glob}: left out: {', '.join(left)}.")
    return taken


def _readable(campaign: "Campaign") -> "list[Run]":
    from cfid.errors import DataError
    from cfid.run import list_runs

    return [run for run in list_runs(campaign.runs_folder) if not isinstance(run, DataError)]


def _is_taken(run: "Run") -> bool:
    return run.header.state == "complete" and not run.header.excluded


def _why_left(run: "Run") -> str:
    state = "cut" if run.cut else run.header.state
    return f"{run.folder.name} ({f'excluded: {run.header.excluded}' if run.header.excluded else state})"
