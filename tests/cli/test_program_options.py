"""The program's own options stand anywhere in the line, and what a command cannot do with them is refused."""

import json
from pathlib import Path

import pytest

from cfid.cli.main import main
from cfid.console.program import Program, options_first, program
from tests.lab import Cfid, new_campaign


@pytest.mark.parametrize(
    "words",
    [
        ["-C", "{campaign}", "--json", "runs"],
        ["runs", "--json", "-C", "{campaign}"],
        ["--json", "runs", "--campaign={campaign}"],
        ["runs", "-C{campaign}", "--json"],
        ["runs", "--campaign", "{campaign}", "--json", "--quiet", "--yes"],
    ],
)
def test_options_of_the_program_may_stand_anywhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    new_campaign(tmp_path / "lab")
    with pytest.raises(SystemExit) as ended:
        main([word.format(campaign=tmp_path / "lab") for word in words])

    assert not ended.value.code
    assert json.loads(capsys.readouterr().out) == {"command": "runs", "runs": [], "warnings": []}
    assert program() == Program()  # for the next command of this process


def test_only_words_before_a_bare_dash_dash_move_to_the_front() -> None:
    assert options_first(["set", "x_m", "--", "--json", "-C"]) == ["set", "x_m", "--", "--json", "-C"]
    assert options_first(["runs", "note", "last", "a", "--quiet", "-C", "lab"]) == [
        "--quiet", "-C", "lab", "runs", "note", "last", "a",
    ]  # fmt: skip


def test_a_folder_that_is_missing_and_json_of_a_command_without_it_change_nothing(cfid: Cfid, tmp_path: Path) -> None:
    new_campaign(tmp_path)
    before = sorted(path.name for path in tmp_path.rglob("*"))

    for words in (("report", "-C"), ("runs", "--campaign="), ("runs", "-C", "")):
        assert cfid(*words).returncode == 2
    assert cfid("new", "other", "--json").returncode == 2
    assert cfid("set", "arm_m", "0.046", "--json").returncode == 2
    assert sorted(path.name for path in tmp_path.rglob("*")) == before
