"""A wall clock that is set while a run is recorded: no time in the run jumps, and nothing is lost."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cfid.rig.loop import Loop
from cfid.rig.ports import StampedPort
from tests.lab import ROOT
from tests.rig_in_a_folder import lab_in as served_lab_in
from tests.virtual_lab import LOADCELL_HZ, lab_in

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="preloads a library, reads the kernel's stamps")

LOGGED_S = 2.0
STEP_S = -3600
Environment = dict[str, str]


@pytest.fixture
def stepping(tmp_path: Path) -> Environment:
    """Return an environment whose wall clock jumps once the file `step` exists."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler to make the clock that leaps")
    library = tmp_path / "step_clock.so"
    source = Path(__file__).parent / "step_clock.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return {
        **os.environ,
        "LD_PRELOAD": str(library),
        "CLOCK_STEP_S": str(STEP_S),
        "CLOCK_STEP_FILE": str(tmp_path / "step"),
    }


@pytest.mark.usefixtures("in_time")
def test_a_run_during_which_the_clock_is_set_is_smooth_and_complete(tmp_path: Path, stepping: Environment) -> None:
    with served_lab_in(tmp_path) as lab:
        lab.environment.update(stepping)
        began_s = time.time()
        log = lab.start("log", "loadcell", "--for", LOGGED_S, anew=True)
        log.wait_for_rows(300)
        (tmp_path / "step").touch()
        stepped_s = time.time()
        assert log.end().code == 0
        ended_s = time.time()
        run = lab.run()
    rows = pd.read_csv(run.device_file("loadcell"))

    assert (run.header.state, run.header.devices["loadcell"].lost) == ("complete", 0)
    assert np.all(np.diff(rows["rdt_sequence"]) == 1)
    assert np.abs(np.diff(rows["t"]) - 1 / LOADCELL_HZ).max() < 1e-4
    assert began_s < rows["t"].iloc[0] < stepped_s < rows["t"].iloc[-1] < ended_s
    assert np.ptp(rows["t"]) == pytest.approx(LOGGED_S, abs=0.2)


def test_a_run_during_which_the_computer_was_suspended_ends_there_and_is_failed(tmp_path: Path) -> None:
    with lab_in(tmp_path) as lab:
        log = lab.start("log", "encoder")
        log.wait_for_rows(50)
        lab.hardware.slept_s += 60.0
        said = log.end()
        header = lab.run().header

    assert said.code == 3
    assert header.state == "failed"
    assert "60.0 s" in header.reason
    assert (header.devices["encoder"].rows or 0) >= 50


# The kernel's stamps


def listening(box: socket.socket) -> tuple[StampedPort, list[float], Callable[[], object]]:
    """Return a port that talks to a box, when its datagrams arrived, and a function by which the box sends one."""
    arrivals_s: list[float] = []
    port = StampedPort.opened(Loop(), box.getsockname(), lambda data, source, at_s: arrivals_s.append(at_s))
    client = ("127.0.0.1", port.socket.getsockname()[1])
    return port, arrivals_s, lambda: box.sendto(b"datagram", client)


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_stamps_of_another_clock_are_not_believed(tmp_path: Path, stepping: Environment, step_s: int) -> None:
    body = f"""
import socket, time
from pathlib import Path
from tests.rig.test_wall_clock_steps import listening

with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
    box.bind(("127.0.0.1", 0))
    port, arrivals_s, send = listening(box)
    late_s = []
    for number in range(6):
        if number == 3:
            Path({stepping["CLOCK_STEP_FILE"]!r}).touch()
        sent_s = time.monotonic()
        send()
        port.drain()
        late_s.append((arrivals_s[-1] - sent_s, time.monotonic() - sent_s))
    port.socket.close()
print(time.time())
assert len(arrivals_s) == 6
for late, at_most in late_s:
    assert -1e-3 < late < at_most + 1e-3, late_s
"""
    ended = subprocess.run(
        [sys.executable, "-c", body],
        cwd=ROOT,
        env=stepping | {"CLOCK_STEP_S": str(step_s)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert float(ended.stdout) == pytest.approx(time.time() + step_s, abs=60)
