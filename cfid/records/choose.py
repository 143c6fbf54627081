"""Which runs a word names: a name, a pattern, or `last`, which means one thing in every command and in Python."""

import os
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.records.run import Run  # slow to load, and not needed for --help

LAST = "last"

Matches = Callable[["Run"], bool]


class Choice(NamedTuple):
    """The runs that a word names, and those that it would name if they were usable, both oldest first."""

    runs: "list[Run]"
    left_out: "list[Run]"


def choose(word: str, runs: "Iterable[Run]", *, suits: Matches = lambda _run: True) -> Choice:
    """Return what a word names among a campaign's runs, oldest first, of which a command takes those that it `suits`.

    `last` is the newest usable one: complete, neither excluded nor judged unusable; `last KIND` that of a kind; newer
    ones are left out. A name is that of a run in any state. A pattern names the usable ones; the others are left out.
    """
    runs = list(runs)
    if named := [run for run in runs if run.folder.name == word]:  # a name may look like a pattern
        return Choice(named, [])
    matching = [run for run in runs if suits(run)]
    if is_last(word):
        kind = word.removeprefix(LAST).strip()
        of_kind = [run for run in matching if kind in ("", run.header.kind, run.header.family)]
        place = max((place for place, run in enumerate(of_kind) if run.usable), default=-1)
        return Choice(of_kind[place : place + 1] if place >= 0 else [], of_kind[place + 1 :])
    matching = [run for run in matching if is_named(run.folder, word)]
    return Choice([run for run in matching if run.usable], [run for run in matching if not run.usable])


def choose_one(word: str, runs: "Iterable[Run]", *, suits: Matches = lambda _run: True) -> Choice:
    """Return the one run that a word names; for a pattern, it may be in any state.

    Raises ConfigError where there is none, or where a pattern matches several.
    """
    choice = choose(word, runs, suits=suits)
    if is_last(word):
        if not choice.runs:
            why = f": {without(choice.left_out)}" if choice.left_out else ""
            raise ConfigError(f"{word}: there is no usable run{why}. Record one, or name a run (see `cfid runs`).")
        return choice
    named = [*choice.runs, *choice.left_out]
    if len(named) != 1:
        raise ConfigError(f"{word}: {len(named) or 'no'} runs match, expected one (see `cfid runs`).")
    return Choice(named, [])


def lasts(runs: "Sequence[Run]") -> dict[str, list[str]]:
    """Return, by name of a run, the words that mean it: `last`, and `last KIND` of every kind."""
    words: dict[str, list[str]] = {}
    for word in (LAST, *(f"{LAST} {kind}" for kind in dict.fromkeys(run.header.family for run in runs))):
        for run in choose(word, runs).runs:
            words.setdefault(run.folder.name, []).append(word)
    return words


def without(runs: "Iterable[Run]") -> str:
    """Return the names of runs that are left out, and why, on one line."""

    def reason(run: "Run") -> str:
        return f"excluded: {' '.join(run.header.excluded.split())}" if run.header.excluded else run.outcome

    return ", ".join(f"{run.folder.name} ({reason(run)})" for run in runs)


def is_last(word: str) -> bool:
    """Return whether a word is `last` or `last KIND`."""
    return word == LAST or word.startswith(f"{LAST} ")


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
