"""Repeat a fit through its command, with the options that its file in fits/ states."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from cfid.console.flat import options_that_count
from cfid.console.options import Delivery
from cfid.errors import ConfigError, DataError
from cfid.experiments import EXPERIMENTS, function_at
from cfid.quantities.values import is_rows
from cfid.records.fits import Fit
from cfid.records.result import Result

Method = Literal["default", "thesis"]
Command = Callable[..., None]

NO_CHANGES: Mapping[str, str] = MappingProxyType({})
LABELS = "labels"  # the option that contains the labels typed for runs, such as 20:0.1=RUN


def changes_of(words: Sequence[str], method: Method | None) -> dict[str, str]:
    """Return options that replace those of fits, from words such as "peaks=12" and from a method.

    Raises ConfigError for a word without a value, and for an option that no fit has.
    """
    found = {} if method is None else {"method": str(method)}
    known = {name for row in EXPERIMENTS.values() for name in options_that_count(function_at(row.function))} - {"force"}
    for word in words:
        name, sign, value = word.partition("=")
        key = name.strip().lstrip("-").replace("-", "_")
        if not (sign and value):
            raise ConfigError(f"`set` {word}: expected NAME=VALUE, as in peaks=12.")
        if key not in known:
            raise ConfigError(f"`set` {word}: no fit has an option {key}. A file in fits/ lists those of its fit.")
        found[key] = value.strip()
    return found


def options_of(kept: Fit, changes: Mapping[str, str] = NO_CHANGES) -> dict[str, Any]:
    """Return the options of a kept fit, with those of `changes` that its command has in place of its own.

    Raises DataError for a fit that cannot be repeated, and for an option that its command does not have.
    """
    swings = kept.quality.get("swings", ())
    known = [str(one.get("axis")) for one in swings if "known_kg_m2" in one] if is_rows(swings) else []
    if known:
        raise DataError(f"axis inertias of {', '.join(known)} were given as numbers: fit it by hand.")
    taken = options_that_count(_command_of(kept))
    if kept.options is None:
        raise DataError("was made in Python, and its options are not kept: fit it by hand.")
    found = dict(kept.options) | {name: value for name, value in changes.items() if name in taken}
    return {name: _checked(name, value, taken) for name, value in found.items()}


def again(kept: Fit, runs: Sequence[Path], *, campaign: Path, options: Mapping[str, Any]) -> Result:
    """Fit the runs in these folders like a kept fit, with the rig.toml and the earlier fits of a campaign."""
    command, taken = _command_of(kept), list[Result]()
    argument = next(iter(inspect.signature(command).parameters))
    labelled = _with_labels(runs, options.get(LABELS, ()))
    words: Any = labelled[0] if argument == "run" else labelled
    given = {name: value for name, value in options.items() if name not in ("force", LABELS)}
    command(**{argument: words}, campaign=campaign, delivery=Delivery(take=taken.append), **given)
    return taken[0]


def _with_labels(runs: Sequence[Path], typed: Sequence[str]) -> list[str]:
    """Return runs as words, with the labels typed for them. Raises DataError for a label of any other run."""
    names = {run.name for run in runs}
    labelled = [word.partition("=") for word in map(str, typed) if PurePath(word).name not in names]
    labels = {PurePath(run).name: label for label, _, run in labelled}
    if lost := labels.keys() - names:
        raise DataError(f"{labels[min(lost)]}={min(lost)} was typed, which is none of its runs: fit it by hand.")
    return [f"{labels[run.name]}={run}" if run.name in labels else str(run) for run in runs]


def _command_of(kept: Fit) -> Command:
    place = next((row.function for row in EXPERIMENTS.values() if row.fit == kept.command), None)
    if place is None:
        raise DataError(f"`cfid {kept.command}` is not repeated from its file: fit it by hand.")
    return function_at(place)


def _checked(name: str, value: Any, taken: Mapping[str, inspect.Parameter]) -> Any:
    try:
        return TypeAdapter(list[str] if name == LABELS else taken[name].annotation).validate_python(value)
    except (KeyError, ValidationError):
        raise DataError(f"its option {name} = {value!r} is none that this command takes: fit it by hand.") from None
