"""Every way out of a command that spins motors stops them, over real wires, with the app and with stock firmware."""

import resource
import signal
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest

from cfid.rig.motors import MAY_BE_RUNNING
from tests.cli.flying_in_a_folder import Bench, Pilot, bench_in

STOPPED_WITHIN_S = 0.7
TIMES = 20
AFTERWARDS_S = 0.8  # longer than the app waits for a keep-alive
HOLD = ("motors", "set", 30000, "--motor", 1, "--motor", 3, "--yes")
STAIRS = ("log", "thrust", "--from", 30000, "--to", 30000, "--hold", 20, "--rest", 0.3, "--yes")
WIND = ("log", "wind", "--wind", 0, "--commands", 30000, "--hold", 20, "--rest", 0.3, "--yes")
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

Act = Callable[[Bench, Pilot], None]


class Way(NamedTuple):
    """A way out: the command, what is done to it while motors run, exit code, and what it says."""

    words: tuple[object, ...]
    act: Act
    code: int
    told: str = ""
    options: Mapping[str, Any] = MappingProxyType({})


def signals(*numbers: signal.Signals) -> Act:
    return lambda bench, pilot: pilot.send(*numbers)


def vehicle(**faults: Any) -> Act:
    return lambda bench, pilot: bench.vehicle_suffers(**faults)


def loadcell(**faults: Any) -> Act:
    return lambda bench, pilot: bench.loadcell_suffers(**faults)


def overload(bench: Bench, pilot: Pilot) -> None:
    bench.in_loop(bench.rig.loadcell.box.load_cell.overload)


def wait(bench: Bench, pilot: Pilot) -> None:
    """Do nothing: it ends by itself."""


def type_nonsense(bench: Bench, pilot: Pilot) -> None:
    assert pilot.process.stdin is not None
    pilot.process.stdin.write(b"1 99999\n")
    pilot.process.stdin.flush()


def little_room() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))


WAYS: dict[str, Way] = {
    "time over": Way((*HOLD, "--for", 0.5), wait, 0),
    "a bug": Way(HOLD, wait, 1, "RuntimeError: a bug"),
    "Ctrl-C": Way(HOLD, signals(signal.SIGINT), 0),
    "Ctrl-C in wind": Way(WIND, signals(signal.SIGINT), 0),
    "Ctrl-C twice": Way(HOLD, signals(signal.SIGINT, signal.SIGINT), 0),
    "SIGTERM": Way(HOLD, signals(signal.SIGTERM), 0),
    "SIGHUP": Way(HOLD, signals(signal.SIGHUP), 0),
    "SIGKILL": Way(HOLD, signals(signal.SIGKILL), -9),
    "link silent": Way(HOLD, vehicle(silent_after_s=0), 3),
    "link closed": Way(HOLD, vehicle(closed_after_s=0), 3),
    "battery low": Way(HOLD, vehicle(low_battery_after_s=0), 3, "the battery is at 2.90 V"),
    "load cell lost": Way(STAIRS, loadcell(silent_after_s=0), 3, "sent no more for"),
    "overload": Way(STAIRS, overload, 3, "saturation"),
    "disk full": Way(STAIRS, wait, 4, "File too large", {"preexec_fn": little_room}),
    "nonsense typed": Way(("motors", "--yes"), type_nonsense, 2, "command 99999: commands go from 0 to 65535"),
}
OWN_DELAY_S = {"battery low": 0.5, "load cell lost": 0.5}  # until it counts as one
NOT_WITH_STOCK = {"SIGKILL", "link silent", "link closed"}  # its documented exceptions
BOTH = [(way, kind) for way in WAYS for kind in ("app", "stock") if not (kind == "stock" and way in NOT_WITH_STOCK)]


