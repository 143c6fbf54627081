"""Every way to end a command that spins motors stops them, over real wires, with the app and with stock firmware."""

import contextlib
import os
import pty
import re
import resource
import signal
import statistics
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest

from cfid.rig.loop import signal_name
from cfid.rig.motors import MAY_BE_RUNNING
from cfid.sim.supervisor import SupervisorState
from tests.flying_in_a_folder import Bench, Pilot, bench_in

STOPPED_WITHIN_S = 0.7
STOPPED_BY_ANOTHER_WITHIN_S = 1.0  # from the moment `motors stop` is typed
TIMES = 20
AFTERWARDS_S = 0.8  # longer than the app waits for a keep-alive, and than a setpoint stays valid
LOCKS_AFTER_S = 2.6  # longer than it takes until an old setpoint locks a vehicle
HOLD = ("motors", "set", 30000, "--motor", 1, "--motor", 3, "--yes")
ALL_MOTORS = ("--motor", 1, "--motor", 2, "--motor", 3, "--motor", 4)
STAIRS = (
    "log",
    "thrust",
    *ALL_MOTORS,
    "--from",
    30000,
    "--to",
    30000,
    "--hold",
    20,
    "--rest",
    0.3,
    "--yes",
)
WIND = ("log", "wind", "--wind", 0, "--commands", 30000, "--hold", 20, "--rest", 0.3, "--yes")
PREFLIGHT = ("rig", "preflight", "--for", 0.5, "--yes")
BUG = """
import cfid.rig.recorder as recorder
take, calls = recorder.Recorder._write, []
def broken(self, instrument):
    calls.append(1)
    if len(calls) > 40:
        raise RuntimeError("a bug")
    take(self, instrument)
recorder.Recorder._write = broken
"""
BUG_IN_PREFLIGHT = """
from cfid.rig.sampling import Memory
append, turned = Memory.append, []
def broken(self, device, columns):
    if turned or (device == "commands" and max(map(max, columns[1:])) > 0):
        turned.append(1)
    if len(turned) > 20:
        raise RuntimeError("a bug")
    append(self, device, columns)
Memory.append = broken
"""
BUGS = {"a bug": BUG, "a bug in preflight": BUG_IN_PREFLIGHT}

Act = Callable[[Bench, Pilot, "Keyboard | None"], None]


class Keyboard:
    """The source of a pilot's standard input: a pipe, or a separate terminal."""

    def __init__(self, *, terminal: bool) -> None:
        self._terminal = terminal
        self.end, self.pilots_end = pty.openpty() if terminal else reversed(os.pipe())

    @property
    def is_heard(self) -> bool:
        """Whether all typed input is received from now on; a terminal discards some when it switches to single keys."""
        return not (self._terminal and termios.tcgetattr(self.end)[3] & termios.ICANON)

    def type(self, typed: bytes) -> None:
        os.write(self.end, typed)

    def hang_up(self) -> None:
        if self.end >= 0:
            os.close(self.end)
            self.end = -1


class Way(NamedTuple):
    """A way to end a command: its words, what happens to it while motors run, its exit code and its message."""

    words: tuple[object, ...]
    act: Act
    code: int
    told: str = ""
    options: Mapping[str, Any] = MappingProxyType({})
    typed: bytes = b""  # at the beginning
    terminal: bool = False


def signals(*numbers: int) -> Act:
    return lambda bench, pilot, keyboard: pilot.send(*numbers)


def vehicle(**faults: Any) -> Act:
    return lambda bench, pilot, keyboard: bench.vehicle_suffers(**faults)


def loadcell(**faults: Any) -> Act:
    return lambda bench, pilot, keyboard: bench.loadcell_suffers(**faults)


def overload(bench: Bench, pilot: Pilot, keyboard: Keyboard | None) -> None:
    bench.in_loop(bench.rig.loadcell.box.load_cell.overload)


def wait(bench: Bench, pilot: Pilot, keyboard: Keyboard | None) -> None:
    """Do nothing, since the command ends by itself."""


def typing(typed: bytes) -> Act:
    def act(bench: Bench, pilot: Pilot, keyboard: Keyboard | None) -> None:
        assert keyboard is not None
        keyboard.type(typed)

    return act


def hang_up(bench: Bench, pilot: Pilot, keyboard: Keyboard | None) -> None:
    assert keyboard is not None
    keyboard.hang_up()


def little_room() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))


