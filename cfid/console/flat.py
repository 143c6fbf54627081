"""Turn a command's dataclasses of options into single options, and list the options that its numbers depend on."""

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

from typer.models import OptionInfo, ParameterInfo

from cfid.console.options import Delivery

_BESIDE_THE_NUMBERS = {"campaign", "json", "figures", "out", "store"}  # they set where a result goes, not its value


def flat(command: Callable[..., None]) -> Callable[..., None]:
    """Replace each parameter of a command that is a dataclass of options with those options.

    In a call from Python, an omitted option has its default, and a whole dataclass may replace its options.
    """
    hints = get_type_hints(command, include_extras=True)
    bundles: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    kinds = {name: _options_of(bundle) for name, bundle in bundles.items()}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        own = kinds.get(name, {name: (hints[name], parameter.default)})
        parameters += [
            inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
            for key, (kind, default) in own.items()
        ]

    @functools.wraps(command)
    def called(**options: Any) -> None:
        given = given_options(called, options)
        for name, bundle in bundles.items():
            if not isinstance(options.get(name), bundle):  # an option may share the name of its dataclass
                own = {key: options.pop(key, default) for key, (_, default) in kinds[name].items()}
                options[name] = bundle(**own, **({"given": given} if bundle is Delivery else {}))
        command(**options)

    del called.__wrapped__
    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return called


def given_options(command: Callable[..., None], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return those options of a call that its numbers depend on and that differ from their defaults."""
    given = {
        name: _stated(options[name])
        for name, one in options_that_count(command).items()
        if options.get(name, one.default) != one.default
    }
    labels = [word for word in given_words(command, options) if "=" in word]
    return given | ({"labels": labels} if labels else {})


def options_that_count(command: Callable[..., None]) -> dict[str, inspect.Parameter]:
    """Return those options of a command, by name, that its numbers depend on."""
    parameters = inspect.signature(command).parameters
    options = {name: one for name, one in parameters.items() if _is(OptionInfo, one.annotation)}
    return {name: one for name, one in options.items() if name not in _BESIDE_THE_NUMBERS}


def given_words(command: Callable[..., None], options: Mapping[str, Any]) -> list[str]:
    """Return the words given as a command's list of runs, such as AXIS=RUN."""
    parameters = inspect.signature(command).parameters
    given = [options.get(name) for name, one in parameters.items() if not _is(OptionInfo, one.annotation)]
    return [str(word) for words in given if isinstance(words, list) for word in words]


def _is(what: type, kind: Any) -> bool:
    """Return whether the annotation `kind` of a parameter contains an instance of `what`, such as OptionInfo."""
    return any(isinstance(one, what) for one in get_args(kind))


def _default(field: "Field[Any]") -> Any:
    return inspect.Parameter.empty if field.default is MISSING else field.default


def _options_of(bundle: Any) -> dict[str, tuple[Any, Any]]:
    """Return the fields of a dataclass that are options or arguments, by name, each with its type and default."""
    kinds = get_type_hints(bundle, include_extras=True)
    return {one.name: (kinds[one.name], _default(one)) for one in fields(bundle) if _is(ParameterInfo, kinds[one.name])}


def _stated(value: Any) -> Any:
    """Return an option's value in the form that a file stores; a path that exists becomes absolute."""
    if isinstance(value, list):
        return [_stated(one) for one in value]
    if isinstance(value, Path):
        return str(value.resolve() if value.exists() else value)
    return value