def stop_once(folder: Path, name: str, kind: str) -> float:
    """Let motors run, take a way out, and return after how many seconds they stood."""
    way = WAYS[name]
    options = dict(way.options)
    with bench_in(folder, crazyflie={"firmware": kind}) as bench:
        if name == "a bug":
            (folder / "sitecustomize.py").write_text(BUG)
            bench.environment["PYTHONPATH"] = str(folder)
        if name == "nonsense typed":
            options["stdin"] = -1
        pilot = bench.start(*way.words, **options)
        if name == "nonsense typed":
            assert pilot.process.stdin is not None
            pilot.process.stdin.write(b"1 3 30000\n")
            pilot.process.stdin.flush()
        pilot.wait_until_motors_run()
        began_s = time.monotonic()
        way.act(bench, pilot)
        if way.act is wait:
            bench.wait_until(lambda: pilot.process.poll() is not None or not any(bench.motors), pilot)
            began_s = time.monotonic()
        stopped_s = bench.stopped_after(began_s + OWN_DELAY_S.get(name, 0.0))
        code = pilot.end()
        # The second Ctrl-C may come when all is done and the interpreter leaves.
        codes = (way.code, 130, -signal.SIGINT) if name == "Ctrl-C twice" else (way.code,)
        assert code in codes, f"{pilot.out}{pilot.err}"
        assert way.told in pilot.err
        assert MAY_BE_RUNNING not in pilot.err
        assert ("Traceback" in pilot.err) == (name == "a bug")
        time.sleep(AFTERWARDS_S)
        assert not any(bench.motors), "the motors came on again"
        assert bench.history[-1][0] <= began_s + OWN_DELAY_S.get(name, 0.0) + stopped_s
        return stopped_s


@pytest.mark.parametrize(("way", "kind"), BOTH)
def test_the_motors_stop_whatever_ends_the_command(tmp_path: Path, way: str, kind: str) -> None:
    assert stop_once(tmp_path, way, kind) < STOPPED_WITHIN_S


@pytest.mark.slow
@pytest.mark.parametrize(("way", "kind"), BOTH)
def test_the_motors_stop_twenty_times_out_of_twenty(tmp_path: Path, way: str, kind: str) -> None:
    stopped_s = []
    for time_ in range(TIMES):
        folder = tmp_path / str(time_)
        folder.mkdir()
        stopped_s.append(stop_once(folder, way, kind))
    print(f"\n{way}, {kind}: off after {statistics.median(stopped_s):.3f} s, at most {max(stopped_s):.3f} s")
    assert max(stopped_s) < STOPPED_WITHIN_S


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
        assert f"{MAY_BE_RUNNING}: stock firmware goes on without a link" in pilot.err
        assert bench.motors == (30000, 0, 30000, 0)  # and it is true


@pytest.mark.parametrize("kind", ["app", "stock", "old"])
@pytest.mark.parametrize("before_s", [0.02, 0.06, 0.12, 0.2])
def test_a_signal_shortly_before_a_step_leaves_no_motor_on(tmp_path: Path, kind: str, before_s: float) -> None:
    """What the procedure was about to do when the end was asked for must not come after the stop."""
    radio = {"latency_s": 0.0285, "jitter_s": 0.008}
    words = ("log", "thrust", "--from", 20000, "--to", 30000, "--step", 10000, "--hold", 0.8, "--rest", 0.6, "--yes")
    with bench_in(tmp_path, crazyflie={"firmware": kind}, radio=radio) as bench:
        pilot = bench.start(*words)
        pilot.wait_until_motors_run(0.0)
        step_s = bench.history[-1][0] + 0.8 + 0.6  # about when the second one is sent
        time.sleep(max(step_s - before_s - time.monotonic(), 0.0))
        pilot.send(signal.SIGINT)
        code = pilot.end()
        time.sleep(AFTERWARDS_S)
        assert code == 0, pilot.err
        assert not any(bench.motors), "the motors came on again"


def test_ctrl_z_and_ctrl_backslash_stop_the_motors_too(tmp_path: Path) -> None:
    for number in (signal.SIGTSTP, signal.SIGQUIT):
        folder = tmp_path / number.name
        folder.mkdir()
        with bench_in(folder, crazyflie={"firmware": "stock"}) as bench:
            pilot = bench.start(*HOLD)
            pilot.wait_until_motors_run()
            began_s = time.monotonic()
            pilot.send(number)
            assert bench.stopped_after(began_s) < STOPPED_WITHIN_S
            assert pilot.end() == 0, pilot.err


def test_a_vehicle_whose_log_was_reset_by_another_program_is_not_left_unwatched(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start(*HOLD)
        pilot.wait_until_motors_run()
        began_s = time.monotonic()
        bench.in_loop(lambda: bench.rig.crazyflie.vehicle.receive(b"\x5d\x05", time.monotonic()))
        assert bench.stopped_after(began_s + 0.5) < STOPPED_WITHIN_S
        assert pilot.end() == 3
        assert "its battery is not watched" in pilot.err
