"""A stop while another process hangs: over a separate link, or over a link that has to be taken from that process."""

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.errors import DeviceError, StopError
from cfid.rig.emergency import stop_vehicle
from cfid.rig.link import Link, QueuedPacket
from cfid.rig.lock import DeviceLock, find_holder
from cfid.rig.motors import MAY_BE_RUNNING
from cfid.rig.stop_packets import stop_over
from cfid.wire.app import AppPorts, AppState, Flags, PingChannel, encode_state
from cfid.wire.crtp import Packet, encode_set_by_name
from tests.flying_in_a_folder import Bench, bench_in

# A process that drives stock motors and holds the only radio, which is a locked file.
DRIVE = """
import fcntl, os, signal, sys, time
from cfid.rig.link import Link
from cfid.rig.lock import DeviceLock
from cfid.wire.crtp import Packet, encode_set_by_name
uri, radio, heeds = sys.argv[1:]
signal.signal(signal.SIGTERM, signal.SIG_DFL if heeds == "heeds" else signal.SIG_IGN)
lock, link = DeviceLock.take(uri), Link(uri)
handle = os.open(radio, os.O_RDWR | os.O_CREAT)
fcntl.flock(handle, fcntl.LOCK_EX)
for name, kind, value in (("m2", "H", 20000), ("enable", "B", 1)):
    link.send(Packet(2, 3, encode_set_by_name(f"motorPowerSet.{name}", kind, value)))
    link.receive(1.0)
print("driving", flush=True)
time.sleep(600)
"""


