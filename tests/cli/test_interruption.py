"""Ctrl-C in the middle of a long command."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("in_time")


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
