"""The table of commands: every command has help with an example, and a list imports none of its commands."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from cfid.cli.main import app
from cfid.cli.table import COMMANDS, GROUPS, SECTIONS

MODULES = {path: function.partition(":")[0] for path, function in COMMANDS.items() if function is not None}


def imported_by(*words: str) -> set[str]:
    code = f"import sys\nfrom cfid.cli.main import main\ntry:\n    main({words})\nexcept SystemExit:\n    pass\n"
    code += "print('imported:', *(name for name in sys.modules if name.startswith('cfid.')))"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return set(printed.rpartition("imported:")[2].split())


def shown(*words: str) -> str:
    """Return what a program's help shows, on one line."""
    ended = CliRunner().invoke(app, [*words, "--help"])
    assert ended.exit_code == 0
    return " ".join(ended.output.split())


def test_every_command_and_group_stands_in_a_list_and_has_help_with_an_example() -> None:
    for path in COMMANDS:
        *above, word = path.split()
        help_text = shown(*path.split())
        example = f"{path} " if path in GROUPS else path
        assert f"Example: cfid {example}" in help_text, path
        assert f"{word} " in shown(*above), path


def test_a_list_states_the_first_sentences_of_the_docstrings() -> None:
    assert "new Make a campaign folder with a commented rig.toml. " in shown()
    assert "log Record data from the rig. " in shown()
    assert "swing Fit the nonlinear equation of a pendulum" in shown("fit")


@pytest.mark.parametrize(("group", "lines"), [("fit", 40), ("tf", 40), ("log", 45)])
def test_help_fits_a_screen_of_80_columns(group: str, lines: int) -> None:
    for path in COMMANDS:
        if path.startswith(f"{group} "):
            printed = CliRunner(env={"COLUMNS": "80"}).invoke(app, [*path.split(), "--help"]).output.splitlines()
            assert len(printed) <= lines, path
            assert max(map(len, printed)) <= 80, path


def test_the_sections_of_the_list_name_each_command_once() -> None:
    top = [path for path in COMMANDS if " " not in path]
    assert sorted(word for words in SECTIONS.values() for word in words) == sorted(top)


@pytest.mark.parametrize("words", [("--help",), ("fit", "nonsense"), ("log",)], ids=" ".join)
def test_a_list_of_commands_imports_none_of_them(words: tuple[str, ...]) -> None:
    assert not imported_by(*words) & set(MODULES.values())


@pytest.mark.parametrize("path", ["fit swing", "runs exclude"])
def test_a_command_that_is_called_is_imported_and_no_other(path: str) -> None:
    assert imported_by(*path.split(), "--help") & set(MODULES.values()) == {MODULES[path]}
