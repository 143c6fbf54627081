"""The options of the running program, those given to its command, and the command line of another process."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from cfid.errors import ConfigError

CAMPAIGN = ("-C", "--campaign")
FLAGS = ("--json", "--verbose", "--quiet", "--yes")
LABELS = "labels"  # the key, among a fit's kept options, of the labels typed for its runs, such as 20:0.1=RUN
OF_THE_PRINT = frozenset(("figures", "out"))  # options that no number depends on


@dataclass(frozen=True, kw_only=True)
class Program:
    """The campaign's folder as given, how results are printed, whether no bell rings, and questions are confirmed."""

    campaign: Path | None = None
    json: bool = False
    verbose: bool = False
    quiet: bool = False
    yes: bool = False


_USUAL = Program()
_PROGRAM: ContextVar[Program] = ContextVar("program", default=_USUAL)
_GIVEN: ContextVar[dict[str, Any] | None] = ContextVar("given", default=None)


def program() -> Program:
    """Return the options of the running program."""
    return _PROGRAM.get()


def set_program(options: Program) -> None:
    """Set the options of the running program."""
    _PROGRAM.set(options)


@contextmanager
def running(options: Program) -> Iterator[None]:
    """Run commands with these options of the program."""
    token = _PROGRAM.set(options)
    try:
        yield
    finally:
        _PROGRAM.reset(token)


def options_first(words: Sequence[str]) -> list[str]:
    """Return the words with the program's options, wherever they stand before a bare `--`, moved to the front.

    Raises ConfigError for an empty campaign folder, such as that of a variable that is not set.
    """
    front: list[str] = []
    rest: list[str] = []
    remaining = iter(words)
    for word in remaining:
        if word == "--":
            rest += [word, *remaining]
        elif word in FLAGS or word.startswith("--campaign=") or (word.startswith("-C") and word != "-C"):
            front.append(word)
        elif word in CAMPAIGN:
            value = next(remaining, None)
            if value is None:
                return [word]  # alone, so that the parser names the missing folder
            front += [word, value]
        else:
            rest.append(word)
    if "--campaign=" in front or "" in front:
        raise ConfigError("`folder`: the campaign folder is empty: name one, or leave the option out.")
    return front + rest


@contextmanager
def giving(context: typer.Context) -> Iterator[None]:
    """Run a command with the options that its context states as given."""
    token = _GIVEN.set(_given(context))
    try:
        yield
    finally:
        _GIVEN.reset(token)


def given_options() -> dict[str, Any]:
    """Return the options of the running command that were given and that its numbers depend on, as a file keeps them.

    A function that is called from Python has none.
    """
    return _GIVEN.get() or {}


def _given(context: typer.Context) -> dict[str, Any]:
    given: dict[str, Any] = {}
    for parameter in context.command.params:
        name = str(parameter.name)
        value = context.params.get(name)
        source = context.get_parameter_source(name)
        if parameter.param_type_name == "argument":
            if labels := [str(word) for word in value if "=" in str(word)] if isinstance(value, list | tuple) else []:
                given[LABELS] = labels
        elif name not in OF_THE_PRINT and source is not None and source.name != "DEFAULT":
            given[name] = _kept_form(value)
    return given


def _kept_form(value: Any) -> Any:
    """Return an option's value in the form that a file stores; a path that exists becomes absolute."""
    if isinstance(value, list | tuple):
        return [_kept_form(item) for item in value]
    if isinstance(value, Path):
        return str(value.resolve() if value.exists() else value)
    return value


def cfid_command(*words: str) -> list[str]:
    """Return the command line that runs cfid with these arguments as a process of its own.

    A campaign may hold a file such as queue.py, which Python would import in place of its own module without -P.
    """
    return [sys.executable, "-P", "-m", "cfid.cli.main", *words]
