"""Who holds a device, and which rig a campaign's commands use: both depend on locks that end with their process."""

import contextlib
import hashlib
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
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


def name_of(device: str) -> str:
    """Return the abstract name that the kernel lists for a locked device."""
    own_set = hashlib.sha256(os.environ["CFID_LOCKS"].encode()).hexdigest()[:12]
    names = re.findall(rf" @(cfid/{own_set}/.+)", Path("/proc/net/unix").read_text())
    (name,) = {str(name) for name in names if name.endswith(device)}
    return name


def wait_until_suspended() -> None:
    end_s = time.monotonic() + 10
    while not the_holder().is_suspended:
        assert time.monotonic() < end_s


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


def test_looking_at_a_device_keeps_nobody_from_taking_it() -> None:
    looking = [threading.Thread(target=lambda: [holder_of(DEVICE) for _ in range(100)]) for _ in range(2)]
    for thread in looking:
        thread.start()
    for _ in range(100):
        DeviceLock(DEVICE).release()
    for thread in looking:
        thread.join()


def test_a_release_frees_the_device_and_may_come_twice() -> None:
    lock = DeviceLock(DEVICE)
    assert holder_of(DEVICE) == ""  # it is this process
    assert the_holder().process == os.getpid()
    with pytest.raises(DeviceError, match=f"process {os.getpid()} "):
        DeviceLock(DEVICE)
    lock.release()
    lock.release()
    with DeviceLock(DEVICE):
        pass


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


def test_locks_of_different_sets_are_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    with DeviceLock(DEVICE):
        monkeypatch.setenv("CFID_LOCKS", "another rig")
        with DeviceLock(DEVICE):
            pass


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


def test_a_link_to_a_port_is_that_port(tmp_path: Path) -> None:
    (tmp_path / "encoder").symlink_to("/dev/null")
    with DeviceLock("/dev/null"), pytest.raises(DeviceError, match="is held by"):
        DeviceLock(str(tmp_path / "encoder"))


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


def test_a_process_that_was_suspended_is_known_and_gets_what_waits_for_it() -> None:
    with another_process(HOLD, DEVICE) as first:
        first.send_signal(signal.SIGSTOP)
        wait_until_suspended()
        assert the_holder().send(signal.SIGTERM, signal.SIGCONT)
        assert first.wait(10) == -signal.SIGTERM


def test_what_is_no_cfid_is_told_in_printable_words_and_not_signalled() -> None:
    body = HOLD.replace(
        "sys.stdin.read()",
        "import os; os.set_inheritable(lock._socket.fileno(), True); os.execlp('sleep', '\\x1b[31msleep', '60')",
    )
    with another_process(body, DEVICE) as first:
        end_s = time.monotonic() + 10
        while "sleep" not in str(the_holder()):
            assert time.monotonic() < end_s
        assert str(the_holder()) == f"process {first.pid} ( [31msleep)"
        assert not the_holder().send(signal.SIGTERM)


def test_a_process_that_passed_its_lock_on_and_ended_is_not_taken_for_whoever_gets_its_number() -> None:
    body = HOLD.replace('print("held"', 'import os\nif os.fork(): os._exit(0)\nprint("held"')
    with another_process(body, DEVICE) as first:
        first.wait(10)
        assert the_holder().process == first.pid  # the kernel remembers this process
        assert not the_holder().send(signal.SIGTERM)


def test_a_holder_whose_queue_is_full_is_held_and_not_signalled() -> None:
    with another_process(HOLD, DEVICE) as first, contextlib.ExitStack() as asking:
        with contextlib.suppress(BlockingIOError):
            while True:
                asked = asking.enter_context(socket.socket(socket.AF_UNIX))
                asked.setblocking(False)
                asked.connect(f"\0{name_of(DEVICE)}")
        assert not the_holder().send(signal.SIGKILL)
        with pytest.raises(DeviceError, match="is held by"):
            DeviceLock(DEVICE)
        assert first.poll() is None


# What others may do


@needs_root
@pytest.mark.parametrize("user", ["65533", "65534"])
def test_users_share_the_locks_of_one_another_and_cannot_be_signalled(user: str) -> None:
    with another_process(AS_ANOTHER_USER + HOLD, DEVICE, user) as first:
        with pytest.raises(DeviceError, match=rf"is held by process {first.pid} \(.*\) of "):
            DeviceLock(DEVICE)
        assert not the_holder().send(signal.SIGTERM)
        assert first.poll() is None


@needs_root
def test_another_user_is_told_who_of_root_holds_a_device() -> None:
    body = """
from cfid.rig.lock import find_holder
holder = find_holder(sys.argv[1])
print("held", flush=True)
print(holder.process, holder.is_ours, holder.send(9), flush=True)
sys.stdin.read()
"""
    with DeviceLock(DEVICE), another_process(AS_ANOTHER_USER + body, DEVICE, "65534") as other:
        assert other.stdout is not None
        assert other.stdout.readline() == f"{os.getpid()} False False\n"


def test_a_name_that_looks_like_a_line_of_the_kernels_leads_to_no_other_process() -> None:
    with another_process(HOLD, "udp://127.0.0.1:1") as first, socket.socket(socket.AF_UNIX) as forged:
        inode = the_holder("udp://127.0.0.1:1").inode
        other = name_of("udp://127.0.0.1:1").replace("127.0.0.1:1", "127.0.0.1:2")
        forged.bind(f"\0\n0: 0 0 00010000 0001 01 {inode} @{other}")
        assert find_holder("udp://127.0.0.1:2") is None
        with another_process(HOLD, "udp://127.0.0.1:2") as second:
            assert the_holder("udp://127.0.0.1:2").process == second.pid
        assert first.poll() is None


def test_a_name_that_somebody_took_without_listening_is_refused_at_once() -> None:
    with DeviceLock(DEVICE):
        name = name_of(DEVICE)
    with socket.socket(socket.AF_UNIX) as squatter:
        squatter.bind(f"\0{name}")
        with pytest.raises(DeviceError, match=f"{DEVICE} is held by another process"):
            DeviceLock(DEVICE)
        assert find_holder(DEVICE) is None


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
    tmp_path: Path, rig: Rig, text: str
) -> None:
    (tmp_path / SIM_FILE).write_text(text)
    with pytest.raises(ConfigError, match="no simulated rig holds it"):
        rig_of(tmp_path)

    assert rig_of(tmp_path, or_real=True)[1:3] == (rig.devices, False)  # for `cfid motors stop`, which must never wait
