"""Where Python lacks the modules of POSIX, as on Windows: recordings are analysed, and none is made."""

import subprocess
import sys
from pathlib import Path

import pytest

BLOCKED = """
import sys

class NotThere:
    def find_spec(self, name, path=None, target=None):
        if name in ("termios", "tty", "pty", "fcntl", "resource", "grp", "pwd"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NotThere())
for name in ("termios", "tty", "pty", "fcntl", "resource", "grp", "pwd"):
    sys.modules.pop(name, None)
from cfid.cli.main import main
for words in sys.argv[1:]:
    try:
        main(words.split())
    except SystemExit as ended:
        if ended.code:
            raise
"""


def cfid(*commands: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run commands one after another in a Python without these modules, until one of them fails."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", BLOCKED, *commands],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_campaign_is_fitted_shown_reported_and_exported(bodies: Path) -> None:
    swing = max((bodies / "runs").glob("*_swing_*")).name
    ended = cfid(
        "runs", "runs note last looked-at", "show last --no-figures", f"fit swing {swing} --no-figures",
        "fit inertia --no-figures", "set arm_m 0.046", "parameters", "status", "report",
        "export json --out vehicle.json", "convert last --to csv --out run.csv", "fleet .",
        folder=bodies,
    )  # fmt: skip

    assert (ended.returncode, "Traceback" in ended.stderr) == (0, False), ended.stderr
    assert (bodies / "report.html").exists()
    assert (bodies / "vehicle.json").exists()


@pytest.mark.parametrize(
    "command",
    ["log encoder", "rig check", "rig sim", "motors stop"],
)
def test_what_reaches_devices_names_what_is_missing(bodies: Path, command: str) -> None:
    ended = cfid(command, folder=bodies)

    assert ended.returncode == 3
    assert "fcntl, pwd, termios, tty" in ended.stderr
    assert ended.stdout == ""
