"""The process of a command: foreign modules, a Python without POSIX, and Ctrl-C in the middle."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.lab import new_campaign


def test_next_becomes_its_command_in_a_folder_with_foreign_modules(tmp_path: Path) -> None:
    """As its installed script does, cfid imports nothing from the current folder, nor from the campaign's."""
    campaign = new_campaign(tmp_path / "campaign").folder
    for folder in (campaign, tmp_path):
        for name in ("cfid", "queue", "struct"):
            (folder / f"{name}.py").write_text(f"open({str(folder / 'ran')!r}, 'a')\nraise ImportError({name!r})\n")
    command = [sys.executable, "-P", "-m", "cfid.cli.main", "next", "--yes", "--campaign", str(campaign)]
    for where in (campaign, tmp_path):
        ended = subprocess.run(command, cwd=where, input="", capture_output=True, text=True, check=False, timeout=120)
        assert "next: cfid " in ended.stdout
        assert "Traceback" not in ended.stderr
        assert ended.returncode not in (0, 1), ended.stderr  # its command ran, and found no instrument
    assert not list(tmp_path.rglob("ran"))


# Where Python lacks the modules of POSIX, as on Windows


BLOCKED = """
import sys

class NotThere:
    def find_spec(self, name, path=None, target=None):
        if name in ("termios", "tty", "pty", "fcntl", "grp", "pwd"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NotThere())
for name in ("termios", "tty", "pty", "fcntl", "grp", "pwd"):
    sys.modules.pop(name, None)
from cfid.cli.main import main
for words in sys.argv[1:]:
    try:
        main(words.split())
    except SystemExit as ended:
        if ended.code:
            raise
"""


def without_posix(*commands: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run commands one after another in a Python without these modules, until one of them fails."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", BLOCKED, *commands],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_campaign_is_fitted_shown_reported_and_exported(bodies: Path) -> None:
    swing = max((bodies / "runs").glob("*_swing_*")).name
    ended = without_posix(
        "runs", "runs note last looked-at", "show last --no-figures", f"fit swing {swing} --no-figures",
        "fit inertia --no-figures", "set arm_m 0.046", "parameters", "status", "report",
        "export json --out vehicle.json", "convert last --to csv --out run.csv", "fleet .",
        folder=bodies,
    )  # fmt: skip

    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False), ended.stderr
    assert (bodies / "report.html").exists()
    assert (bodies / "vehicle.json").exists()


# Ctrl-C


@pytest.mark.usefixtures("in_time")
def test_ctrl_c_ends_the_demo_with_130_and_says_no_traceback(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cfid.cli.main", "demo", str(tmp_path / "demo")]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
        deadline = time.monotonic() + 30
        while not (tmp_path / "demo" / "rig.toml").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        running.wait(60)
        assert running.stderr is not None
        message = running.stderr.read()

    assert running.returncode == 130
    assert "Traceback" not in message
