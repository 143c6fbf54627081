"""Who holds a device, and which rig a campaign's commands use: locks that end with their process."""

import contextlib
import os
import signal
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.campaign import RIG_FILE, Devices, EncoderPort, Rig, load_rig, new_rig_text
from cfid.errors import ConfigError, DeviceError
from cfid.rig.lock import DeviceLock, holder_of, holder_process
from cfid.rig.sim_file import SIM_FILE, devices_in, published

DEVICE = "192.0.2.1:49152"
HOLD = """
import sys
from cfid.rig.lock import DeviceLock
lock = DeviceLock.take(sys.argv[1], holder="cfid log")
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Keep the locks of a test apart from everybody's."""
    folder = tmp_path / "locks"
    monkeypatch.setenv("CFID_LOCKS", str(folder))
    return folder


@contextlib.contextmanager
def another_process(body: str, *words: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a program that says a line once it holds something, and ends with its input."""
    command = [sys.executable, "-c", body, *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


def test_the_second_is_told_who_holds_a_device_until_that_one_ends() -> None:
    with another_process(HOLD, DEVICE) as first:
        assert holder_of(DEVICE) == f"process {first.pid} (cfid log)"
        with pytest.raises(DeviceError, match=rf"{DEVICE} is held by process {first.pid} \(cfid log\). End that"):
            DeviceLock.take(DEVICE, holder="cfid rig check")
        assert holder_of("192.0.2.2:49152") == ""
        first.communicate("")
        assert first.returncode == 0
        assert holder_of(DEVICE) == ""
        with DeviceLock.take(DEVICE, holder="cfid rig check"):
            pass


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_process_holds_nothing(number: signal.Signals) -> None:
    with another_process(HOLD, DEVICE) as first:
        first.send_signal(number)
        first.wait(10)
        assert holder_of(DEVICE) == ""
        DeviceLock.take(DEVICE, holder="cfid log").release()


def test_the_process_that_holds_a_device_is_told_by_its_number() -> None:
    with another_process(HOLD, DEVICE) as first:
        assert holder_process(DEVICE) == first.pid
        first.communicate("")
        assert holder_process(DEVICE) is None
    with DeviceLock.take(DEVICE, holder="cfid log"):
        assert holder_process(DEVICE) is None  # nobody else


def test_who_looks_at_a_device_again_and_again_keeps_nobody_from_taking_it() -> None:
    with another_process(HOLD, DEVICE) as first:
        first.kill()  # its name stands in the lock's file
    looking = [threading.Thread(target=lambda: [holder_of(DEVICE) for _ in range(2000)]) for _ in range(2)]
    for thread in looking:
        thread.start()
    for _ in range(300):
        DeviceLock.take(DEVICE, holder="cfid log").release()
    for thread in looking:
        thread.join()


def test_a_released_device_has_no_name_in_its_lock(locks: Path) -> None:
    DeviceLock.take(DEVICE, holder="cfid log").release()
    (file,) = locks.iterdir()
    assert file.read_text() == ""


def test_users_with_temporary_folders_of_their_own_share_the_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CFID_LOCKS")
    device = f"test-of-cfid-{os.getpid()}"
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with another_process(HOLD, device) as first:
        monkeypatch.delenv("TMPDIR")
        assert holder_process(device) == first.pid
    Path("/tmp/cfid-locks", device).unlink()


def test_a_release_frees_the_device_and_may_come_twice() -> None:
    lock = DeviceLock.take(DEVICE, holder="cfid log")
    with pytest.raises(DeviceError, match=f"process {os.getpid()} "):
        DeviceLock.take(DEVICE, holder="cfid log")
    lock.release()
    lock.release()
    with DeviceLock.take(DEVICE, holder="cfid log"):
        pass


def test_the_holder_itself_is_nobody_else() -> None:
    with DeviceLock.take(DEVICE, holder="cfid log"):
        assert holder_of(DEVICE) == ""


def test_a_short_name_after_a_long_one_is_told_alone() -> None:
    DeviceLock.take(DEVICE, holder="cfid log with many more words").release()
    with DeviceLock.take(DEVICE, holder="x"), pytest.raises(DeviceError, match=rf"process {os.getpid()} \(x\)\."):
        DeviceLock.take(DEVICE, holder="y")


@pytest.mark.parametrize("device", ["/dev/ttyACM0", "COM3:", "[fe80::1%eth0]:49152", "../../etc/passwd", "Gerät 1"])
def test_any_name_is_one_file_in_the_folder_of_locks(locks: Path, device: str) -> None:
    with DeviceLock.take(device, holder="cfid log"), pytest.raises(DeviceError, match="is held by process"):
        DeviceLock.take(device, holder="cfid log")
    assert len(list(locks.iterdir())) == 1


def test_different_devices_are_held_apart() -> None:
    with DeviceLock.take("/dev/ttyACM0", holder="a"), DeviceLock.take("/dev/ttyACM1", holder="b"):
        pass


def test_everybody_may_use_the_locks_and_nobody_but_the_owner_may_remove_them(locks: Path) -> None:
    with DeviceLock.take(DEVICE, holder="cfid log"):
        pass
    assert stat.S_IMODE(locks.stat().st_mode) == 0o1777
    (file,) = locks.iterdir()
    assert stat.S_IMODE(file.stat().st_mode) == 0o666


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may act for other users")
def test_users_share_the_locks_of_one_another() -> None:
    body = """
import fcntl, os, sys  # before another user, who may not see this Python, is taken on
from cfid.rig.lock import DeviceLock, holder_of
number = int(sys.argv[1])
os.setgroups([])
os.setgid(number)
os.setuid(number)
""" + HOLD.replace("sys.argv[1]", "sys.argv[2]")
    # A folder of which all may know, as the system's own for temporary files.
    with tempfile.TemporaryDirectory(dir="/tmp") as name, pytest.MonkeyPatch.context() as patch:
        Path(name).chmod(0o1777)
        patch.setenv("CFID_LOCKS", f"{name}/locks")
        for user in ("65533", "65534"):
            with another_process(body, user, DEVICE) as first:
                assert holder_of(DEVICE) == f"process {first.pid} (cfid log)"
        assert Path(name, "locks").stat().st_uid == 65533
        with DeviceLock.take(DEVICE, holder="cfid log"):
            assert [file.stat().st_uid for file in Path(name, "locks").iterdir()] == [65533]


def test_a_folder_with_the_sticky_bit_that_is_there_already_is_used(locks: Path) -> None:
    locks.mkdir()
    locks.chmod(0o1777)
    with DeviceLock.take(DEVICE, holder="cfid log"), pytest.raises(DeviceError):
        DeviceLock.take(DEVICE, holder="cfid log")


def test_a_link_planted_in_place_of_a_lock_is_refused_and_not_followed(locks: Path, tmp_path: Path) -> None:
    with DeviceLock.take(DEVICE, holder="cfid log"):
        (file,) = locks.iterdir()
    target = tmp_path / "precious"
    target.write_text("mine")
    for leads_to in (target, tmp_path / "nowhere"):
        file.unlink()
        file.symlink_to(leads_to)
        with pytest.raises(DeviceError, match="the device's lock cannot be opened"):
            DeviceLock.take(DEVICE, holder="cfid log")
        with pytest.raises(DeviceError, match="the device's lock cannot be opened"):
            holder_of(DEVICE)
    assert target.read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()


def test_a_folder_of_locks_that_is_none_is_told_by_name(locks: Path) -> None:
    locks.write_text("")
    with pytest.raises(DeviceError, match=f"^{locks}/.*: the device's lock cannot be opened: Not a directory"):
        DeviceLock.take(DEVICE, holder="cfid log")


# rig.sim.toml

SIMULATED = Devices(encoder=EncoderPort(port="/dev/pts/99"))
SERVE = """
import sys
from pathlib import Path
from cfid.campaign import Devices, EncoderPort
from cfid.rig.sim_file import published
with published(Path(sys.argv[1]), Devices(encoder=EncoderPort(port="/dev/pts/98")), seed=1):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    return load_rig(tmp_path / RIG_FILE)


def test_commands_use_the_simulated_rig_for_as_long_as_it_lives(tmp_path: Path, rig: Rig) -> None:
    assert devices_in(tmp_path, rig) == (rig.devices, False)
    with published(tmp_path, SIMULATED, seed=1):
        assert devices_in(tmp_path, rig) == (SIMULATED, True)
    assert devices_in(tmp_path, rig) == (rig.devices, False)
    assert not (tmp_path / SIM_FILE).exists()


def test_a_file_that_a_killed_rig_left_counts_for_nothing_and_is_replaced(tmp_path: Path, rig: Rig) -> None:
    with another_process(SERVE, str(tmp_path)) as first:
        devices, simulated = devices_in(tmp_path, rig)
        assert simulated
        assert devices.encoder.port == "/dev/pts/98"
        first.kill()
        first.wait(10)
    assert (tmp_path / SIM_FILE).exists()
    assert devices_in(tmp_path, rig) == (rig.devices, False)
    with published(tmp_path, SIMULATED, seed=1):
        assert devices_in(tmp_path, rig) == (SIMULATED, True)


def test_a_second_simulated_rig_is_refused_and_the_first_goes_on(tmp_path: Path, rig: Rig) -> None:
    with another_process(SERVE, str(tmp_path)):
        with pytest.raises(ConfigError, match="another simulated rig serves"), published(tmp_path, SIMULATED, seed=1):
            pass
        assert devices_in(tmp_path, rig)[0].encoder.port == "/dev/pts/98"


def test_a_stale_file_that_makes_no_sense_disturbs_nobody(tmp_path: Path, rig: Rig) -> None:
    (tmp_path / SIM_FILE).write_text("no toml at all")
    assert devices_in(tmp_path, rig) == (rig.devices, False)
