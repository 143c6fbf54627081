"""A stop stops the motors, whatever drives them and whatever became of it; a vehicle that crashed is recovered."""

import contextlib
import fcntl
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cfid.errors import DeviceError, StopError
from cfid.records.files import RIG_FILE
from cfid.records.run import list_runs
from cfid.rig.emergency import stop_vehicle
from cfid.rig.hardware import Real
from cfid.rig.link import Link, open_link
from cfid.rig.lock import DeviceLock, find_holder
from cfid.rig.stop import MAY_BE_RUNNING, stop_over
from cfid.sim.supervisor import SupervisorState
from cfid.wire.app import AppPorts, PingChannel
from cfid.wire.crtp import Packet, encode_set_by_name
from tests.flying_in_a_folder import Bench as ServedBench
from tests.flying_in_a_folder import Pilot as Process
from tests.flying_in_a_folder import bench_in as served_in
from tests.lab import ROOT
from tests.virtual_bench import Bench, bench_in

KINDS = pytest.mark.parametrize("firmware", ["app", "stock"])
HOLD = ("motors", "set", 30000, "--motor", "1,3", "--yes")
AFTERWARDS_S = 0.8  # longer than the app waits for a keep-alive, and than a setpoint stays valid
Alter = Callable[[Packet], Packet]
APP, PARAMETERS = (12, int(PingChannel.STOP)), (2, 3)  # where a stop is answered
DRIVEN = (("m2", "H", 20000), ("enable", "B", 1))  # parameters motorPowerSet that drive motor 2


def drive(link: Link) -> None:
    """Let the parameters drive motor 2, as a program does that ends then."""
    for name, kind, value in DRIVEN:
        link.send(Packet(2, 3, encode_set_by_name(f"motorPowerSet.{name}", kind, value)))


# The packets


def flipped(place: tuple[int, int], byte: int, bits: int) -> Alter:
    """Flip bits of a byte in the vehicle's answers on a port and channel."""

    def altered(packet: Packet) -> Packet:
        payload = bytearray(packet.payload)
        if packet[:2] == place:
            payload[byte] ^= bits
        return packet._replace(payload=bytes(payload))

    return altered


@pytest.mark.parametrize(
    ("lost", "altered", "by_app", "by_parameters", "after_s"),
    [
        (0, flipped(APP, 0, 0), True, True, (0.0, 0.01)),
        (9, flipped(APP, 0, 0), True, True, (0.06, 0.15)),  # the ninth is of the second turn: the third's is answered
        (
            0,
            flipped(PARAMETERS, -1, 2),
            True,
            True,
            (0.0, 0.01),
        ),  # firmware without them has nothing to clear
        (0, flipped(PARAMETERS, -1, 22), True, False, (0.0, 0.01)),  # of another type: not surely cleared
        (0, flipped(APP, 5, 1), False, True, (0.0, 0.01)),  # a command that is not zero
        (0, flipped(APP, 0, 1), False, True, (0.0, 0.01)),  # the answer to another stop
    ],
)
def test_a_stop_is_acknowledged_by_what_answers_it(
    tmp_path: Path, lost: int, altered: Alter, by_app: bool, by_parameters: bool, after_s: tuple[float, float]
) -> None:
    left = [True] * lost

    def passes(packet: Packet) -> bool:
        return not (packet.port in (2, 12) and left and left.pop())

    with bench_in(tmp_path) as bench, contextlib.closing(bench.hardware.link(bench.uri)) as link:
        sent = bench.packets()
        bench.disturb(lambda packet: [altered(packet)], passes)
        acknowledged = stop_over(link, AppPorts(), bench.hardware)
    assert (acknowledged.by_app, acknowledged.by_parameters) == (by_app, by_parameters)
    assert after_s[0] <= acknowledged.after_s <= after_s[1]
    kinds = {"enable": "B", "m1": "H", "m2": "H", "m3": "H", "m4": "H"}
    by_name = {packet.payload for packet in sent if packet[:2] == (2, 3)}
    assert by_name == {encode_set_by_name(f"motorPowerSet.{name}", kind, 0) for name, kind in kinds.items()}


def test_where_one_packet_in_ten_is_lost_motors_stop_within_half_a_second(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}, radio={"loss": 0.1}) as bench:
        for _ in range(20):
            with contextlib.closing(bench.hardware.link(bench.uri)) as link:
                while not any(bench.motors):
                    drive(link)
                    bench.hardware.pause(0.01)
                began_s = bench.hardware.seconds()
                assert stop_over(link, AppPorts(), bench.hardware).by_parameters
            assert bench.stopped_after(began_s) < 0.5