# All signals that end or suspend a program by default, as listed in signal(7).
OTHER_SIGNALS = (
    *(signal.SIGQUIT, signal.SIGTRAP, signal.SIGABRT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGSTKFLT),
    *(signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU, signal.SIGXCPU, signal.SIGVTALRM, signal.SIGPROF, signal.SIGIO),
    *(signal.SIGPWR, signal.SIGSYS, signal.SIGRTMIN, signal.SIGRTMIN + 1, signal.SIGRTMAX),
)

WAYS: dict[str, Way] = {
    "time over": Way((*HOLD, "--for", 0.5), wait, 0),
    "a bug": Way(HOLD, wait, 1, "RuntimeError: a bug", {"anew": True}),
    "Ctrl-C": Way(HOLD, signals(signal.SIGINT), 0),
    "Ctrl-C in wind": Way(WIND, signals(signal.SIGINT), 0),
    "Ctrl-C twice": Way(HOLD, signals(signal.SIGINT, signal.SIGINT), 0),
    "SIGTERM": Way(HOLD, signals(signal.SIGTERM), 0),
    "SIGHUP": Way(HOLD, signals(signal.SIGHUP), 0),
    "SIGKILL": Way(HOLD, signals(signal.SIGKILL), -9),
    "link silent": Way(HOLD, vehicle(silent_after_s=0), 3),
    "link closed": Way(HOLD, vehicle(closed_after_s=0), 3),
    "battery low": Way(HOLD, vehicle(low_battery_after_s=0), 3, "the battery is at 2.90 V"),
    "load cell lost": Way(STAIRS, loadcell(silent_after_s=0), 3, "sent nothing more for"),
    "overload": Way(STAIRS, overload, 3, "saturation"),
    "disk full": Way(STAIRS, wait, 4, "File too large", {"preexec_fn": little_room}),
    "nonsense typed": Way(
        ("motors", "--yes"), typing(b"1 99999\n"), 2, "command 99999: commands go from 0 to 65535", typed=b"1 3 30000\n"
    ),
    "script over": Way(("motors", "--yes"), hang_up, 0, typed=b"1 3 30000\n"),
    "Ctrl-D": Way(("motors", "--yes"), typing(b"\x04"), 0, typed=b"1 3 30000\n", terminal=True),
    "Ctrl-D in a line": Way(("motors", "--yes"), typing(b"2 4\x04"), 0, typed=b"1 3 30000\n", terminal=True),
    "terminal hung up": Way(("motors", "--yes"), hang_up, 0, typed=b"1 3 30000\n", terminal=True),
    "Ctrl-C in preflight": Way(PREFLIGHT, signals(signal.SIGINT), 130),
    "SIGTERM in preflight": Way(PREFLIGHT, signals(signal.SIGTERM), 130),
    "SIGHUP in preflight": Way(PREFLIGHT, signals(signal.SIGHUP), 130),
    "SIGKILL in preflight": Way(PREFLIGHT, signals(signal.SIGKILL), -9),
    "link silent in preflight": Way(PREFLIGHT, vehicle(silent_after_s=0), 3),
    "link closed in preflight": Way(PREFLIGHT, vehicle(closed_after_s=0), 3),
    "battery low in preflight": Way(PREFLIGHT, vehicle(low_battery_after_s=0), 3, "not ready: signals"),
    "load cell lost in preflight": Way(PREFLIGHT, loadcell(silent_after_s=0), 3, "not ready: signals"),
    "a bug in preflight": Way(PREFLIGHT, wait, 1, "RuntimeError: a bug", {"anew": True}),
    "overload in preflight": Way(PREFLIGHT, overload, 3, "not ready: signals"),
    **{signal_name(number): Way(HOLD, signals(number), 0) for number in OTHER_SIGNALS},
}
OWN_DELAY_S = {"battery low": 0.5, "load cell lost": 0.5}  # until the fault counts as one
OWN_DELAY_S |= {f"{name} in preflight": delay_s for name, delay_s in OWN_DELAY_S.items()}
NOT_WITH_STOCK = {"SIGKILL", "link silent", "link closed"}  # the documented exceptions of stock firmware
NOT_WITH_STOCK |= {f"{name} in preflight" for name in NOT_WITH_STOCK}
VEHICLES = {
    "app": {"firmware": "app"},
    "stock": {"firmware": "stock"},
    "app, Brushless": {"firmware": "app", "platform": "cf21bl"},
    "stock, Brushless": {"firmware": "stock", "platform": "cf21bl"},
}
EACH = [(way, kind) for way in WAYS for kind in VEHICLES if not ("stock" in kind and way in NOT_WITH_STOCK)]
# By default, each signal is tried with the app, and the ways that differ between vehicles with every vehicle.
OFTEN = [
    (way, kind)
    for way, kind in EACH
    if kind == "app" or way in ("time over", "SIGTERM", "SIGKILL", "disk full", "SIGTERM in preflight")
]
GONE_WRONG = {
    SupervisorState.LEVEL_OUT,
    SupervisorState.FREE_FALL,
    SupervisorState.LOCKED,
}  # the motors stopped, and the vehicle cannot be used further


