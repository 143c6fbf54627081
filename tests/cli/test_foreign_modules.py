"""Files of the caller or of a campaign that bear the names of modules are never run by a process that cfid starts."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text

NAMES = ("cfid", "queue", "struct")


def planted(folder: Path) -> Path:
    """Put files into a folder that write their name into a file beside them when they are run; return that file."""
    ran = folder / "ran"
    for name in NAMES:
        (folder / f"{name}.py").write_text(f"open({str(ran)!r}, 'a').write({name!r})\nraise ImportError({name!r})\n")
    return ran


def cfid(words: Sequence[object], folder: Path, typed: str = "") -> "subprocess.CompletedProcess[str]":
    """Run cfid as its installed script does, which imports nothing from the current folder either."""
    command = [sys.executable, "-P", "-m", "cfid.cli.main", *map(str, words)]
    return subprocess.run(command, cwd=folder, input=typed, capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (folder := tmp_path / "campaign").mkdir()
    (folder / RIG_FILE).write_text(new_rig_text())
    return folder


def test_next_becomes_its_command_in_a_folder_with_foreign_modules(campaign: Path, tmp_path: Path) -> None:
    ran = [planted(campaign), planted(tmp_path)]
    for where in (campaign, tmp_path):
        ended = cfid(("next", "--yes", "--campaign", campaign), where)
        assert "next: cfid " in ended.stdout
        assert "Traceback" not in ended.stderr
        assert ended.returncode not in (0, 1), ended.stderr  # its command ran, and found no instrument
    assert not any(file.exists() for file in ran)
