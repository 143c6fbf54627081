"""What how-to pages show of a command is what the command prints."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.places import ROOT

HOW_TO = ROOT / "docs" / "how-to"


def printed(command: str, folder: Path) -> str:
    words = [sys.executable, "-m", "cfid.cli.main", *command.split()[1:], "--no-figures"]
    environment = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1"}
    said = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return plain(said.stdout)


def plain(text: str) -> str:
    """Return a text without the lines of tables, and with single spaces."""
    return "\n".join(" ".join(re.sub("[│┃]", " ", line).split()) for line in text.splitlines())


@pytest.mark.parametrize(
    ("page", "beginning"), [("repeat-the-thesis.md", "inertia.matrix_kg_m2"), ("distances.md", "  x      now")]
)
def test_a_page_shows_what_its_command_prints(page: str, beginning: str, tmp_path: Path) -> None:
    text = (HOW_TO / page).read_text(encoding="utf-8")
    command = re.search(r"^    (cfid fit inertia x=[\d.].*)$", text, re.MULTILINE)
    shown = re.search(rf"^    {re.escape(beginning)}.*(?:\n    .+)*", text, re.MULTILINE)
    assert command is not None
    assert shown is not None

    lines = plain(printed(command[1], tmp_path)).splitlines()
    for line in plain(shown[0]).splitlines():
        assert any(each.startswith(line) for each in lines), line
