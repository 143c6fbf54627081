"""The table of commands: lists show what each command's docstring states, and only the called command is imported."""

import inspect
import subprocess
import sys
from importlib import import_module

import pytest

from cfid.cli.table import COMMANDS

FUNCTIONS = {path: (function, line) for path, (function, line) in COMMANDS.items() if function is not None}
MODULES = {path: function.partition(":")[0] for path, (function, _) in FUNCTIONS.items()}


def imported_by(*words: str) -> set[str]:
    code = f"import sys\nfrom cfid.cli.main import main\ntry:\n    main({words})\nexcept SystemExit:\n    pass\n"
    code += "print('imported:', *(name for name in sys.modules if name.startswith('cfid.')))"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    return set(printed.rpartition("imported:")[2].split())


@pytest.mark.parametrize("path", FUNCTIONS)
def test_a_list_shows_the_first_paragraph_of_the_commands_docstring(path: str) -> None:
    function, line = FUNCTIONS[path]
    module, _, name = function.partition(":")
    docstring = inspect.getdoc(getattr(import_module(module), name)) or ""

    assert line == " ".join(docstring.partition("\n\n")[0].split())


@pytest.mark.parametrize("path", COMMANDS)
def test_every_row_stands_below_a_group_of_the_table(path: str) -> None:
    above, _, word = path.rpartition(" ")

    assert word
    assert not above or above in COMMANDS


@pytest.mark.parametrize("words", [("--help",), ("fit", "--help"), ("fit", "nonsense"), ("log",)], ids=" ".join)
def test_a_list_of_commands_imports_none_of_them(words: tuple[str, ...]) -> None:
    assert not imported_by(*words) & set(MODULES.values())


@pytest.mark.parametrize("path", ["fit swing", "log ping", "runs exclude", "new"])
def test_a_command_that_is_called_is_imported_and_no_other(path: str) -> None:
    assert imported_by(*path.split(), "--help") & set(MODULES.values()) == {MODULES[path]}
