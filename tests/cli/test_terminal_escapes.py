"""Nothing that a terminal would obey is printed, whatever files, notes and names contain."""

import json
import subprocess
from pathlib import Path

import pytest

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import Label
from tests.lab import Cfid, made_run, new_campaign

EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\r[/red]\u202e"


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return new_campaign(tmp_path).folder


def harmless(said: subprocess.CompletedProcess[str]) -> bool:
    printed = said.stdout + said.stderr
    return all(letter.isprintable() or letter == "\n" for letter in printed) and "Traceback" not in printed


def test_json_for_a_file_has_escapes_where_it_is_printed(cfid: Cfid, campaign: Path) -> None:
    (campaign / RIG_FILE).write_text(new_rig_text().replace('name = "', 'name = "\\u009b31m\\u202e\\u2028'))
    said = cfid("export", "json", "--out", "-", folder=campaign)
    assert said.returncode == 0, said.stderr
    assert harmless(said), said.stdout
    assert json.loads(said.stdout)["name"].startswith("\x9b31m\u202e\u2028")


def test_reasons_and_names_of_runs_are_printed_without_escapes_and_begin_no_line_of_their_own(
    cfid: Cfid, campaign: Path
) -> None:
    place = campaign / f"lab{EVIL.replace('/', '')}"
    new_campaign(place, ('name = "', 'name = "\\u001b[2J\\u0007'))
    made_run(place, "swing", {"encoder": {"t": [1.0, 2.0], "phi": [3, 4]}}, label=Label(axis="x"))
    assert cfid("set", "mass_kg", "0.03", folder=place).returncode == 0
    for words in (
        ("runs", "note", "last", EVIL),
        ("runs", "exclude", "last", "--note", f"{EVIL}\nFORGED"),
        ("status",),
        ("runs",),
        ("show", "last", "--no-figures"),
        ("fit", "swing", "last"),
        ("fits",),
        ("parameters",),
        ("export", "list"),
        ("report", "--format", "md"),
        ("fleet", place),
    ):
        said = cfid(*words, folder=place)
        assert harmless(said), (words, said.stdout, said.stderr)
        assert not any(line.startswith("FORGED") for line in (said.stdout + said.stderr).splitlines())
