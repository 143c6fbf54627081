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
from cfid.rig.holder import Holder

from cfid.console.recording import rig_of
from cfid.errors import ConfigError, DeviceError
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import Devices, EncoderPort, Rig, load_rig, new_rig_text
from cfid.rig.lock import DeviceLock, find_holder, holder_of, vehicles_held, vehicles_locked
from cfid.rig.sim_file import SIM_FILE, devices_in, published

DEVICE = "192.0.2.1:49152"
HOLD = """
import sys
from cfid.rig.lock import DeviceLock
lock = DeviceLock.take(sys.argv[1])
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


def names_in_use() -> list[str]:
    """Return the abstract names of this computer's sockets, without the locks of tests that run in parallel."""
    names: list[str] = re.findall(r" @(.+)", Path("/proc/net/unix").read_text())
    own_set = hashlib.sha256(os.environ["CFID_LOCKS"].encode()).hexdigest()[:12]
    return [name for name in names if not name.startswith("cfid/") or name.startswith(f"cfid/{own_set}/")]


def test_the_second_is_told_who_holds_a_device_until_that_one_ends() -> None:
    with another_process(HOLD, DEVICE) as first:
        assert re.fullmatch(rf"process {first.pid} \(python[0-9.]*\)", holder_of(DEVICE))
        with pytest.raises(DeviceError, match=rf"^{DEVICE} is held by process {first.pid} \(.*\)\. End that first\.$"):
            DeviceLock.take(DEVICE)
        assert holder_of("192.0.2.2:49152") == ""
        first.communicate("")
        assert first.returncode == 0
        assert holder_of(DEVICE) == ""
        with DeviceLock.take(DEVICE):
            pass


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_process_holds_nothing(number: signal.Signals) -> None:
    with another_process(HOLD, DEVICE) as first:
        first.send_signal(number)
        first.wait(10)
        assert holder_of(DEVICE) == ""
        DeviceLock.take(DEVICE).release()


def test_who_looks_at_a_device_again_and_again_keeps_nobody_from_taking_it() -> None:
    looking = [threading.Thread(target=lambda: [holder_of(DEVICE) for _ in range(300)]) for _ in range(2)]
    for thread in looking:
        thread.start()
    for _ in range(300):
        DeviceLock.take(DEVICE).release()
    for thread in looking:
        thread.join()


def test_a_holder_that_was_asked_for_too_often_is_found_all_the_same() -> None:
    """The holder accepts no connection from processes that look for it, and a socket queues some hundreds of them."""
    with another_process(HOLD, DEVICE) as first, contextlib.ExitStack() as asking:
        (name,) = {name for name in names_in_use() if name.endswith(DEVICE)}
        with contextlib.suppress(BlockingIOError):
            while True:
                asked = asking.enter_context(socket.socket(socket.AF_UNIX))
                asked.setblocking(False)
                asked.connect(f"\0{name}")
        assert (the_holder().process, the_holder().is_ours) == (first.pid, True)


def test_a_release_frees_the_device_and_may_come_twice() -> None:
    lock = DeviceLock.take(DEVICE)
    with pytest.raises(DeviceError, match=f"process {os.getpid()} "):
        DeviceLock.take(DEVICE)
    lock.release()
    lock.release()
    with DeviceLock.take(DEVICE):
        pass


def test_the_holder_itself_is_nobody_else() -> None:
    with DeviceLock.take(DEVICE):
        assert holder_of(DEVICE) == ""
        assert the_holder().process == os.getpid()


def test_locks_of_different_sets_are_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    with DeviceLock.take(DEVICE):
        monkeypatch.setenv("CFID_LOCKS", "another rig")
        with DeviceLock.take(DEVICE):
            pass


@pytest.mark.parametrize(
    "device", ["/dev/ttyACM0", "COM3:", "[fe80::1%eth0]:49152", "../../etc/passwd", "Gerät 1\n", "/dev/" + 200 * "x"]
)
def test_any_name_is_held(device: str) -> None:
    with DeviceLock.take(device), pytest.raises(DeviceError, match=f"is held by process {os.getpid()}"):
        DeviceLock.take(device)