def test_a_stop_waits_for_no_import_that_only_other_commands_need() -> None:
    body = "import sys, cfid.cli.motors; print({'twisted', 'cflib', 'pandas'} & sys.modules.keys())"
    ended = subprocess.run([sys.executable, "-c", body], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ended.stdout == "set()\n"


# Beside a program that drives


@KINDS
def test_a_program_that_goes_on_cannot_keep_the_motors_on(tmp_path: Path, firmware: str) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": firmware}) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        began_s = bench.hardware.seconds()
        stop = bench.start("motors", "stop")
        assert stop.end() == 0, stop.err
        assert bench.stopped_after(began_s) < 0.1
        assert re.search(r"confirmed in \d+ ms", stop.out)
        assert pilot.end() == 3
        assert "another program" in pilot.err
        bench.hardware.pause(AFTERWARDS_S)
        assert not any(bench.motors)


def test_where_no_second_link_opens_the_whole_one_carries_the_stop(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench, DeviceLock(bench.uri):  # by this process
        link = bench.hardware.link(bench.uri)
        drive(link)
        bench.hardware.pause(0.1)
        assert bench.motors == (0, 20000, 0, 0)
        bench.hardware.links_refused = 1
        assert stop_vehicle(bench.uri, AppPorts(), bench.hardware, say=print).kind == "stock"
        assert not any(bench.motors)


# Recovery


def wait_for(bench: Bench, state: SupervisorState) -> None:
    end_s = bench.hardware.seconds() + 10.0
    while bench.rig.crazyflie.vehicle.supervisor.state is not state:
        assert bench.hardware.seconds() < end_s, bench.rig.crazyflie.vehicle.supervisor.state
        bench.hardware.pause(0.01)
        bench.hardware.attend_vehicle()


def recover(bench: Bench) -> tuple[int, str]:
    pilot = bench.start("motors", "recover")
    return pilot.end(), pilot.err


@pytest.mark.parametrize(("firmware", "platform"), [("app", "cf2"), ("app", "cf21bl"), ("stock", "cf2")])
def test_a_crashed_vehicle_is_recovered_once_it_is_upright(tmp_path: Path, firmware: str, platform: str) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": firmware, "platform": platform}) as bench:
        crashed = bench.start("motors", "set", 30000, "--yes")
        vehicle = bench.rig.crazyflie.vehicle
        crashed.wait_until(lambda: vehicle.supervisor.state is SupervisorState.FLYING, "flying")
        bench.vehicle_suffers(tumble_after_s=0)
        assert crashed.end() == 3
        wait_for(bench, SupervisorState.CRASHED)
        assert "motors recover" in " ".join(crashed.err.split())
        assert recover(bench)[0] == 3  # it still lies on its back
        wait_for(bench, SupervisorState.CRASHED)
        bench.vehicle_suffers()
        bench.hardware.pause(1.0)
        code, err = recover(bench)
        assert code == 0, err
        wait_for(bench, SupervisorState.READY if platform == "cf2" else SupervisorState.PASSED)
        assert not any(bench.motors)
        again = bench.start("motors", "set", 20000, "--for", 0.3, "--yes")
        assert again.end() == 0, again.err


@pytest.mark.parametrize("words", [("motors", "recover"), ("log", "ping"), HOLD])
def test_a_vehicle_that_another_command_drives_is_left_to_it(tmp_path: Path, words: tuple[object, ...]) -> None:
    with bench_in(tmp_path) as bench:
        driving = bench.start("motors", "set", 30000, "--for", 20, "--yes")
        driving.wait_until_motors_run()
        refused = bench.start(*words)
        assert refused.end() == 3
        assert f"process {os.getpid()}" in refused.err
        assert any(bench.motors)
        driving.request_end()
        assert driving.end() == 0
        assert list_runs(bench.folder / "runs") == []


# What only an operating system does: processes with signals and locks


def suspend(process: Process) -> None:
    process.send(signal.SIGSTOP)
    while Path(f"/proc/{process.process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
        time.sleep(0.001)


def test_a_suspended_process_keeps_no_motor_on_and_turns_none_once_it_continues(tmp_path: Path) -> None:
    words = ("--from", 20000, "--to", 30000, "--step", 10000, "--hold", 0.5, "--rest", 0.5, "--yes")
    with served_in(tmp_path) as bench:
        pilot = bench.start("log", "thrust", *words, anew=True)  # the message has the kernel's name of the process
        pilot.wait_until_motors_run(0.0)
        suspend(pilot)
        began_s = time.monotonic()
        stop = bench.start("motors", "stop")
        assert bench.stopped_after(began_s) < 10.0
        stopped_s = bench.history[-1][0]
        assert stop.end() == 0, stop.err
        assert f"kill -CONT {pilot.process.pid}" in stop.err
        pilot.send(signal.SIGCONT)
        assert pilot.end() == 0, pilot.err
        time.sleep(AFTERWARDS_S)
        assert bench.history[-1] == (stopped_s, (0, 0, 0, 0))


def test_a_driven_vehicle_is_found_and_its_process_ended_without_folder_campaign_or_reader(tmp_path: Path) -> None:
    (gone := tmp_path / "gone").mkdir()
    body = f"import os; os.chdir({str(gone)!r}); os.rmdir({str(gone)!r}); from cfid.cli.main import main; main()"
    with served_in(tmp_path) as bench, Path("/dev/full").open("w") as full:
        pilot = bench.start(*HOLD, "--uri", bench.uri.replace("127.0.0.1", "localhost"))
        pilot.wait_until_motors_run()
        rig = tmp_path / RIG_FILE
        rig.write_text(rig.read_text().replace(bench.uri, "udp://127.0.0.1:9"))
        other = bench.start("motors", "stop")
        assert other.end() == 3
        assert f"cfid motors stop --uri {bench.uri}" in " ".join(other.err.split())
        assert any(bench.motors)
        words = [sys.executable, "-c", body, "motors", "stop"]
        ended = subprocess.run(words, env=bench.environment, stdout=full, stderr=full, check=False)
        assert ended.returncode == 0
        assert pilot.end() == 0
        assert not any(bench.motors)


# A process that drives stock motors and holds the only radio, which is a locked file.
DRIVE = """
import fcntl, os, signal, sys, time
from cfid.rig.link import open_link
from cfid.rig.lock import DeviceLock
from cfid.wire.crtp import Packet, encode_set_by_name
uri, radio, heeds = sys.argv[1:]
signal.signal(signal.SIGTERM, signal.SIG_DFL if heeds == "heeds" else signal.SIG_IGN)
handle = os.open(radio, os.O_RDWR | os.O_CREAT)
if heeds == "another user":
    os.setuid(65534)
lock, link = DeviceLock(uri), open_link(uri)
fcntl.flock(handle, fcntl.LOCK_EX)
for name, kind, value in (("m2", "H", 20000), ("enable", "B", 1)):
    link.send(Packet(2, 3, encode_set_by_name(f"motorPowerSet.{name}", kind, value)))
    link.receive(1.0)
print("driving", flush=True)
time.sleep(600)
"""
NO_CFID = DRIVE.replace(
    "time.sleep(600)",
    "for kept in (lock._socket.fileno(), handle): os.set_inheritable(kept, True)\nos.execlp('sleep', 'sleep', '600')",
)


class OneRadio(Real):
    """Hardware with a link that only one process at a time can open."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def link(self, uri: str) -> Link:
        handle = os.open(self._path, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise DeviceError(f"{uri}: [Errno 16] Resource busy.") from None
        finally:
            os.close(handle)
        return open_link(uri)


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServedBench]:
    with served_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        for name in ("CFID_LOCKS", "XDG_CACHE_HOME"):
            monkeypatch.setenv(name, bench.environment[name])
        yield bench


@contextlib.contextmanager
def driving(bench: ServedBench, heeds: str, *, program: str = DRIVE) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-c", program, bench.uri, str(bench.folder / "radio"), heeds]
    with subprocess.Popen(command, env=bench.environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "driving\n"
            while bench.motors != (0, 20000, 0, 0):
                time.sleep(0.001)
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize(("heeds", "ended_by"), [("heeds", signal.SIGTERM), ("ignores", signal.SIGKILL)])
def test_a_suspended_process_gives_its_radio_back_or_is_killed(
    served: ServedBench, heeds: str, ended_by: signal.Signals
) -> None:
    said: list[str] = []
    with driving(served, heeds) as driver:
        driver.send_signal(signal.SIGSTOP)
        while not (holder := find_holder(served.uri)) or not holder.is_suspended:
            time.sleep(0.001)
        stopped = stop_vehicle(served.uri, AppPorts(), OneRadio(served.folder / "radio"), say=said.append)
        assert driver.wait(10) == -ended_by
    assert stopped.kind == "stock"
    assert not any(served.motors)
    assert ["is killed" in text for text in said] == [True] * (ended_by == signal.SIGKILL)


def test_a_radio_of_a_process_that_is_no_cfid_is_not_taken_from_it(served: ServedBench) -> None:
    with driving(served, "heeds", program=NO_CFID) as driver:
        while (holder := find_holder(served.uri)) is None or holder.is_ours:
            time.sleep(0.001)
        with pytest.raises(StopError, match=f"^{MAY_BE_RUNNING}: process {driver.pid}"):
            stop_vehicle(served.uri, AppPorts(), OneRadio(served.folder / "radio"), say=print)
        assert driver.poll() is None
        assert served.motors == (0, 20000, 0, 0)  # the motors do still run


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may act for other users")
def test_motors_that_another_users_process_drives_are_stopped_beside_it(served: ServedBench) -> None:
    with driving(served, "another user") as driver:
        stop = served.start("motors", "stop")
        assert stop.end() == 0, stop.err
        assert not any(served.motors)
        assert f"process {driver.pid}" in stop.err
        assert driver.poll() is None
