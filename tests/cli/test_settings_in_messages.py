"""Messages of the Python interface name settings in backticks; the command line shows its options instead."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.console.messages import fault, in_options
from tests.lab import ROOT

COMMANDS = ROOT / "docs" / "reference" / "commands.md"
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
SETTING = re.compile(r"`([a-z]\w*)`")
OF_ANOTHER_PROGRAM = {"--comb"}  # an option of the simulator that an exported file is for


def below_the_command_line() -> Iterator[Path]:
    """Yield the modules that Python users call, without demo, guide and watch, which type commands as a person does."""
    for path in sorted((ROOT / "cfid").rglob("*.py")):
        package = path.relative_to(ROOT / "cfid").parts[0]
        if package not in ("cli", "console", "demo", "guide", "watch") and not path.stem.endswith("command"):
            yield path


def literals(source: str) -> Iterator[str]:
    """Yield the strings of a module except its docstrings."""
    tree = ast.parse(source)
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
            yield node.value


def named(pattern: re.Pattern[str]) -> dict[str, Path]:
    """Return what a pattern finds in the strings of these modules, each with its module."""
    texts = ((text, path) for path in below_the_command_line() for text in literals(path.read_text(encoding="utf-8")))
    return {found: path for text, path in texts for found in pattern.findall(text)}


def test_no_string_below_the_command_line_names_an_option() -> None:
    assert {option: path for option, path in named(OPTION).items() if option not in OF_ANOTHER_PROGRAM} == {}


def test_every_setting_in_a_message_becomes_an_option_that_there_is() -> None:
    options = set(OPTION.findall(COMMANDS.read_text(encoding="utf-8")))
    settings = named(SETTING)

    assert len(settings) > 20
    for setting, path in settings.items():
        assert in_options(f"`{setting}`") in options, path


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("give `units` n,nm or `rate_hz`.", "give --units n,nm or --rate-hz."),
        ("no rows between `from_s` 2 and `to_s` 3.", "no rows between --from 2 and --to 3."),
        ("look at it with `cfid show`; `sysctl a=1`.", "look at it with `cfid show`; `sysctl a=1`."),
    ],
)
def test_the_command_line_shows_options_for_settings(text: str, shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    fault(text)

    assert capsys.readouterr().err.strip() == f"cfid: {shown}"
