"""A new file is complete or absent, so a command that could not write it can be repeated."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text

TOO_SMALL = 10  # largest size of a file in bytes, as on a disk that is nearly full


def run(folder: Path, *words: str, full: bool) -> "subprocess.CompletedProcess[str]":
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (TOO_SMALL, TOO_SMALL))

    command = [sys.executable, "-B", "-m", "cfid.cli.main", *words]  # -B: Python's cache would meet the limit too
    return subprocess.run(
        command, cwd=folder, preexec_fn=limit if full else None, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("words", "left"),
    [
        (("new", "sub"), "sub/rig.toml"),
        (("fleet", ".", "--out", "x.csv"), "x.csv"),
        pytest.param(("fleet", ".", "--out", "x.html"), "x.html", marks=pytest.mark.slow),
        (("fleet", "fit", ".", "--out", "out", "--jobs", "1"), "out/manifest.jsonl"),
    ],
)
def test_a_command_that_a_full_disk_stopped_can_be_repeated(words: tuple[str, ...], left: str, tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    assert run(tmp_path, "set", "rotor_radius_m", "0.0231", full=False).returncode == 0
    stopped = run(tmp_path, *words, full=True)
    assert stopped.returncode == 2
    assert "File too large" in stopped.stderr
    assert not (tmp_path / left).exists()

    again = run(tmp_path, *words, full=False)
    assert "exists already" not in again.stderr
    assert "give a new folder" not in again.stderr
    assert (tmp_path / left).stat().st_size > TOO_SMALL
