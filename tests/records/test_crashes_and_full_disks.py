"""A killed process, a full disk, a forbidden file: recordings stay readable, and what happened is reported."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from cfid.recordings.angle import angle_record
from cfid.records.fits import Fit, list_fits
from cfid.records.run import Run, read_run

pytestmark = pytest.mark.usefixtures("in_time")

STEP_RAD = 2 * np.pi / 8192

PREFACE = """
import resource, sys
from datetime import UTC, datetime
from pathlib import Path
import numpy as np
from cfid.errors import CfidError
from cfid.records.parameters import Parameter, Section, Source
from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from cfid.wire.rls import encode_positions
from tests.lab import keep

place = Path(sys.argv[1])

def limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

def new():
    devices = {"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"), counts_per_turn="rls-13bit-in-22")}
    return create_run(place, kind="swing", label=Label(), devices=devices, started=datetime.now(UTC), cfid_version="0")

def record(writer, rows, blocks):
    for block in range(blocks):
        index = np.arange(rows) + block * rows
        writer.append("encoder", (1763712345 + 1e-3 * index, encode_positions(index % 8192)))

def store(name, size):
    section = Section(method="m", found=datetime.now(UTC), cfid_version="0", accepted=True, sources=(),
                      parameters={"p": Parameter(value=np.arange(size), unit="1")})
    keep(place, name, section)
"""

linux = pytest.mark.skipif(sys.platform != "linux", reason="limits and name spaces of Linux")
SMALL_DISK = ["unshare", "-rm", "mount", "-t", "tmpfs", "none", "/tmp"]  # in a separate name space
without_small_disks = (
    not shutil.which("unshare") or subprocess.run(SMALL_DISK, capture_output=True, check=False).returncode
)


def start(
    body: str, place: Path, *, wrapper: tuple[str, ...] = (), stdin: int | None = None
) -> "subprocess.Popen[str]":
    command = [*wrapper, sys.executable, "-c", PREFACE + body, str(place)]
    return subprocess.Popen(command, stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def output(body: str, place: Path) -> str:
    process = start(body, place)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return out


def wait_for(path: Path, *, size: int) -> None:
    end = time.monotonic() + 30
    while time.monotonic() < end:
        if path.exists() and path.stat().st_size >= size:
            return
        time.sleep(0.001)
    raise TimeoutError(path)


def check_rows(run: Run, count: int) -> None:
    record = angle_record(run.folder)
    assert len(record.time_s) == count
    assert record.angle_rad == pytest.approx(STEP_RAD * np.arange(count), abs=1e-9)
    assert record.time_s == pytest.approx(1e-3 * np.arange(count), abs=1e-6)


@pytest.mark.parametrize("size", [1000, 300_000])
def test_a_run_killed_while_recording_is_cut_and_every_whole_row_is_read(tmp_path: Path, size: int) -> None:
    process = start("w = new(); print(w.folder, flush=True); record(w, 40_000, 10**9)", tmp_path)
    assert process.stdout is not None
    folder = Path(process.stdout.readline().strip())
    wait_for(folder / "encoder.csv", size=size)
    process.kill()
    process.communicate()

    run = read_run(folder)
    assert run.cut
    assert run.header.devices["encoder"].rows is None
    content = (folder / "encoder.csv").read_bytes()
    check_rows(run, content.count(b"\n") - 1)
    assert len(angle_record(folder).notes) == 1 + (not content.endswith(b"\n"))


def test_a_run_counts_as_recorded_while_its_process_lives_however_old_its_rows_are(tmp_path: Path) -> None:
    def outcome_of(folder: Path) -> str:
        os.utime(folder / "encoder.csv", (0, 0))
        return read_run(folder).outcome

    process = start("w = new(); print(w.folder, flush=True); sys.stdin.read()", tmp_path, stdin=subprocess.PIPE)
    assert process.stdout is not None
    folder = Path(process.stdout.readline().strip())
    copied = Path(shutil.copytree(folder, tmp_path / "copied"))
    try:
        assert (outcome_of(folder), outcome_of(copied)) == ("recording", "cut")
    finally:
        process.kill()
        process.communicate()

    assert outcome_of(folder) == "cut"


def test_a_run_that_no_process_of_this_computer_holds_counts_as_recorded_while_its_files_grow(tmp_path: Path) -> None:
    folder = Path(output("print(new().folder, flush=True); import os; os._exit(0)", tmp_path).strip())

    assert read_run(folder).outcome == "recording"  # this computer cannot know whether another one is recording
    os.utime(folder / "encoder.csv", (0, 0))
    assert read_run(folder).outcome == "cut"


@linux
@pytest.mark.parametrize("size", [50_000, 50_013])
def test_a_run_that_the_disk_refuses_is_failed_and_keeps_the_rows_that_fit(tmp_path: Path, size: int) -> None:
    found = output(
        f"""
limit({size})
try:
    with new() as writer:
        record(writer, 700, 10**9)
except CfidError as error:
    print(error.exit_code, error)
print(writer.folder)
""",
        tmp_path,
    ).splitlines()
    run = read_run(Path(found[1]))
    rows = run.header.devices["encoder"].rows
    assert rows is not None
    assert found[0] == f"4 {run.header.reason}"
    assert f"encoder.csv: File too large after {rows} rows, which are kept" in run.header.reason
    assert run.header.state == "failed"
    content = (run.folder / "encoder.csv").read_bytes()
    assert content.endswith(b"\n")
    assert size - 30 < len(content) <= size
    check_rows(run, rows)
    assert "the run failed (" in angle_record(run.folder).notes[0]
    assert sorted(path.name for path in run.folder.iterdir()) == ["encoder.csv", "run.toml"]


@linux
@pytest.mark.skipif(bool(without_small_disks), reason="no right to mount a small disk")
def test_a_run_that_fills_its_disk_to_the_last_byte_is_closed_as_failed(tmp_path: Path) -> None:
    disk, kept = tmp_path / "disk", tmp_path / "kept"
    disk.mkdir()
    body = f"""
