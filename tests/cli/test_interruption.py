"""Ctrl-C in the middle of a long command."""

import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("in_time")


def test_ctrl_c_ends_the_demo_with_130_and_says_no_traceback(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cfid.cli.main", "demo", str(tmp_path / "demo")]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as running:
        deadline = time.monotonic() + 30
        while not (tmp_path / "demo" / "rig.toml").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        for _ in range(3):  # a library that is just being imported may swallow one
            running.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                running.wait(20)
                break
        assert running.stderr is not None
        message = running.stderr.read()

    assert running.returncode == 130
    assert "Traceback" not in message