def test_different_devices_are_held_apart() -> None:
    with DeviceLock.take("/dev/ttyACM0"), DeviceLock.take("/dev/ttyACM1"):
        pass


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
    ],
)
def test_two_spellings_of_an_address_are_one_device(one: str, other: str) -> None:
    with DeviceLock.take(one), pytest.raises(DeviceError, match="is held by"):
        DeviceLock.take(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("udp://127.0.0.2:19850", "udp://127.0.0.1:19850"),
        ("udp://127.0.0.1:19851", "udp://127.0.0.1:19850"),
        ("radio://0/80/1M", "radio://0/80/2M"),
        ("radio://0/80/2M/E7E7E7E7E8", "radio://0/80/2M"),
        ("radio://1/80/2M", "radio://0/80/2M"),
        ("usb://1", "usb://0"),
    ],
)
def test_different_addresses_are_different_devices(one: str, other: str) -> None:
    with DeviceLock.take(one), DeviceLock.take(other):
        pass


def test_a_link_to_a_port_is_that_port(tmp_path: Path) -> None:
    (tmp_path / "encoder").symlink_to("/dev/null")
    with DeviceLock.take("/dev/null"), pytest.raises(DeviceError, match="is held by"):
        DeviceLock.take(str(tmp_path / "encoder"))


@pytest.mark.parametrize("device", ["udp://nobody.invalid:1", "udp://:0", "udp://x:99999", "radio://0/x", "usb://x"])
def test_an_address_that_makes_no_sense_is_held_as_it_stands(device: str) -> None:
    with DeviceLock.take(device), pytest.raises(DeviceError, match="is held by"):
        DeviceLock.take(device)


def test_vehicles_that_others_hold_are_told_by_their_addresses() -> None:
    with (
        another_process(HOLD, "radio://0/80/2M/e7e7e7e701"),
        another_process(HOLD, "/dev/ttyACM0"),
        DeviceLock.take("usb://0"),
    ):
        assert vehicles_held() == ["radio://0/80/2M/E7E7E7E701"]


def test_vehicles_are_listed_again_and_again_without_a_connection_to_who_holds_them() -> None:
    """A lock accepts no connection: connections that look for its holder stay in its queue, and fill it."""
    uri = "radio://0/80/2M/E7E7E7E701"
    with another_process(HOLD, uri), DeviceLock.take("usb://0"):
        for _ in range(2 * socket.SOMAXCONN):
            assert set(vehicles_locked()) == {uri, "usb://0"}
        digest = hashlib.sha256(os.environ["CFID_LOCKS"].encode()).hexdigest()[:12]
        with socket.socket(socket.AF_UNIX) as probe:
            probe.setblocking(False)
            probe.connect(f"\0cfid/{digest}/{uri}")


# Which process that is


def test_a_cfid_of_this_user_can_be_ended_and_is_told_from_the_next_one() -> None:
    with another_process(HOLD, DEVICE) as first:
        holder = the_holder()
        assert (holder.process, holder.user, holder.is_ours) == (first.pid, os.geteuid(), True)
        assert not holder.wait_until_it_lets_go(0.05)
        assert holder.send(signal.SIGTERM)
        assert holder.wait_until_it_lets_go(10)
        assert first.wait(10) == -signal.SIGTERM
        with another_process(HOLD, DEVICE) as second:
            assert not holder.send(signal.SIGKILL)
            assert second.poll() is None


def test_a_process_that_was_suspended_is_known_and_gets_what_waits_for_it() -> None:
    with another_process(HOLD, DEVICE) as first:
        first.send_signal(signal.SIGSTOP)
        end_s = time.monotonic() + 10
        while not the_holder().is_suspended:
            assert time.monotonic() < end_s
        assert the_holder().send(signal.SIGTERM, signal.SIGCONT)
        assert first.wait(10) == -signal.SIGTERM


def test_a_process_that_got_the_number_of_another_is_not_signalled() -> None:
    with another_process(HOLD, DEVICE) as first:
        holder = the_holder()
        assert not replace(holder, started=holder.started - 1).send(signal.SIGKILL)
        assert not replace(holder, inode=holder.inode + 1).send(signal.SIGKILL)
        assert first.poll() is None


def test_what_is_no_cfid_is_told_and_not_signalled() -> None:
    body = HOLD.replace(
        "sys.stdin.read()",
        "import os; os.set_inheritable(lock._bound.fileno(), True); os.execlp('sleep', '\\x1b[31msleep', '60')",
    )
    with another_process(body, DEVICE) as first:
        end_s = time.monotonic() + 10
        while "sleep" not in str(the_holder()):
            assert time.monotonic() < end_s
        assert str(the_holder()) == f"process {first.pid} ( [31msleep)"
        assert not the_holder().is_ours
        assert not the_holder().send(signal.SIGTERM)


