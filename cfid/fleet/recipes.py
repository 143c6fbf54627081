"""Repeat a fit through its command, with the options that its file in fits/ states."""

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any, Literal

import typer
from typer.main import get_command

from cfid.console.outcome import taking
from cfid.console.program import LABELS, OF_THE_PRINT, Program, running
from cfid.errors import ConfigError, DataError
from cfid.experiments import EXPERIMENTS, function_at
from cfid.quantities.values import is_rows
from cfid.records.fits import Fit
from cfid.records.result import Result

Method = Literal["default", "thesis"]

NO_CHANGES: Mapping[str, str] = MappingProxyType({})


def changes_of(words: Sequence[str], method: Method | None) -> dict[str, str]:
    """Return options that replace those of fits, from words such as "peaks=12" and from a method.

    Raises ConfigError for a word without a value, and for an option that no fit has.
    """
    changes = {} if method is None else {"method": str(method)}
    known = {str(option.name) for row in EXPERIMENTS.values() for option in _command(row.function).params} - {"force"}
    for word in words:
        name, sign, value = word.partition("=")
        key = name.strip().lstrip("-").replace("-", "_")
        if not (sign and value):
            raise ConfigError(f"`set` {word}: expected NAME=VALUE, as in peaks=12.")
        if key not in known:
            raise ConfigError(f"`set` {word}: no fit has an option {key}. A file in fits/ lists those of its fit.")
        changes[key] = value.strip()
    return changes


def options_of(kept: Fit, changes: Mapping[str, str] = NO_CHANGES) -> dict[str, Any]:
    """Return the options of a kept fit, with those of `changes` that its command has in place of its own.

    Raises DataError for a fit that cannot be repeated, and for an option that its command does not have.
    """
    swings = kept.quality.get("swings", ())
    known = [str(row.get("axis")) for row in swings if "known_kg_m2" in row] if is_rows(swings) else []
    if known:
        raise DataError(f"axis inertias of {', '.join(known)} were given as numbers: fit it by hand.")
    if kept.options is None:
        raise DataError("was made in Python, and its options are not kept: fit it by hand.")
    names = {option.name for option in _command_of(kept).params if option.param_type_name == "option"} - OF_THE_PRINT
    options = dict(kept.options) | {name: value for name, value in changes.items() if name in names}
    for name in options.keys() - names - {LABELS}:
        raise DataError(f"its option {name} = {options[name]!r} is none that this command takes: fit it by hand.")
    return options


def again(kept: Fit, runs: Sequence[Path], *, campaign: Path, options: Mapping[str, Any]) -> Result:
    """Fit the runs in these folders like a kept fit, with the rig.toml and the earlier fits of a campaign.

    Raises DataError for options that its command does not take.
    """
    command = _command_of(kept)
    words = _with_labels(runs, options.get(LABELS, ()))
    if command.params[0].nargs == 1:
        words = words[:1]
    for option in command.params:
        if option.param_type_name == "option" and option.name != "force" and option.name in options:
            words += _words_of(option, options[option.name])
    with running(Program(campaign=campaign)), taking() as results:
        try:
            with command.make_context(kept.command, words) as context:
                command.invoke(context)
        except typer.BadParameter as error:
            raise DataError(f"its options are none that this command takes: {error.format_message()}") from None
    return results[0]


def _words_of(option: Any, value: Any) -> list[str]:
    """Return the words that give an option a value. Raises DataError for a value that no word can state."""
    name = max(option.opts, key=len)
    if isinstance(value, bool):
        switches = option.opts if value else option.secondary_opts
        return [max(switches, key=len)] if switches else []
    if isinstance(value, list):
        return [word for item in value for word in _words_of(option, item)]
    if isinstance(value, str | int | float | Path):
        return [name, str(value)]
    raise DataError(f"its option {option.name} = {value!r} is none that this command takes: fit it by hand.")


def _with_labels(runs: Sequence[Path], typed: Sequence[str]) -> list[str]:
    """Return runs as words, with the labels typed for them. Raises DataError for a label of any other run."""
    names = {run.name for run in runs}
    labelled = [word.partition("=") for word in map(str, typed) if PurePath(word).name not in names]
    labels = {PurePath(run).name: label for label, _, run in labelled}
    if lost := labels.keys() - names:
        raise DataError(f"{labels[min(lost)]}={min(lost)} was typed, which is none of its runs: fit it by hand.")
    return [f"{labels[run.name]}={run}" if run.name in labels else str(run) for run in runs]


def _command_of(kept: Fit) -> Any:
    place = next((row.function for row in EXPERIMENTS.values() if row.fit == kept.command), None)
    if place is None:
        raise DataError(f"`cfid {kept.command}` is not repeated from its file: fit it by hand.")
    return _command(place)


def _command(place: str) -> Any:
    program = typer.Typer(add_completion=False)
    program.command()(function_at(place))
    return get_command(program)