class Stopped(NamedTuple):
    """The time in s until the motors stopped, and the state in which the vehicle was left."""

    after_s: float
    state: SupervisorState


def stop_once(folder: Path, name: str, kind: str, *, afterwards_s: float = AFTERWARDS_S) -> Stopped:
    """Let motors run, end the command in the named way, and return the result."""
    way = WAYS[name]
    with bench_in(folder, crazyflie=VEHICLES[kind]) as bench, contextlib.ExitStack() as opened:
        if name in BUGS:
            (folder / "sitecustomize.py").write_text(BUGS[name])
            bench.environment["PYTHONPATH"] = str(folder)
        options, keyboard = dict(way.options), None
        if way.typed:
            keyboard = Keyboard(terminal=way.terminal)
            opened.callback(keyboard.hang_up)
            options["stdin"] = keyboard.pilots_end
        pilot = bench.start(*way.words, **options)
        if keyboard is not None:
            os.close(keyboard.pilots_end)
            bench.wait_until(lambda: keyboard.is_heard or pilot.process.poll() is not None, pilot)
            keyboard.type(way.typed)
        pilot.wait_until_motors_run()
        began_s = time.monotonic()
        way.act(bench, pilot, keyboard)
        if way.act is wait:
            bench.wait_until(lambda: pilot.process.poll() is not None or not any(bench.motors), pilot)
            began_s = time.monotonic()
        stopped_s = bench.stopped_after(began_s + OWN_DELAY_S.get(name, 0.0))
        last_s = bench.history[-1][0]
        code = pilot.end()
        # The second Ctrl-C may arrive when everything is done and the interpreter exits.
        codes = (way.code, 130, -signal.SIGINT) if name == "Ctrl-C twice" else (way.code,)
        assert code in codes, f"{pilot.out}{pilot.err}"
        assert way.told in pilot.err
        assert MAY_BE_RUNNING not in pilot.err
        assert ("Traceback" in pilot.err) == (name in BUGS), pilot.err
        time.sleep(afterwards_s)
        assert not any(bench.motors), "the motors came on again"
        assert bench.history[-1][0] == last_s
        return Stopped(stopped_s, bench.rig.crazyflie.vehicle.supervisor.state)


def stop_from_beside(folder: Path, kind: str) -> float:
    """Suspend the command that drives motors, stop the motors from another, and return how long that took."""
    with bench_in(folder, crazyflie={"firmware": kind}) as bench:
        pilot = bench.start(*HOLD, anew=True)  # the message has the kernel's name of the process
        pilot.wait_until_motors_run()
        began_s = time.monotonic()
        suspend(pilot)
        other = bench.start("motors", "stop")
        bench.wait_until(lambda: not any(bench.motors), other)
        stopped_s = bench.history[-1][0] - began_s
        assert other.end() == 0, other.err
        assert re.fullmatch(rf"{bench.uri}: motors stopped, confirmed in \d+ ms\.\n", other.out)
        assert f"process {pilot.process.pid} (cfid motors set 30000" in other.err
        assert f"kill -CONT {pilot.process.pid}" in other.err
        pilot.send(signal.SIGCONT)
        assert pilot.end() == 0, pilot.err
        time.sleep(AFTERWARDS_S)
        assert not any(bench.motors), "the motors came on again"
        assert bench.history[-1][0] - began_s == stopped_s
        return stopped_s


