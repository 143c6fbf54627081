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
import pytest
from cfid.rig.rdt_port import Inbox, RdtPort

from cfid.records.run import read_run
from cfid.rig.loop import Loop
from cfid.wire.rdt import RECORD_BYTES
from tests.known import known
from tests.places import ROOT
from tests.rig.streaming_rig import ServedRig, served_rig, whole_rows
from tests.rig_in_a_folder import wait_until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="preloads a library, reads the kernel's stamps")

LOST_POLLS = 2  # at most
LOGGED_S = 6.0  # long enough that two programs, which start seconds apart on a busy computer, run at the same time
Environment = Callable[[int], dict[str, str]]


@pytest.fixture
def stepping(tmp_path: Path) -> Environment:
    """Return a function that makes an environment whose wall clock jumps by `step_s` once the file `step` exists."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler to make the clock that leaps")
    library = tmp_path / "step_clock.so"
    source = Path(__file__).parent / "step_clock.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return lambda step_s: {
        **os.environ,
        "LD_PRELOAD": str(library),
        "CLOCK_STEP_S": str(step_s),
        "CLOCK_STEP_FILE": str(tmp_path / "step"),
    }


@pytest.mark.parametrize("step_s", [pytest.param(3600, marks=pytest.mark.slow), -3600])
def test_a_run_during_which_the_clock_is_set_is_smooth_and_complete(
    tmp_path: Path, stepping: Environment, step_s: int
) -> None:
    with served_rig(tmp_path / "campaign") as rig:
        began_s = time.time()
        loggers = [start_logging(rig, device, stepping(step_s)) for device in ("encoder", "loadcell")]
        folders = [recording_into(process) for process in loggers]
        time.sleep(1.0)
        stepped_s = time.time()
        (tmp_path / "step").touch()
        for process in loggers:
            _, err = process.communicate(timeout=30)
            assert process.returncode == 0, err
        ended_s = time.time()
    for folder, device, longest_s in zip(folders, ("encoder", "loadcell"), (0.25, 1 / 7000 + 1e-4), strict=True):
        run = read_run(folder)
        rows = whole_rows(run.device_file(device))
        steps_s = np.diff(rows["t"])
        assert run.header.state == "complete"
        record = run.header.devices[device]
        # An answer that a busy computer delayed by 50 ms belongs to no poll; setting the clock makes none late.
        late = (record.model_extra or {})["losses"]["late_replies"] if device == "encoder" else 0
        assert known(record.lost) - late <= (LOST_POLLS if device == "encoder" else 0)
        assert late < 0.02 * len(rows)
        assert steps_s.min() > 0
        assert steps_s.max() < longest_s
        assert began_s < rows["t"].iloc[0] < stepped_s < rows["t"].iloc[-1] < ended_s
        assert np.ptp(rows["t"]) == pytest.approx(LOGGED_S, abs=0.2)
    assert steps_s.min() > 1 / 7000 - 1e-4
    assert np.all(np.diff(rows["rdt_sequence"]) == 1)


def start_logging(rig: ServedRig, device: str, environment: dict[str, str]) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "cfid.cli.main", "log", device, "--for", str(LOGGED_S)]
    command += ["--campaign", str(rig.campaign)]
    if device == "encoder":  # slow enough that a busy computer loses no polls
        command += ["--rate-hz", "200"]
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def recording_into(process: "subprocess.Popen[str]") -> Path:
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("recording into "):
            return Path(line.removeprefix("recording into ").split(" (")[0])
    raise AssertionError(process.communicate())


def recorded(folder: Path) -> int:
    file = folder / "encoder.csv"
    return file.read_bytes().count(b"\n") - 1 if file.exists() else 0  # without the header


# The kernel's stamps


def listening(box: tuple[str, int]) -> tuple[RdtPort, Inbox, tuple[str, int]]:
    inbox = Inbox(box)
    port = RdtPort(inbox, box=box, reactor=Loop())
    port.startListening()  # type: ignore[no-untyped-call]  # twisted's
    return port, inbox, ("127.0.0.1", port.socket.getsockname()[1])


def test_what_a_paused_process_reads_late_came_when_it_was_sent() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
        box.bind(("127.0.0.1", 0))
        port, inbox, client = listening(box.getsockname())
        time.sleep(0.2)  # the kernel begins to stamp a moment after it was asked to
        before_s, after_s = [], []
        for _ in range(10):
            before_s.append(time.monotonic())
            box.sendto(bytes(RECORD_BYTES), client)
            after_s.append(time.monotonic())
            time.sleep(0.03)
        port.drain()
        port.socket.close()

    arrivals_s = np.array(inbox.arrivals_s)
    assert len(arrivals_s) == 10
    assert np.all(arrivals_s > np.array(before_s) - 1e-3)
    assert np.all(arrivals_s < np.array(after_s) + 1e-3)


@pytest.mark.parametrize("step_s", [pytest.param(3600, marks=pytest.mark.slow), -3600])
def test_stamps_of_another_clock_are_not_believed(tmp_path: Path, stepping: Environment, step_s: int) -> None:
    body = f"""
import socket, time
from pathlib import Path
from tests.rig.test_wall_clock_steps import RECORD_BYTES, listening

with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
    box.bind(("127.0.0.1", 0))
    port, inbox, client = listening(box.getsockname())
    late_s = []
    for number in range(6):
        if number == 3:
            Path({str(tmp_path / "step")!r}).touch()
        sent_s = time.monotonic()
        box.sendto(bytes(RECORD_BYTES), client)
        port.drain()
        late_s.append((inbox.arrivals_s[-1] - sent_s, time.monotonic() - sent_s))
    port.socket.close()
print(time.time())
assert len(inbox.arrivals_s) == 6
for late, at_most in late_s:
    assert -1e-3 < late < at_most + 1e-3, late_s
"""
    ended = subprocess.run(
        [sys.executable, "-c", body], cwd=ROOT, env=stepping(step_s), capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert float(ended.stdout) == pytest.approx(time.time() + step_s, abs=60)


def test_a_run_during_which_the_computer_was_suspended_ends_there_and_is_failed(
    tmp_path: Path, stepping: Environment
) -> None:
    with served_rig(tmp_path / "campaign") as rig:
        process = start_logging(rig, "encoder", {**stepping(60), "CLOCK_SUSPENDED": "1"})
        folder = recording_into(process)
        wait_until(lambda: recorded(folder) > 500, "500 rows")
        (tmp_path / "step").touch()
        _, err = process.communicate(timeout=30)

    header = read_run(folder).header
    assert process.returncode == 3
    assert "the computer was suspended for 60.0 s during the recording" in err
    assert header.state == "failed"
    assert "suspended for 60.0 s" in header.reason
    assert (header.devices["encoder"].rows or 0) > 500
