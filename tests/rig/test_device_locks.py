"""Who holds a device, and which rig a campaign's commands use: both depend on locks that end with their process."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from cfid.console.recording import rig_of
from cfid.errors import ConfigError, DeviceError
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import Devices, EncoderPort, Rig, load_rig, new_rig_text
from cfid.rig.lock import DeviceLock, Holder, find_holder, holder_of, vehicles_held, vehicles_locked
from cfid.rig.sim_file import SIM_FILE, devices_in, published

DEVICE = "192.0.2.1:49152"
HOLD = """
import sys
from cfid.rig.lock import DeviceLock
lock = DeviceLock(sys.argv[1])
print("held", flush=True)
sys.stdin.read()
"""
AS_ANOTHER_USER = """
import os, sys  # before another user, who may not see this Python, is taken on
import cfid.rig.lock
os.setgroups([])
os.setgid(int(sys.argv[2]))
os.setuid(int(sys.argv[2]))
"""

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root may act for other users")


@pytest.fixture(autouse=True)
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Separate the locks of a test from all others."""
    folder = tmp_path / "locks"
    monkeypatch.setenv("CFID_LOCKS", str(folder))
    return folder


@contextlib.contextmanager
def another_process(body: str, *words: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a program that prints a line once it holds something, and ends with its input."""
    command = [sys.executable, "-c", body, *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


def the_holder(device: str = DEVICE) -> Holder:
    holder = find_holder(device)
    assert holder is not None
    return holder


# One holder at a time


@pytest.mark.parametrize("number", [None, signal.SIGKILL, signal.SIGTERM])
def test_the_second_is_told_who_holds_a_device_until_that_one_ends(number: signal.Signals | None) -> None:
    with another_process(HOLD, DEVICE) as first:
        assert f"process {first.pid} " in holder_of(DEVICE)
        with pytest.raises(DeviceError, match=rf"^{DEVICE} is held by process {first.pid} "):
            DeviceLock(DEVICE)
        assert holder_of("192.0.2.2:49152") == ""
        if number is None:
            first.communicate("")
        else:
            first.send_signal(number)
            first.wait(10)
        assert holder_of(DEVICE) == ""
        DeviceLock(DEVICE).release()


def test_a_lock_moves_with_a_plug_to_another_port() -> None:
    with DeviceLock("/dev/ttyACM0") as lock, DeviceLock("/dev/ttyACM2"):
        with pytest.raises(DeviceError, match="is held by"):
            lock.move("/dev/ttyACM2")
        with pytest.raises(DeviceError, match="is held by"):
            DeviceLock("/dev/ttyACM0")
        lock.move("/dev/ttyACM1")
        DeviceLock("/dev/ttyACM0").release()
        with pytest.raises(DeviceError, match="is held by"):
            DeviceLock("/dev/ttyACM1")


# Names


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("udp://localhost:19850", "udp://127.0.0.1:19850"),
        ("udp://127.1:19850/", "udp://127.0.0.1:19850"),
        ("udp://0.0.0.0:19850", "udp://127.0.0.1:19850"),
        ("radio://0/80", "radio://0/80/2M/E7E7E7E7E7"),
        ("radio://00/080/2M/e7e7e7e7e7?rate_limit=100", "radio://0/80/2M/E7E7E7E7E7"),
        ("radio://0", "radio://0/2/2M"),
        ("radio://0/80/250K/1", "radio://0/80/250K/0000000001"),
        ("radio://aabbcc/80/1M", "radio://AABBCC/80/1M"),
        ("usb://00", "usb://0"),
        *((name, name) for name in ("COM3:", "../../etc/passwd", "Gerät 1\n", "/dev/" + 200 * "x", "udp://x:99999")),
    ],
)
def test_two_spellings_of_an_address_are_one_device(one: str, other: str) -> None:
    with DeviceLock(one), pytest.raises(DeviceError, match="is held by"):
        DeviceLock(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("udp://127.0.0.2:19850", "udp://127.0.0.1:19850"),
        ("udp://127.0.0.1:19851", "udp://127.0.0.1:19850"),
        ("radio://0/80/1M", "radio://0/80/2M"),
        ("radio://0/80/2M/E7E7E7E7E8", "radio://0/80/2M"),
        ("radio://1/80/2M", "radio://0/80/2M"),
        ("usb://1", "usb://0"),
        ("/dev/ttyACM0", "/dev/ttyACM1"),
    ],
)
def test_different_addresses_are_different_devices(one: str, other: str) -> None:
    with DeviceLock(one), DeviceLock(other):
        pass


def test_vehicles_are_listed_again_and_again_without_a_connection_to_their_holder() -> None:
    """A lock accepts no connection: connections that look for its holder stay in its queue, and fill it."""
    uri = "radio://0/80/2M/E7E7E7E701"
    with another_process(HOLD, uri.lower()), DeviceLock("/dev/ttyACM0"), DeviceLock("usb://0"):
        for _ in range(2 * socket.SOMAXCONN):
            assert set(vehicles_locked()) == {uri, "usb://0"}
        assert vehicles_held() == [uri]


# Which process that is


def test_a_cfid_of_this_user_can_be_ended_and_is_told_from_the_next_one() -> None:
    with another_process(HOLD, DEVICE) as first:
        holder = the_holder()
        assert (holder.process, holder.user, holder.is_ours) == (first.pid, os.geteuid(), True)
        assert not holder.wait_for_release(0.05)
        assert not replace(holder, started=holder.started - 1).send(signal.SIGKILL)
        assert not replace(holder, inode=holder.inode + 1).send(signal.SIGKILL)
        assert holder.send(signal.SIGTERM)
        assert holder.wait_for_release(10)
        assert first.wait(10) == -signal.SIGTERM
    with another_process(HOLD, DEVICE) as second:
        assert not holder.send(signal.SIGKILL)
        assert second.poll() is None


# What others may do


@needs_root
@pytest.mark.parametrize("user", ["65533", "65534"])
def test_users_share_the_locks_of_one_another_and_cannot_be_signalled(user: str) -> None:
    with another_process(AS_ANOTHER_USER + HOLD, DEVICE, user) as first:
        with pytest.raises(DeviceError, match=rf"is held by process {first.pid} \(.*\) of "):
            DeviceLock(DEVICE)
        assert not the_holder().send(signal.SIGTERM)
        assert first.poll() is None


# rig.sim.toml

SIMULATED = Devices(encoder=EncoderPort(port="/dev/pts/99"))
SERVE = """
import sys
from pathlib import Path
from cfid.records.rig_file import Devices, EncoderPort
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


def test_a_second_simulated_rig_is_refused_and_one_that_was_killed_replaced(tmp_path: Path, rig: Rig) -> None:
    with another_process(SERVE, str(tmp_path)) as first:
        with pytest.raises(ConfigError, match="another simulated rig"), published(tmp_path, SIMULATED, seed=1):
            pass
        assert devices_in(tmp_path, rig)[0].encoder.port == "/dev/pts/98"
        first.kill()
        first.wait(10)
    assert (tmp_path / SIM_FILE).exists()
    assert devices_in(tmp_path, rig) == (rig.devices, False)
    with published(tmp_path, SIMULATED, seed=1):
        assert devices_in(tmp_path, rig) == (SIMULATED, True)


@pytest.mark.parametrize("text", ["process = 1", "no toml at all"])
def test_a_command_that_was_meant_for_a_killed_simulated_rig_does_not_go_on_to_the_real_devices(
    tmp_path: Path, rig: Rig, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / SIM_FILE).write_text(text)
    with pytest.raises(ConfigError, match="no simulated rig holds it"):
        rig_of()

    assert rig_of(or_real=True)[1:3] == (rig.devices, False)  # for `cfid motors stop`, which must never wait