def suspend(pilot: Pilot) -> None:
    pilot.send(signal.SIGSTOP)
    end_s = time.monotonic() + 10
    while Path(f"/proc/{pilot.process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
        assert time.monotonic() < end_s
        time.sleep(0.001)


@pytest.mark.parametrize(("way", "kind"), OFTEN)
def test_the_motors_stop_whatever_ends_the_command(tmp_path: Path, way: str, kind: str) -> None:
    stopped = stop_once(tmp_path, way, kind)

    assert stopped.after_s < STOPPED_WITHIN_S
    assert stopped.state not in GONE_WRONG


@pytest.mark.slow
@pytest.mark.parametrize(("way", "kind"), EACH)
def test_the_motors_stop_twenty_times_out_of_twenty(tmp_path: Path, way: str, kind: str) -> None:
    stops = []
    for time_ in range(TIMES):
        folder = tmp_path / str(time_)
        folder.mkdir()
        stops.append(stop_once(folder, way, kind, afterwards_s=LOCKS_AFTER_S))
    stopped_s = [stop.after_s for stop in stops]
    left = ", ".join(sorted({stop.state.value for stop in stops}))
    median_s, most_s = statistics.median(stopped_s), max(stopped_s)
    print(f"\n{way}, {kind}: off after {median_s:.3f} s, at most {most_s:.3f} s; left {left}")
    assert max(stopped_s) < STOPPED_WITHIN_S
    assert not {stop.state for stop in stops} & GONE_WRONG


@pytest.mark.parametrize("kind", ["app", "stock"])
def test_motors_stop_needs_no_help_from_the_process_that_drives_them(tmp_path: Path, kind: str) -> None:
    stop_from_beside(tmp_path, kind)


def test_motors_stop_needs_neither_a_current_folder_nor_a_campaign(tmp_path: Path) -> None:
    (gone := tmp_path / "gone").mkdir()
    stop = f"import os; os.chdir({str(gone)!r}); os.rmdir({str(gone)!r}); from cfid.cli.main import main; main()"
    with bench_in(tmp_path) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        words = [sys.executable, "-c", stop, "motors", "stop"]
        ended = subprocess.run(words, env=bench.environment, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stderr
        assert not any(bench.motors)
        assert f"{bench.uri}: motors stopped" in ended.stdout
        assert "the current folder was removed or moved: change to one that exists." in ended.stderr
        assert pilot.end() != 1


def test_motors_stop_names_a_vehicle_that_another_command_holds_and_rig_toml_does_not_name(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        rig = tmp_path / "rig.toml"
        rig.write_text(rig.read_text().replace(bench.uri, "udp://127.0.0.1:9"))
        other = bench.start("motors", "stop")
        assert other.end() == 3
        assert f"was not stopped: cfid motors stop --uri {bench.uri}" in " ".join(other.err.split())
        last = bench.start("motors", "stop", "--uri", bench.uri)
        assert last.end() == 0
        assert not any(bench.motors)
        assert pilot.end() != 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux that takes nothing")
@pytest.mark.parametrize("full", [("stderr",), ("stdout", "stderr")])
def test_motors_stop_needs_nobody_who_reads_what_it_prints(tmp_path: Path, full: tuple[str, ...]) -> None:
    with bench_in(tmp_path) as bench, Path("/dev/full").open("w") as nowhere:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        rig = tmp_path / "rig.toml"
        rig.write_text(f"{rig.read_text()}\nx = [")  # a note about this is printed before the stop
        other = bench.start("motors", "stop", "--uri", bench.uri, **dict.fromkeys(full, nowhere))
        bench.wait_until(lambda: not any(bench.motors), other)
        assert other.end() == 0
        assert pilot.end() != 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["app", "stock"])
def test_motors_stop_needs_no_help_twenty_times_out_of_twenty(tmp_path: Path, kind: str) -> None:
    stopped_s = []
    for time_ in range(TIMES):
        folder = tmp_path / str(time_)
        folder.mkdir()
        stopped_s.append(stop_from_beside(folder, kind))
    print(f"\nmotors stop, {kind}: off after {statistics.median(stopped_s):.3f} s, at most {max(stopped_s):.3f} s")
    assert max(stopped_s) < STOPPED_BY_ANOTHER_WITHIN_S


@pytest.mark.parametrize("kind", ["app", "stock"])
def test_a_staircase_that_goes_on_after_it_was_stopped_from_beside_turns_no_motor(tmp_path: Path, kind: str) -> None:
    words = (
        "log",
        "thrust",
        "--from",
        20000,
        "--to",
        30000,
        "--step",
        5000,
        "--hold",
        1,
        "--rest",
        0.5,
        "--yes",
    )
    with bench_in(tmp_path, crazyflie={"firmware": kind}) as bench:
        pilot = bench.start(*words)
        pilot.wait_until_motors_run()
        suspend(pilot)
        other = bench.start("motors", "stop")
        assert other.end() == 0, other.err
        time.sleep(2.0)  # the next step is due
        stopped_s = bench.history[-1][0]
        pilot.send(signal.SIGCONT)
        assert pilot.end() == 0, pilot.err
        time.sleep(AFTERWARDS_S)
        assert not any(bench.motors)
        assert bench.history[-1][0] == stopped_s


def test_a_command_that_was_suspended_names_itself_and_not_the_vehicle(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        suspend(pilot)
        time.sleep(1.2)
        assert not any(bench.motors)
        pilot.send(signal.SIGCONT)
        assert pilot.end() == 3
        assert re.search(r"no keep-alive, since cfid itself was suspended or kept waiting for \d+\.\d s", pilot.err)


@pytest.mark.parametrize(
    ("kind", "told"), [("app", "another program stopped the motors"), ("stock", "another program stopped them")]
)
def test_a_process_that_heeds_no_signal_cannot_keep_the_motors_on(tmp_path: Path, kind: str, told: str) -> None:
    def heed_nothing() -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)

    with bench_in(tmp_path, crazyflie={"firmware": kind}) as bench:
        pilot = bench.start(*HOLD, preexec_fn=heed_nothing)
        pilot.wait_until_motors_run()
        other = bench.start("motors", "stop")
        assert other.end() == 0, other.err
        assert "motors stopped, confirmed in" in other.out
        assert pilot.end() == 3
        assert told in pilot.err
        time.sleep(AFTERWARDS_S)
        assert not any(bench.motors)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may act for other users")
def test_motors_that_another_users_process_drives_are_stopped_beside_it(tmp_path: Path) -> None:
    body = """
import os, socket, sys, time
from cfid.rig.lock import DeviceLock
from cfid.rig.link import Link
from cfid.wire.crtp import Packet, encode_set_by_name
os.setuid(65534)
lock, link = DeviceLock.take(sys.argv[1]), Link(sys.argv[1])
for name, kind, value in (("m2", "H", 20000), ("enable", "B", 1)):
    link.send(Packet(2, 3, encode_set_by_name(f"motorPowerSet.{name}", kind, value)))
    link.receive(1.0)
time.sleep(600)
"""
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        command = [sys.executable, "-c", body, bench.uri]
        with subprocess.Popen(command, env=bench.environment) as driver:
            try:
                other = None
                end_s = time.monotonic() + 30
                while bench.motors != (0, 20000, 0, 0):
                    assert time.monotonic() < end_s
                    time.sleep(0.01)
                other = bench.start("motors", "stop")
                assert other.end() == 0, other.err
                assert not any(bench.motors)
                assert re.search(rf"process {driver.pid} \(.*\) of \w+ still drives the vehicle", other.err)
                assert driver.poll() is None
            finally:
                driver.kill()


@pytest.mark.parametrize("fault", [{"silent_after_s": 0}, {"closed_after_s": 0}])
def test_stock_firmware_without_a_link_is_the_exception_and_the_operator_is_told(
    tmp_path: Path, fault: dict[str, float]
) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        bench.vehicle_suffers(**fault)
        code = pilot.end()

        assert code == 3
        assert f"{MAY_BE_RUNNING}: stock firmware keeps motors running without a link" in pilot.err
        assert bench.motors == (30000, 0, 30000, 0)  # the motors do still run


@pytest.mark.parametrize("kind", ["app", "stock"])
@pytest.mark.parametrize(
    "before_s", [0.06, 0.12, *(pytest.param(before_s, marks=pytest.mark.slow) for before_s in (0.02, 0.2))]
)
def test_a_signal_shortly_before_a_step_leaves_no_motor_on(tmp_path: Path, kind: str, before_s: float) -> None:
    """Actions that the procedure was about to take when the end was requested must not come after the stop."""
    radio = {"latency_s": 0.0285, "jitter_s": 0.008}
    words = (
        "log",
        "thrust",
        "--from",
        20000,
        "--to",
        30000,
        "--step",
        10000,
        "--hold",
        0.8,
        "--rest",
        0.6,
        "--yes",
    )
    with bench_in(tmp_path, crazyflie={"firmware": kind}, radio=radio) as bench:
        pilot = bench.start(*words)
        pilot.wait_until_motors_run(0.0)
        step_s = bench.history[-1][0] + 0.8 + 0.6  # the approximate time at which the second step is sent
        time.sleep(max(step_s - before_s - time.monotonic(), 0.0))
        pilot.send(signal.SIGINT)
        code = pilot.end()
        time.sleep(AFTERWARDS_S)
        assert code == 0, pilot.err
        assert not any(bench.motors), "the motors came on again"


def test_a_vehicle_whose_log_was_reset_by_another_program_is_not_left_unwatched(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        began_s = time.monotonic()
        bench.in_loop(lambda: bench.rig.crazyflie.vehicle.receive(b"\x5d\x05", time.monotonic()))
        assert bench.stopped_after(began_s + 0.5) < STOPPED_WITHIN_S
        assert pilot.end() == 3
        assert "its battery is not monitored" in pilot.err