class Radio:
    """A link that only one process at a time can open."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def open(self, uri: str) -> Link:
        handle = os.open(self.path, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise DeviceError(f"{uri}: [Errno 16] Resource busy.") from None
        finally:
            os.close(handle)
        return Link(uri)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        for name in ("CFID_LOCKS", "XDG_CACHE_HOME"):
            monkeypatch.setenv(name, bench.environment[name])
        yield bench


@pytest.fixture
def radio(tmp_path: Path) -> Radio:
    return Radio(tmp_path / "radio")


@contextlib.contextmanager
def driving(bench: Bench, radio: Radio, heeds: str, *, program: str = DRIVE) -> Iterator["subprocess.Popen[str]"]:
    command = [sys.executable, "-c", program, bench.uri, str(radio.path), heeds]
    with subprocess.Popen(command, env=bench.environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "driving\n"
            end_s = time.monotonic() + 10
            while bench.motors != (0, 20000, 0, 0):
                assert time.monotonic() < end_s
                time.sleep(0.005)
            yield process
        finally:
            process.kill()


def suspend(process: "subprocess.Popen[str]", uri: str) -> None:
    process.send_signal(signal.SIGSTOP)
    end_s = time.monotonic() + 10
    while not (holder := find_holder(uri)) or not holder.is_suspended:
        assert time.monotonic() < end_s


def test_a_suspended_process_goes_on_and_gives_its_radio_back(bench: Bench, radio: Radio) -> None:
    said: list[str] = []
    with driving(bench, radio, "heeds") as driver:
        suspend(driver, bench.uri)
        stopped = stop_vehicle(bench.uri, AppPorts(), say=said.append, opened=radio.open)
        assert driver.wait(10) == -signal.SIGTERM
    assert stopped.kind == "stock"
    assert not any(bench.motors)
    assert said == []


def test_a_process_that_does_not_give_its_radio_back_is_killed(bench: Bench, radio: Radio) -> None:
    said: list[str] = []
    with driving(bench, radio, "ignores") as driver:
        suspend(driver, bench.uri)
        stop_vehicle(bench.uri, AppPorts(), say=said.append, opened=radio.open)
        assert driver.wait(10) == -signal.SIGKILL
        assert said == [f"process {driver.pid} (python) does not end and keeps the link to itself: it is killed."]
    assert not any(bench.motors)


def test_where_the_link_can_be_shared_nobody_is_killed_and_what_remains_is_told(bench: Bench, radio: Radio) -> None:
    said: list[str] = []
    with driving(bench, radio, "ignores") as driver:
        began_s = time.monotonic()
        stop_vehicle(bench.uri, AppPorts(), say=said.append)
        assert bench.stopped_after(began_s) < 0.2  # less than the driver is given to end
        assert driver.poll() is None
        assert said == [
            f"process {driver.pid} (python) still holds the vehicle: it may be writing its run. One that hangs may "
            f"start the motors again. If it has not ended in 10 s, end it: kill -KILL {driver.pid}"
        ]
    assert not any(bench.motors)


def test_a_radio_of_a_process_that_is_no_cfid_is_not_taken_from_it(bench: Bench, radio: Radio) -> None:
    program = DRIVE.replace(
        "time.sleep(600)",
        "for kept in (lock._bound.fileno(), handle): os.set_inheritable(kept, True)\nos.execlp('sleep', 'sleep', '9')",
    )
    with driving(bench, radio, "heeds", program=program) as driver:
        with pytest.raises(StopError, match=f"^{MAY_BE_RUNNING}: process {driver.pid} .* this user cannot end it"):
            stop_vehicle(bench.uri, AppPorts(), say=print, opened=radio.open)
        assert driver.poll() is None
        assert bench.motors == (0, 20000, 0, 0)  # the motors do still run


def test_where_no_thin_link_opens_the_whole_one_carries_the_stop(bench: Bench, radio: Radio) -> None:
    def opened(uri: str) -> Link:
        raise DeviceError(f"{uri}: no.")

    with driving(bench, radio, "heeds"):
        pass  # killed: motors of stock firmware keep running
    assert bench.motors == (0, 20000, 0, 0)
    assert stop_vehicle(bench.uri, AppPorts(), say=print, opened=opened).kind == "stock"
    assert not any(bench.motors)


def test_a_lock_without_a_driver_is_no_obstacle(bench: Bench) -> None:
    with DeviceLock.take(bench.uri):  # of this very process
        assert stop_vehicle(bench.uri, AppPorts(), say=print).kind == "stock"


def test_where_one_packet_in_ten_is_lost_motors_stop_within_half_a_second(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}, radio={"loss": 0.1}) as bench:
        for _ in range(20):
            with contextlib.closing(Link(bench.uri)) as link:
                while not any(bench.motors):
                    for name, kind, value in (("m2", "H", 20000), ("enable", "B", 1)):
                        link.send(Packet(2, 3, encode_set_by_name(f"motorPowerSet.{name}", kind, value)))
                    time.sleep(0.01)
            began_s = time.monotonic()
            with contextlib.closing(Link(bench.uri)) as link:
                assert stop_over(link, AppPorts()).by_parameters
            assert bench.stopped_after(began_s) < 0.5


# The packets


class Answering(Link):
    """A link to a vehicle whose answers to packets can be lost, wrong or late."""

    def __init__(self, *, ignores: int = 0, error: int = 0, late: bool = False, commands: int = 0) -> None:
        self.sent: list[Packet] = []
        self._ignores, self._error, self._commands = ignores, error, commands
        self._late = 1 if late else 0
        self._answers: list[Packet] = []

    def send(self, packet: Packet) -> QueuedPacket:
        self.sent.append(packet)
        if self._ignores:
            self._ignores -= 1
        elif packet.port == 2:
            begin = packet.payload[: packet.payload.index(b"\0", 16) + 1]  # ends after the parameter's own name
            self._answers.append(Packet(2, 3, begin + bytes([self._error])))
        elif packet[:2] == (12, PingChannel.STOP):
            number = int.from_bytes(packet.payload, "little")
            state = AppState(number - self._late, Flags(0), (self._commands, 0, 0, 0), 0)
            self._answers.append(Packet(12, PingChannel.STOP, encode_state(state)))
        return QueuedPacket(packet)

    def receive(self, within_s: float) -> Packet | None:
        if not self._answers:
            time.sleep(within_s)
            return None
        return self._answers.pop(0)

    def close(self) -> None:
        """Nothing is open."""


def test_a_stop_is_acknowledged_by_app_and_parameters() -> None:
    link = Answering()
    acknowledged = stop_over(link, AppPorts())
    assert (acknowledged.by_app, acknowledged.by_parameters) == (True, True)
    kinds = {"enable": "B", "m1": "H", "m2": "H", "m3": "H", "m4": "H"}
    by_name = [packet.payload for packet in link.sent if packet[:2] == (2, 3)]
    assert by_name == [encode_set_by_name(f"motorPowerSet.{name}", kind, 0) for name, kind in kinds.items()]


def test_what_was_lost_is_sent_again_until_it_is_acknowledged() -> None:
    """The ninth packet is of the second turn, after which the stop of the third is answered."""
    acknowledged = stop_over(Answering(ignores=9), AppPorts())
    assert (acknowledged.by_app, acknowledged.by_parameters) == (True, True)
    assert 0.06 < acknowledged.after_s < 0.15


def test_firmware_without_the_parameters_has_nothing_to_clear() -> None:
    assert stop_over(Answering(error=2), AppPorts()).by_parameters
    assert not stop_over(Answering(error=22), AppPorts()).by_parameters  # of another type: not surely cleared


def test_an_app_that_goes_on_driving_or_answers_another_stop_has_acknowledged_nothing() -> None:
    assert not stop_over(Answering(commands=1), AppPorts()).by_app
    assert not stop_over(Answering(late=True), AppPorts()).by_app
