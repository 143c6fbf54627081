"""How-to pages show what their commands print."""

import re

import pytest

from tests.lab import ROOT, Cfid

HOW_TO = ROOT / "docs" / "how-to"


def plain(text: str) -> str:
    """Return a text without the vertical lines of tables, and with single spaces."""
    return "\n".join(" ".join(re.sub("[│┃]", " ", line).split()) for line in text.splitlines())


def test_the_page_of_the_thesis_shows_what_its_command_prints(cfid: Cfid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("NO_COLOR", "1")
    text = (HOW_TO / "repeat-the-thesis.md").read_text(encoding="utf-8")
    command = re.search(r"^    (cfid fit inertia x=[\d.].*)$", text, re.MULTILINE)
    shown = re.search(r"^    inertia\.matrix_kg_m2.*(?:\n    .+)*", text, re.MULTILINE)
    assert command is not None
    assert shown is not None

    ended = cfid(*command[1].split()[1:], "--no-figures")
    assert ended.returncode == 0, ended.stderr
    lines = plain(ended.stdout).splitlines()
    for line in plain(shown[0]).splitlines():
        assert any(each.startswith(line) for each in lines), line
