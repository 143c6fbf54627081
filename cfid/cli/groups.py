"""Groups of commands: lists read the docstrings of the table's commands, and calling a command imports its module."""

import ast
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group

from cfid.cli.table import COMMANDS, GROUPS, PRINT_NO_JSON, SECTIONS
from cfid.console.program import given_options, giving, program
from cfid.errors import CfidError, ConfigError, DataError, FitError, RejectedError
from cfid.experiments import EXPERIMENTS, function_at


class Command(TyperCommand):
    """A command that knows the options it was given, and keeps why a fit of all its runs gave nothing."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options; the metavar of an argument states its type already."""
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            parameters = [parameter for parameter in self.get_params(ctx) if parameter.param_type_name == kind]
            rows = [row for parameter in parameters if (row := parameter.get_help_record(ctx)) is not None]
            if kind == "argument":
                rows = [(str(parameter.metavar), text) for parameter, (_, text) in zip(parameters, rows, strict=True)]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Run the command with its options."""
        path = ctx.command_path.partition(" ")[2]
        if program().json and path in PRINT_NO_JSON:
            raise ConfigError(f"cfid {path} prints no JSON object: leave `json` out. Nothing was done.")
        with giving(ctx):
            try:
                return super().invoke(ctx)
            except (DataError, FitError) as error:
                if not isinstance(error, RejectedError) and not given_options() and not any(_words(ctx)):
                    _keep_refusal(path, str(error))
                raise


def _words(context: Any) -> list[Any]:
    """Return the values of a command's arguments."""
    arguments = [parameter.name for parameter in context.command.params if parameter.param_type_name == "argument"]
    return [context.params.get(name) for name in arguments]


def _keep_refusal(command: str, reason: str) -> None:
    """Keep why a fit gave no result, for `cfid status`; a failure to keep it is ignored: the error is raised anyway."""
    from cfid.records.campaign import find_campaign

    section = {row.fit: name for name, row in EXPERIMENTS.items()}.get(command)
    with suppress(CfidError, OSError):
        if section is not None and (campaign := find_campaign(program().campaign)) is not None:
            campaign.keep_refused(section, command, reason)


class LazyGroup(TyperGroup):
    """The commands below a path such as "" or "fit"; lists import none of them, and a call imports its module."""

    def __init__(self, *, name: str | None = None, **settings: Any) -> None:
        """List the commands below the path `name`; `settings` are typer's."""
        super().__init__(name=name, **settings)
        self.commands = {word: TyperCommand(word) for word in _below(name or "")}

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the commands' words, after reading their docstrings for the list."""
        for word, path in _below(self.name or "").items():
            self.commands[word].help = _docstring(path)
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with the first paragraphs of their docstrings, those of the program in its sections."""
        words = self.list_commands(ctx)
        for title, names in ({"Commands": words} if self.name else SECTIONS).items():
            with formatter.section(title):
                formatter.write_dl([(word, _first_paragraph(self.commands[word].help)) for word in names])

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the command's word, the imported command, and the remaining words."""
        word, _, rest = super().resolve_command(ctx, args)
        return word, None if word is None else _imported(_below(self.name or "")[word], rest), rest


def _below(path: str) -> dict[str, str]:
    """Return the paths of a group's commands by their last words."""
    above_and_word = ((words.rpartition(" "), words) for words in COMMANDS)
    return {word: words for (above, _, word), words in above_and_word if above == path}


def _docstring(path: str) -> str:
    """Return the docstring of a command, read from its source without importing it, or that of a group."""
    module, _, name = (COMMANDS[path] or "").partition(":")
    spec = find_spec(module) if module else None
    if spec is None or spec.origin is None:
        return GROUPS.get(path, "")
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    functions = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == name)
    return next((ast.get_docstring(function) or "" for function in functions), "")


def _first_paragraph(text: str | None) -> str:
    return " ".join((text or "").partition("\n\n")[0].split())


def _imported(path: str, rest: Sequence[str] = ()) -> Any:
    """Return the command of a path, or its group where commands exist below the path.

    A command with arguments of its own is a group only if the first word of `rest` names a command below it. Otherwise
    the group would mistake the first argument for a command.
    """
    place, below = COMMANDS[path], _below(path)
    group = typer.Typer(
        cls=LazyGroup, name=path, help=_docstring(path), no_args_is_help=place is None, rich_markup_mode=None
    )
    if place is None:
        return get_group(group)
    function = function_at(place)
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(path.rpartition(" ")[2], cls=Command)(function)
    command = get_command(alone)
    takes_arguments = any(parameter.param_type_name == "argument" for parameter in command.params)
    if not below or (takes_arguments and not (rest and rest[0] in below)):
        return command
    if not takes_arguments:
        group.callback(invoke_without_command=True)(function)
    return get_group(group)