import shutil, subprocess
subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", str(place)], check=True)
try:
    with new() as writer:
        record(writer, 700, 10**9)
except CfidError as error:
    print(error)
shutil.copytree(place, {str(kept)!r})
"""
    process = start(body, disk, wrapper=("unshare", "-rm"))
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "No space left on device" in out
    run = read_run(next(kept.iterdir()))
    assert run.header.state == "failed"
    assert run.header.devices["encoder"].rows is not None
    check_rows(run, run.header.devices["encoder"].rows)
    assert (run.folder / "encoder.csv").stat().st_size > 200_000


# fits


@linux
def test_a_fit_that_does_not_fit_the_disk_leaves_the_earlier_ones(tmp_path: Path) -> None:
    body = """
store("swing", 3)
limit(2000)
try:
    store("friction", 3000)
except CfidError as error:
    print(error.exit_code, error)
"""
    message = output(body, tmp_path)
    assert message.startswith(f"2 {tmp_path / 'fits'}: cannot be written: File too large.")
    assert [path.name for path in (tmp_path / "fits").iterdir()] == ["0001_swing.json"]


@linux
def test_a_campaign_that_a_full_disk_stopped_can_be_made_again(tmp_path: Path) -> None:
    body = """
from cfid.console.campaign import make_campaign
usual = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (10, usual[1]))
try:
    make_campaign(place / "lab")
except CfidError as error:
    print(error.exit_code, (place / "lab" / "rig.toml").exists())
resource.setrlimit(resource.RLIMIT_FSIZE, usual)
make_campaign(place / "lab")
"""
    assert output(body, tmp_path) == "2 False\n"
    assert (tmp_path / "lab" / "rig.toml").stat().st_size > 10


def test_a_file_that_is_being_replaced_is_whole_at_any_time(tmp_path: Path) -> None:
    size = 3_000_000
    body = f"""
from cfid.records.files import write_whole
while True:
    for letter in (b"a", b"b"):
        write_whole(place / "file", {size} * letter)
"""
    process = start(body, tmp_path)
    wait_for(tmp_path / "file", size=1)
    try:
        for _ in range(150):
            content = (tmp_path / "file").read_bytes()
            assert content in (size * b"a", size * b"b")
    finally:
        process.kill()
        process.communicate()
    assert (tmp_path / "file").read_bytes() in (size * b"a", size * b"b")


def test_fits_of_a_process_killed_while_writing_are_whole(tmp_path: Path) -> None:
    for attempt in range(2):
        process = start("while True:\n    store('a', 4000)", tmp_path)
        wait_for(tmp_path / "fits" / f"{attempt + 1:04d}_a.json", size=1)
        time.sleep(0.05 + 0.013 * attempt)
        process.kill()
        process.communicate()
        assert all(isinstance(fit, Fit) for fit in list_fits(tmp_path / "fits"))


def test_fits_that_end_at_the_same_time_are_all_kept(tmp_path: Path) -> None:
    processes = [start(f"for i in range(15):\n    store('fit{n}_' + str(i), 3)", tmp_path) for n in range(3)]
    for process in processes:
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
    assert len(list_fits(tmp_path / "fits")) == 45


# Permissions


@linux
def test_what_this_user_may_not_read_or_write_is_said_by_name() -> None:
    body = """
import fcntl, os  # before another user, who may not see this Python, is taken on
from cfid.records.campaign import find_campaign
from cfid.records.rig_file import load_rig
from cfid.records.fits import read_fit
from cfid.recordings.angle import angle_record
from cfid.records.run import read_run
from cfid.recordings.table import read_table

if os.geteuid() == 0:
    os.setgroups([])
    os.setuid(65534)
for act in (
    lambda: read_table(place / "file"),
    lambda: angle_record(place / "file"),
    lambda: angle_record(place / "locked" / "file"),
    lambda: angle_record(place / "locked"),
    lambda: read_run(place / "locked"),
    lambda: load_rig(place / "file"),
    lambda: read_fit(place / "locked" / "fit.json"),
    lambda: find_campaign(place / "locked", start=place),
    new,
    lambda: store("fit", 3),
):
    try:
        act()
    except CfidError as error:
        print(error.exit_code, "Permission denied" in str(error), str(error).removeprefix(str(place)).split(":")[0])
print(find_campaign(None, start=place / "locked"))
"""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "file").write_text("t,phi\n")
        (place / "file").chmod(0)
        (place / "locked").mkdir(mode=0)
        place.chmod(0o555)
        try:
            message = output(body, place)
        finally:
            place.chmod(0o755)
            (place / "locked").chmod(0o755)
    *refused, found = re.sub("/20.*_swing$", "/swing", message, flags=re.MULTILINE).splitlines()
    assert found == "None"
    assert refused == [
        "4 True /file",
        "4 True /file",
        "4 True /locked/file",
        "4 True /locked/run.toml",
        "4 True /locked/run.toml",
        "2 True /file",
        "4 True /locked/fit.json",
        "2 True /locked/rig.toml",
        "2 True /swing",
        "2 True /fits",
    ]