def test_a_process_that_passed_its_lock_on_and_ended_is_not_taken_for_whoever_gets_its_number() -> None:
    body = HOLD.replace('print("held"', 'import os\nif os.fork(): os._exit(0)\nprint("held"')
    with another_process(body, DEVICE) as first:
        first.wait(10)
        assert the_holder().process == first.pid  # the kernel remembers this process
        assert not the_holder().is_ours
        assert not the_holder().send(signal.SIGTERM)


# What others may do


@needs_root
def test_users_share_the_locks_of_one_another_and_cannot_be_signalled() -> None:
    for user in ("65533", "65534"):
        with another_process(AS_ANOTHER_USER + HOLD, DEVICE, user) as first:
            assert re.fullmatch(rf"process {first.pid} \(.*\) of .+", holder_of(DEVICE))
            with pytest.raises(DeviceError, match=f"is held by process {first.pid} "):
                DeviceLock.take(DEVICE)
            assert not the_holder().is_ours
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
    with DeviceLock.take(DEVICE), another_process(AS_ANOTHER_USER + body, DEVICE, "65534") as other:
        assert other.stdout is not None
        assert other.stdout.readline() == f"{os.getpid()} False False\n"


def test_no_file_that_anybody_could_plant_takes_part_in_a_lock(locks: Path, tmp_path: Path) -> None:
    """Locks were once files, in /tmp/cfid-locks or in the folder that CFID_LOCKS names."""
    victim = tmp_path / "precious"
    victim.write_text("process 1 (cfid log)")
    names = ["link", "pipe", "folder", "forbidden", "another name", "huge"]
    locks.mkdir()
    places = dict(zip(names, [locks / f"192.0.2.{i}_49152" for i in range(len(names))], strict=True))
    places["link"].symlink_to(victim)
    os.mkfifo(places["pipe"])
    places["folder"].mkdir()
    places["forbidden"].touch(mode=0)
    places["another name"].hardlink_to(victim)
    places["huge"].touch()
    os.truncate(places["huge"], 1 << 40)
    locks.chmod(0)
    for i in range(len(names)):
        began_s = time.monotonic()
        assert holder_of(f"192.0.2.{i}:49152") == ""
        with DeviceLock.take(f"192.0.2.{i}:49152"):
            pass
        assert time.monotonic() - began_s < 5
    locks.chmod(0o700)
    assert victim.read_text() == "process 1 (cfid log)"
    assert sorted(locks.iterdir()) == sorted(places.values())


def test_a_name_that_looks_like_a_line_of_the_kernels_leads_to_no_other_process() -> None:
    with another_process(HOLD, "udp://127.0.0.1:1") as first, socket.socket(socket.AF_UNIX) as forged:
        (name,) = {name for name in names_in_use() if name.endswith("udp://127.0.0.1:1")}
        inode = the_holder("udp://127.0.0.1:1").inode
        other = name.replace("127.0.0.1:1", "127.0.0.1:2")
        forged.bind(f"\0\n0: 0 0 00010000 0001 01 {inode} @{other}")
        assert other in names_in_use()
        assert find_holder("udp://127.0.0.1:2") is None
        with another_process(HOLD, "udp://127.0.0.1:2") as second:
            assert the_holder("udp://127.0.0.1:2").process == second.pid
        assert first.poll() is None


def test_a_name_that_somebody_took_without_listening_is_refused_at_once() -> None:
    with DeviceLock.take(DEVICE):
        (name,) = {name for name in names_in_use() if name.endswith(DEVICE)}
    with socket.socket(socket.AF_UNIX) as squatter:
        squatter.bind(f"\0{name}")
        with pytest.raises(DeviceError, match=f"{DEVICE} is held by another process. End that first."):
            DeviceLock.take(DEVICE)
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


def test_a_command_that_was_meant_for_a_killed_simulated_rig_does_not_go_on_to_the_real_devices(
    tmp_path: Path, rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / SIM_FILE).write_text("process = 1")
    with pytest.raises(
        ConfigError, match=r"no simulated rig holds it.* or delete this file for the devices of rig.toml"
    ):
        rig_of(tmp_path)

    assert rig_of(tmp_path, or_real=True)[1:] == (rig.devices, False)  # for `cfid motors stop`, which must never wait
    assert "the devices are the real ones of rig.toml" in " ".join(capsys.readouterr().err.split())


def test_a_stale_file_that_makes_no_sense_disturbs_nobody(tmp_path: Path, rig: Rig) -> None:
    (tmp_path / SIM_FILE).write_text("no toml at all")
    assert devices_in(tmp_path, rig) == (rig.devices, False)
