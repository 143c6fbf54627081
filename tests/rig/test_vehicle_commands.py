"""Commands that drive the vehicle, as their operator sees them, over real wires to a simulated vehicle."""

import json
import os
import pty
import re
import select
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from cfid.recordings.vehicle import read_rows
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import load_rig
from cfid.records.run import list_runs, read_run
from cfid.rig.tables import connect
from cfid.sim.crazyflie_services import parameters
from cfid.sim.supervisor import SupervisorState
from cfid.wire.app import AppPorts
from tests.flying_in_a_folder import LONGEST_S, Bench, bench_in
from tests.lateness import kept_waiting_s

Cfid = Callable[..., subprocess.CompletedProcess[str]]
Floats = npt.NDArray[np.float64]

STAIRS = (
    "log",
    "thrust",
    "--from",
    10000,
    "--to",
    30000,
    "--step",
    10000,
    "--hold",
    0.6,
    "--rest",
    0.3,
    "--yes",
)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as bench:
        yield bench


@contextmanager
def listening(answer: Callable[[bytes], bytes | None]) -> Iterator[str]:
    """Yield the address of a program that answers datagrams with what `answer` returns."""
    ended = threading.Event()
    with socket.socket(type=socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        line.settimeout(0.1)

        def serve() -> None:
            while not ended.is_set():
                try:
                    datagram, client = line.recvfrom(64)
                except TimeoutError:
                    continue
                found = answer(datagram)
                if found is not None:
                    line.sendto(found, client)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"udp://127.0.0.1:{line.getsockname()[1]}"
        finally:
            ended.set()
            thread.join()


def refused(bench: Bench, *words: object, within_s: float = 15.0) -> str:
    """Run a command that cannot reach the vehicle, and return its last sentence."""
    pilot = bench.start(*words)
    began_s, late_s = time.monotonic(), 0.0
    while pilot.process.poll() is None:
        late_s += kept_waiting_s()
        assert time.monotonic() - began_s - late_s < within_s
    assert pilot.end() == 3, pilot.err
    assert "Traceback" not in pilot.err
    return pilot.err.splitlines()[-1]


# Connection


def test_a_silent_address_is_told_within_its_time(bench: Bench) -> None:
    with listening(lambda datagram: None) as uri:
        message = refused(bench, "motors", "stop", "--uri", uri, within_s=6.0)
    assert message.startswith(f"cfid: {uri}: no answer within 2 s. Is the vehicle on")


def test_an_address_where_nobody_listens_is_told(bench: Bench) -> None:
    message = refused(bench, "log", "ping", "--uri", "udp://127.0.0.1:9", within_s=4.0)
    assert message == "cfid: udp://127.0.0.1:9: no program listens there: the vehicle is off, or the address is wrong."


@pytest.mark.parametrize("uri", ["crazyflie", "radio:/0", "http://127.0.0.1", ""])
def test_what_is_no_address_is_told(bench: Bench, uri: str) -> None:
    message = refused(bench, "log", "ping", "--uri", uri or "x")
    assert "this is not the address of a vehicle, such as radio://0/80/2M/E7E7E7E7E7." in message


def test_a_missing_radio_is_told(bench: Bench) -> None:
    message = refused(bench, "log", "ping", "--uri", "radio://0/80/2M/E7E7E7E7E7")
    assert "Crazyradio" in message or "radio" in message


def test_something_else_that_answers_is_no_vehicle(bench: Bench) -> None:
    with listening(lambda datagram: datagram) as uri:
        message = refused(bench, "log", "ping", "--uri", uri)
    assert message.startswith(f"cfid: {uri}: ")


def test_an_old_protocol_is_told(bench: Bench) -> None:
    bench.vehicle_suffers(protocol=3)
    message = refused(bench, "log", "ping")
    assert "speaks version 3 of its protocol, cfid needs 4 or newer: update its firmware." in message


@pytest.mark.parametrize("loss", [0.03, 0.1])
def test_motors_are_driven_over_a_link_that_loses_packets(tmp_path: Path, loss: float) -> None:
    with bench_in(tmp_path, radio={"latency_s": 4e-4, "jitter_s": 1e-4, "loss": loss}) as bench:
        pilot = bench.start("motors", "set", 20000, "--for", 0.3, "--yes")
        assert pilot.end() == 0, pilot.err
        assert "motors stopped, confirmed in" in pilot.out
        assert not any(bench.motors)


def test_a_link_that_loses_most_packets_is_named_as_the_cause(tmp_path: Path) -> None:
    with bench_in(tmp_path, radio={"latency_s": 4e-4, "jitter_s": 1e-4, "loss": 0.8}) as bench:
        message = refused(bench, "motors", "set", 20000, "--yes", within_s=40.0)
        assert re.search(r"(the|its) link loses (most )?packets", message)
        assert not any(bench.motors)


def test_a_link_that_is_closed_leaves_no_thread(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(bench.folder))
    before = set(threading.enumerate())
    link = connect(bench.uri)
    assert set(threading.enumerate()) > before
    link.close()
    left = [thread for thread in set(threading.enumerate()) - before if thread.daemon]
    assert left == []


# The vehicle's state


def spoiled(bench: Bench, state: str) -> None:
    """Bring the vehicle into a state in which no motor may start."""
    bench.vehicle_suffers(**{"emergency_after_s" if state == "locked" else "tumble_after_s": 0})
    end_s, there = time.monotonic() + 10.0, SupervisorState.LOCKED if state == "locked" else SupervisorState.NOT_PASSED
    while bench.rig.crazyflie.vehicle.supervisor.state is not there:
        bench.in_loop(lambda: bench.rig.crazyflie.advance(time.monotonic()))
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.parametrize("state", ["locked", "tumbled"])
@pytest.mark.parametrize("words", [STAIRS, ("motors", "set", 20000, "--yes"), ("motors", "--yes")])
def test_a_vehicle_that_cannot_run_is_refused_by_its_state_before_a_run_folder_exists(
    bench: Bench, words: tuple[object, ...], state: str
) -> None:
    spoiled(bench, state)
    message = refused(bench, *words)

    assert f"the vehicle is {state}: " in message
    assert list_runs(bench.folder / "runs") == []


@pytest.mark.parametrize("state", ["locked", "tumbled"])
def test_rig_check_calls_no_such_vehicle_ok(bench: Bench, state: str) -> None:
    spoiled(bench, state)
    pilot = bench.start("rig", "check", "--json")
    pilot.end()
    answers = {answer["asked"]: answer for answer in json.loads(pilot.out)["devices"]["crazyflie"]}

    assert answers["supervisor"]["answer"] == state
    assert answers["supervisor"]["state"] == "fault"
    assert answers["supervisor"]["advice"]


def checked(bench: Bench) -> dict[str, dict[str, str]]:
    """Return what `cfid rig check` answers about the vehicle, by what it asked."""
    pilot = bench.start("rig", "check", "--json")
    pilot.end()
    return {answer["asked"]: answer for answer in json.loads(pilot.out)["devices"]["crazyflie"]}


@pytest.mark.parametrize(
    ("faults", "told"), [({"protocol": 9}, "2025.12"), ({"app_protocol": 3}, "speaks version 3, this cfid 1 and 2")]
)
def test_rig_check_calls_no_vehicle_ok_that_motors_set_refuses(bench: Bench, faults: dict[str, int], told: str) -> None:
    bench.vehicle_suffers(**faults)
    message = refused(bench, "motors", "set", 20000, "--yes")
    answers = checked(bench)

    assert told in message
    assert answers["link"]["state"] == "ok"
    assert answers["motors"]["state"] == "fault"
    assert told in answers["motors"]["answer"]


def test_rig_check_notes_a_protocol_that_is_newer_than_cfid(bench: Bench) -> None:
    assert checked(bench)["link"]["state"] == "ok"
    bench.vehicle_suffers(protocol=99)
    link = checked(bench)["link"]

    assert link["state"] == "warning"
    assert "protocol 99" in link["answer"]


@pytest.mark.parametrize(
    ("vehicle", "platform", "state"),
    [
        ("cf21bl", "cf2", "warning"),
        ("cf21bl", "cf21bl", "ok"),
        ("cf21bl", "crazyflie", "ok"),
        ("cf2", "cf21bl", "warning"),
        ("cf2", "cf2", "ok"),
    ],
)
def test_rig_check_compares_the_vehicle_with_rig_tomls_platform(
    tmp_path: Path, vehicle: str, platform: str, state: str
) -> None:
    with bench_in(tmp_path, crazyflie={"platform": vehicle}) as bench:
        rig = bench.folder / "rig.toml"
        text = rig.read_text()
        assert 'platform = "cf2"' in text
        rig.write_text(text.replace('platform = "cf2"', f'platform = "{platform}"'))
        answers = checked(bench)
    name = {"cf2": "Crazyflie 2.1", "cf21bl": "Crazyflie 2.1 Brushless"}[vehicle]
    assert (answers["vehicle"]["state"], answers["vehicle"]["answer"]) == (state, name)
    assert "firmware 2026.08" in answers["link"]["answer"]


def test_a_vehicle_that_is_busy_with_another_client_is_told(bench: Bench) -> None:
    port = int(bench.uri.rpartition(":")[2])
    ended = threading.Event()
    with socket.socket(type=socket.SOCK_DGRAM) as other:

        def talk() -> None:
            while not ended.is_set():
                other.sendto(b"\xff", ("127.0.0.1", port))
                time.sleep(0.1)

        bench.vehicle_suffers(busy=True)
        thread = threading.Thread(target=talk)
        thread.start()
        try:
            time.sleep(0.3)
            message = refused(bench, "log", "ping", within_s=6.0)
        finally:
            ended.set()
            thread.join()
    assert "no answer within 2 s" in message


def test_a_vehicle_that_another_cfid_drives_is_told_with_who_holds_it(bench: Bench) -> None:
    first = bench.start("motors", "set", 20000, "--yes")
    first.wait_until_motors_run()
    message = refused(bench, "log", "ping")
    assert f"held by process {first.process.pid}" in message
    assert any(bench.motors)


def test_motors_stop_needs_no_campaign_where_the_address_is_given(bench: Bench, tmp_path: Path) -> None:
    (bench.folder / RIG_FILE).write_text("nonsense")
    first = bench.start("motors", "stop", "--uri", bench.uri)
    assert first.end() == 0, first.err
    assert "motors stopped, confirmed in" in first.out
    assert "rig.toml" in first.err


def test_motors_stop_ends_what_overrides_the_app(bench: Bench) -> None:
    names = [parameter.name for parameter in parameters(rpm_deck=False)]
    for name, value in (("m1", struct.pack("<H", 30000)), ("enable", b"\1")):
        place = names.index(f"motorPowerSet.{name}")
        write = b"\x2e" + struct.pack("<H", place) + value
        bench.in_loop(partial(bench.rig.crazyflie.received, write, ("127.0.0.1", 9), time.monotonic()))
    bench.in_loop(lambda: bench.rig.crazyflie.advance(time.monotonic() + 0.1))
    assert bench.motors[0] == 30000
    ended = bench.start("motors", "stop")
    assert ended.end() == 0, ended.err
    assert not any(bench.motors)


def test_motors_that_an_app_on_other_ports_drives_are_stopped_too(bench: Bench) -> None:
    alive, thrust = b"\xc2" + bytes(4) + b"\x4d\0\0\0", b"\xa0" + struct.pack("<Hi", 15000, 4) + b"\x4d\0\0\0"

    def drive() -> None:
        now_s = time.monotonic()
        for packet in (alive, thrust):
            bench.rig.crazyflie.received(packet, ("127.0.0.1", 9), now_s)
        bench.rig.crazyflie.advance(now_s + 0.01)

    rig = bench.folder / "rig.toml"
    rig.write_text(rig.read_text() + "thrust_port = 1\nsine_port = 6\nping_port = 14\n")
    bench.in_loop(drive)
    assert bench.motors == (15000,) * 4
    ended = bench.start("motors", "stop")
    while ended.process.poll() is None:
        bench.in_loop(partial(bench.rig.crazyflie.received, alive, ("127.0.0.1", 9), time.monotonic()))
        time.sleep(0.05)
    assert ended.end() == 0, ended.err
    assert not any(bench.motors)


def test_a_stop_counts_where_nothing_can_be_printed(bench: Bench) -> None:
    with Path("/dev/full").open("w") as full:
        ended = bench.start("motors", "set", 20000, "--for", 0.3, "--yes", stdout=full)
        assert ended.end() == 0, ended.err
    assert "motors stopped, confirmed in" in ended.err
    assert not any(bench.motors)


def test_motors_stop_ends_another_cfid_that_drives_them(bench: Bench) -> None:
    first = bench.start("motors", "set", 20000, "--yes")
    first.wait_until_motors_run()
    second = bench.start("motors", "stop")
    assert second.end() == 0, second.err
    assert re.fullmatch(rf"{bench.uri}: motors stopped, confirmed in \d+ ms\.\n", second.out)
    assert first.end() == 0
    assert not any(bench.motors)


def test_motors_stop_without_an_address_stops_the_vehicle_that_is_driven(bench: Bench) -> None:
    rig = bench.folder / RIG_FILE
    rig.write_text(rig.read_text().replace(f"uri = '{bench.uri}'", ""))
    first = bench.start("motors", "set", 20000, "--yes", "--uri", bench.uri.replace("127.0.0.1", "localhost"))
    first.wait_until_motors_run()
    second = bench.start("motors", "stop")
    assert second.end() == 0, second.err
    assert second.out.startswith(f"{bench.uri}: motors stopped, confirmed in ")
    assert first.end() == 0
    assert not any(bench.motors)


# Before anything turns


def test_the_operator_confirms_with_the_address_before_a_motor_turns(bench: Bench) -> None:
    pilot = bench.start("motors", "set", 20000, "--for", 0.3, stdin=subprocess.PIPE)
    assert pilot.process.stdin is not None
    bench.wait_until(lambda: "[y/N]" in pilot.err, pilot)
    assert (
        f"{bench.uri}: motors 1, 2, 3, 4 will turn at commands up to 20000. Is the vehicle fastened and everyone clear?"
        in pilot.err
    )
    assert len(bench.history) == 1
    pilot.process.stdin.write(b"y\n")
    pilot.process.stdin.flush()
    assert pilot.end() == 0
    assert len(bench.history) > 1


@pytest.mark.parametrize(
    ("typed", "expected"), [(b"n\n", "not confirmed: no motor was started."), (b"", "a script gives --yes")]
)
def test_without_a_confirmation_nothing_turns(bench: Bench, typed: bytes, expected: str) -> None:
    pilot = bench.start(*STAIRS[:-1], stdin=subprocess.PIPE)
    pilot.process.communicate(typed)
    assert pilot.process.returncode == 2
    assert expected in pilot.err
    assert len(bench.history) == 1
    assert not (bench.folder / "runs").exists()


def test_rig_tomls_limit_is_told_before_anything_is_asked(bench: Bench) -> None:
    rig = bench.folder / RIG_FILE
    rig.write_text(rig.read_text() + "largest_command = 25000\n")
    for words in (STAIRS, ("motors", "set", 30000, "--yes"), ("log", "sine", "--l", 3, "--yes")):
        pilot = bench.start(*words)
        assert pilot.end() == 2
        assert "commands go from 0 to 25000 (devices.crazyflie.largest_command in rig.toml)" in pilot.err
    assert len(bench.history) == 1


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("log sine --l 1,x", "--periods 1,x: should be whole numbers with commas between, as 1,2,4."),
        ("log sine --l 2001", "--periods 2001: has to be from 0 to N/2 = 2000."),
        ("log sine --l 4,4", "--periods 4,4: names a frequency twice."),
        ("log sine --l 4 --amplitude 30001", "--amplitude 30001: above 30000 the sine is clipped; --force allows it."),
        ("log thrust some-run", "some-run: a run is named to resume it: write --resume some-run."),
        ("log sine --l 4 --n 0", "Invalid value for '--samples'"),
        ("log sine --motor 1,5", "--motor 1,5: should be whole numbers from 0 to 4 with commas between, as 1,3."),
        ("log sine --l 4 --plan thesis-first", "--periods and --plan thesis-first: give one of them."),
        ("log sine --n 2000 --l 2,1001", "--periods 1001: has to be from 0 to N/2 = 1000."),
        ("log thrust --from 3000 --to 2000", "--from 3000 --to 2000: there is no command between them."),
        ("log thrust --hold 0", "--hold 0: has to be above zero."),
        ("log thrust --hold 1e99", "--hold 1e+99: has to be 3600 at most."),
        ("log thrust --step 100000", "no motor turns at command 0 alone."),
        ("log sine --before 1e99", "--before 1e+99: has to be 600 at most."),
        ("log sine --amplitude 0", "greater than or equal to 1"),
        ("log thrust --to 70000", "Invalid value for '--to'"),
        ("log speed --port /dev/x", "--port is the UT372's, and --tachometer is typed."),
        ("motors set 70000", "Invalid value for"),
        ("motors set 1000 --motor 5", "--motor 5: should be whole numbers from 1 to 4 with commas between, as 1,3."),
        ("log ping --interval 0", "--interval 0: has to be above zero."),
    ],
)
def test_what_cannot_be_meant_so_is_told_first(cfid: Cfid, tmp_path: Path, words: str, expected: str) -> None:
    assert cfid("new", str(tmp_path)).returncode == 0
    ended = cfid(*words.split(), "--campaign", str(tmp_path))
    assert ended.returncode == 2
    assert expected in ended.stderr


# What is recorded


def test_a_staircase_is_felt_by_the_load_cell(bench: Bench) -> None:
    pilot = bench.start(*STAIRS, "--json")
    assert pilot.end() == 0, pilot.err
    content = json.loads(pilot.out)
    run = bench.run()

    assert content["command"] == "log thrust"
    assert {name: device["lost"] for name, device in content["devices"].items()} == {
        "commands": 0,
        "loadcell": 0,
        "crazyflie": 0,
        "supervisor": 0,
    }
    assert run.header.requested["steps"] == [10000, 20000, 30000]
    commands, cell = (pd.read_csv(run.device_file(name)) for name in ("commands", "loadcell"))
    steps = commands[commands.m1 > 0]
    assert steps.m1.tolist() == steps.m3.tolist() == [10000, 20000, 30000]
    at_rest = cell[cell.t < steps.t.iloc[0]].Fz.mean()
    lifted = []
    for begin_s in steps.t:
        window = cell[(cell.t > begin_s + 0.35) & (cell.t < begin_s + 0.58)]
        lifted.append((window.Fz.mean() - at_rest) / 1e6)
    thrust_n = [2 * 1.8e-8 * (381 + 0.0408 * step) ** 2 for step in (10000, 20000, 30000)]
    assert lifted == pytest.approx(thrust_n, rel=0.1)


def test_a_run_that_is_moved_while_motors_turn_ends_with_how_they_stopped(bench: Bench) -> None:
    pilot = bench.start(*STAIRS)
    pilot.wait_until_motors_run()
    (folder,) = (bench.folder / "runs").iterdir()
    folder.rename(bench.folder / "elsewhere")

    assert pilot.end() == 4, pilot.err
    assert "was moved during the recording" in pilot.err
    assert re.search(r"motors stopped, confirmed in \d+ ms\.", pilot.err)
    assert not any(bench.motors)


@pytest.mark.parametrize("fault", [True, False])
def test_a_run_toml_that_cannot_be_written_at_the_end_is_named_with_how_the_motors_stopped(
    bench: Bench, fault: bool
) -> None:
    pilot = bench.start(*STAIRS)
    pilot.wait_until_motors_run()
    (folder,) = (bench.folder / "runs").iterdir()
    header = folder / "run.toml"
    header.rename(folder / "begun.toml")
    header.mkdir()  # no file can replace a folder, not even for an administrator
    if fault:
        bench.vehicle_suffers(low_battery_after_s=0)

    assert pilot.end() == (3 if fault else 4), pilot.err
    assert re.search(r"motors stopped, confirmed in \d+ ms\.", pilot.err)
    assert pilot.err.count("The run counts as cut. Its rows are kept.") == 1
    assert f"{header} cannot be written either" in pilot.err or f"{header}: cannot be written" in pilot.err
    assert "None rows" not in pilot.out
    assert not any(bench.motors)


def test_an_interrupted_staircase_is_resumed_where_it_ended(bench: Bench) -> None:
    pilot = bench.start(*STAIRS)
    bench.wait_until(lambda: bench.motors[0] == 20000, pilot)
    pilot.send(signal.SIGINT)
    assert pilot.end() == 0
    first = bench.run()
    again = bench.start("log", "thrust", "--resume", "--yes")
    assert again.end() == 0, again.err

    second = next(run for run in map(read_run, (bench.folder / "runs").iterdir()) if run.folder != first.folder)
    assert first.header.state == "interrupted"
    assert second.header.requested["steps"] == [20000, 30000]
    assert second.header.requested["hold_s"] == 0.6
    assert first.header.rig == second.header.rig == load_rig(bench.folder / RIG_FILE).facts
    nothing = bench.start("log", "thrust", "--resume", second.folder, "--yes")
    assert nothing.end() == 2
    assert "is complete" in nothing.err


@pytest.mark.parametrize("silent", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_staircase_that_ends_in_the_pause_after_its_last_step_is_complete(bench: Bench, silent: bool) -> None:
    words = ("--from", 20000, "--to", 30000, "--step", 10000, "--hold", 1, "--rest", 3, "--yes")
    pilot = bench.start("log", "thrust", *words)
    bench.wait_until(lambda: bench.motors[0] == 30000 or pilot.process.poll() is not None, pilot)
    bench.wait_until(lambda: not any(bench.motors), pilot)
    if silent:
        bench.vehicle_suffers(silent_after_s=0)
    else:
        pilot.send(signal.SIGINT)
    assert pilot.end() == (3 if silent else 0), pilot.err
    run = bench.run()

    assert run.header.state == "complete"
    assert ("no keep-alive" in run.header.reason) == silent
    assert pilot.err.count("no keep-alive") + pilot.out.count("no keep-alive") == silent
    assert ("before the fault below: the run is complete" in pilot.out) == silent
    assert run.header.verdict is not None
    assert "--resume" not in pilot.out


def test_a_sine_on_board_is_known_to_a_sample_and_felt_by_the_load_cell(bench: Bench) -> None:
    pilot = bench.start("log", "sine", "--l", "12", "--n", 1000, "--yes")
    assert pilot.end() == 0, pilot.err
    run = bench.run()
    crossings = pd.read_csv(run.device_file("crossings"))
    n = np.arange(1000)
    u = np.trunc(np.round(20000 * np.cos(2 * np.pi * 12 * n / 1000) + 30000, 6)).astype(int)
    expected = [0, *(np.flatnonzero(((u[:-1] > 30000) & (u[1:] <= 30000)) | ((u[:-1] < 30000) & (u[1:] >= 30000))) + 1)]

    assert crossings["sample"].tolist() == [*expected, 1000]
    assert np.abs(crossings.thrust_rec.to_numpy()[:-1] - u[expected]).max() <= 1
    on_board_s = (crossings.vehicle_us - crossings.vehicle_us.iloc[0]).to_numpy() / 1e6
    assert on_board_s == pytest.approx(crossings["sample"].to_numpy() / 500, abs=0.002)
    assert run.header.requested == {"l": 12, "n": 1000, "amplitude": 20000, "motor": 1}

    cell = pd.read_csv(run.device_file("loadcell"))
    begin_s = (crossings.t - on_board_s).min()  # from the report with the smallest delay
    played = cell[(cell.t > begin_s) & (cell.t < begin_s + 2.0)]
    phase = 2 * np.pi * 6 * (played.t - begin_s)  # l 500/N hertz
    basis = np.column_stack([np.ones(len(played)), np.cos(phase), np.sin(phase)])
    _, cos, sin = np.linalg.lstsq(basis, played.Fz.to_numpy() / 1e6, rcond=None)[0]
    assert np.hypot(cos, sin) > 0.005
    assert sin > 0  # the rotor lags behind


def test_sines_are_played_one_after_the_other_and_resumed(bench: Bench) -> None:
    words = ("log", "sine", "--l", "5,20,40", "--n", 300, "--yes", "--before", 0.2)
    pilot = bench.start(*words)
    bench.wait_until(lambda: "l = 5: complete" in pilot.out or pilot.process.poll() is not None, pilot)
    pilot.wait_until_motors_run(0.1)
    pilot.send(signal.SIGTERM)
    assert pilot.end() == 0
    assert not any(bench.motors)
    stopped = max((bench.folder / "runs").iterdir()).name
    assert "`cfid log sine --resume" in " ".join(pilot.out.split())
    again = bench.start("log", "sine", "--yes", "--before", 0.2, "--resume", stopped, "--json")
    assert again.end() == 0, again.err

    content = json.loads(again.out)
    assert content["wanted"] == [20, 40]
    assert [run["state"] for run in content["runs"]] == ["complete", "complete"]
    states = [(run.header.requested["l"], run.header.state) for run in list_runs(bench.folder / "runs")]  # type: ignore[union-attr]
    assert states == [(5, "complete"), (20, "interrupted"), (20, "complete"), (40, "complete")]
    last = bench.start(*words, "--resume")
    assert last.end() == 2
    assert "--resume: nothing is left to record: the campaign has every sine of the series." in last.err


def test_stock_firmware_plays_no_sine_and_says_what_it_needs(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        pilot = bench.start("log", "sine", "--l", 3, "--yes")
        assert pilot.end() == 3
        assert "a sine is played on board: this needs cfid's app" in pilot.err


@pytest.mark.parametrize("firmware", ["app", "stock"])
def test_round_trips_are_those_that_the_radio_made(tmp_path: Path, firmware: str) -> None:
    # The host always adds some time: usually little, sometimes more on a busy machine.
    for attempt in range(3):
        measured_s, pings, found = ping_the_bench(tmp_path / str(attempt), firmware)
        added_s = measured_s - pings
        assert added_s.min() >= 0
        if usually_little := np.percentile(added_s, 75) < 0.04 * np.mean(pings):
            break
    assert usually_little
    assert found["latency.rtt_mean_s"]["value"] == pytest.approx(measured_s.mean(), rel=1e-6)
    assert found["latency.rtt_std_s"]["value"] == pytest.approx(np.std(measured_s, ddof=1), rel=1e-6)


def ping_the_bench(
    folder: Path, firmware: str
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], dict[str, Any]]:
    """Return the round trips that cfid measured, those that the radio made, and the fitted parameters."""
    radio = {"latency_s": 0.0285, "jitter_s": 0.008}  # table 3.2
    folder.mkdir()
    with bench_in(folder, crazyflie={"firmware": firmware}, radio=radio) as bench:
        pilot = bench.start("log", "ping", "--count", 60, "--interval", 0.07, "--note", "on the bench", "--json")
        assert pilot.end() == 0, pilot.err
        pings = [
            ping.round_trip_s
            for ping in bench.rig.crazyflie.radio.pings
            if (
                ping.payload[:1] == b"\xcf" and any(ping.payload[1:])
                if firmware == "stock"
                else ping.port == AppPorts().ping
            )
        ]
        measured_s = pd.read_csv(bench.run().device_file("pings")).rtt_s.to_numpy()
    assert len(pings) >= 60
    return measured_s, np.array(pings[-60:]), json.loads(pilot.out)["parameters"]


def test_pings_are_told_as_table_3_2_has_them(bench: Bench) -> None:
    pilot = bench.start("log", "ping", "--count", 20, "--interval", 0.02, "--note", "CF just started up")
    assert pilot.end() == 0, pilot.err
    lines = pilot.out.splitlines()
    assert lines[1].split() == ["circumstances", "packets", "mean", "RTT", "[ms]", "std", "[ms]", "least", "[ms]"]
    assert lines[2].startswith("CF just started up")
    assert len([line for line in lines if "█" in line]) >= 1


def test_speeds_are_typed_while_the_motors_run(bench: Bench) -> None:
    words = (
        "log",
        "speed",
        "--from",
        20000,
        "--to",
        40000,
        "--step",
        10000,
        "--hold",
        0.2,
        "--rest",
        0.1,
        "--yes",
    )
    pilot = bench.start(*words, stdin=subprocess.PIPE)
    pilot.process.communicate(b"12000\n\n15000.5\n")
    assert pilot.process.returncode == 0, pilot.err
    readings = pd.read_csv(bench.run().device_file("readings"))
    assert readings[["command", "rpm"]].to_numpy().tolist() == [[20000, 12000], [40000, 15000.5]]


def test_a_reading_is_taken_back_and_its_command_held_again(bench: Bench) -> None:
    words = (
        "log",
        "scales",
        "--from",
        20000,
        "--to",
        40000,
        "--step",
        10000,
        "--hold",
        0.2,
        "--rest",
        0.1,
        "--yes",
    )
    pilot = bench.start(*words, stdin=subprocess.PIPE)
    pilot.process.communicate(b"u\n12\nundo\n30\n25\n60\n")
    assert pilot.process.returncode == 0, pilot.err
    run = bench.run()
    on_disk = pd.read_csv(run.device_file("readings"))
    kept = read_rows(run, "readings").columns

    assert "there is no reading to take back" in pilot.err
    assert "taken back: 12 at command 20000" in pilot.err
    assert on_disk[["command", "grams", "withdrawn"]].to_numpy().tolist()[:2] == [[20000, 12, 0], [20000, 12, 1]]
    assert "withdrawn" not in kept
    assert kept["command"].tolist() == [30000, 20000, 40000]
    assert kept["grams"].tolist() == [30, 25, 60]
    assert "3 readings at 3 steps" in pilot.out


TYPED = ("--from", 20000, "--to", 40000, "--step", 10000, "--hold", 0.2, "--rest", 0.1, "--yes")


class Terminal:
    """A terminal at which a recording asks for readings."""

    def __init__(self, bench: Bench, *words: object) -> None:
        self._bench = bench
        self._master, slave = pty.openpty()
        self.pilot = bench.start(*words, stdin=slave, stdout=slave, stderr=slave)
        os.close(slave)
        self._shown = ""
        self._answered = 0  # number of characters shown before the last answer

    @property
    def shown(self) -> str:
        """The text that was shown so far."""
        with suppress(OSError):  # the other end is closed
            while select.select([self._master], [], [], 0)[0]:
                self._shown += os.read(self._master, 65536).decode(errors="replace")
        return self._shown

    def wait_for(self, text: str) -> None:
        """Wait until a text is shown that was not yet shown at the last answer."""
        end_s = time.monotonic() + LONGEST_S
        while text not in self.shown[self._answered :]:
            assert self.pilot.process.poll() is None, self.shown
            assert time.monotonic() < end_s, self.shown
            time.sleep(0.005)

    def answer(self, *answers: tuple[str, str]) -> None:
        """Type lines, each once its question is shown; a question must come after the previous answer."""
        for question, line in answers:
            self.wait_for(question)
            self._answered = len(self.shown)
            os.write(self._master, f"{line}\n".encode())

    def close(self) -> None:
        os.close(self._master)


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_the_last_reading_is_taken_back_before_the_recording_ends(bench: Bench, quiet: tuple[str, ...]) -> None:
    terminal = Terminal(bench, "log", "speed", *TYPED, *quiet)
    terminal.answer(
        ("RPM at command 20000", "11500"),
        ("RPM at command 30000", "15300"),
        ("RPM at command 40000", "9100"),
        ("Enter ends, u undoes 9100", "u"),
        ("RPM at command 40000", "19000"),
        ("Enter ends, u undoes 19000", ""),
    )
    assert terminal.pilot.end() == 0, terminal.shown
    kept = read_rows(bench.run(), "readings").columns

    assert "taken back: 9100 at command 40000, which is held again now." in terminal.shown
    assert ("\a" in terminal.shown) == (not quiet)
    assert kept["rpm"].tolist() == [11500, 15300, 19000]
    assert bench.run().header.state == "complete"
    terminal.close()


# Two markers per turn.
THREE_READINGS = (
    ("RPM at command 20000", "23000"),
    ("RPM at command 30000", "30600"),
    ("RPM at command 40000", "38000"),
)


def test_ctrl_c_where_all_is_read_ends_a_recording_as_enter_does(bench: Bench) -> None:
    terminal = Terminal(bench, "log", "speed", *TYPED)
    terminal.answer(*THREE_READINGS)
    terminal.wait_for("Enter ends")
    terminal.pilot.send(signal.SIGINT)
    assert terminal.pilot.end() == 0, terminal.shown

    assert bench.run().header.state == "complete"
    assert "3 readings at 3 steps" in terminal.shown
    terminal.close()


def test_ctrl_c_in_the_pause_after_the_last_reading_ends_a_recording_as_enter_does(bench: Bench) -> None:
    terminal = Terminal(bench, "log", "speed", *TYPED[:8], "--rest", 2, *TYPED[10:])
    terminal.answer(*THREE_READINGS)
    bench.wait_until(lambda: not any(bench.motors), terminal.pilot)
    terminal.pilot.send(signal.SIGINT)
    assert terminal.pilot.end() == 0, terminal.shown

    assert bench.run().header.state == "complete"
    assert "3 readings at 3 steps" in terminal.shown
    terminal.close()


def test_a_script_takes_its_last_reading_back(bench: Bench) -> None:
    pilot = bench.start("log", "speed", *TYPED, stdin=subprocess.PIPE)
    pilot.process.communicate(b"11500\n15300\n9000\nu\n19000\n23000\n")

    assert pilot.process.returncode == 0, pilot.err
    assert "taken back: 9000 at command 40000, which is held again now." in pilot.err
    assert "'23000' is not used: every step is read." in pilot.err
    assert read_rows(bench.run(), "readings").columns["rpm"].tolist() == [11500, 15300, 19000]


@pytest.mark.parametrize("shown", [False, True])
def test_a_terminal_that_is_closed_at_a_reading_ends_a_recording_as_sighup_does(bench: Bench, shown: bool) -> None:
    master, slave = pty.openpty()
    where = {"stdout": slave, "stderr": slave} if shown else {}
    pilot = bench.start("log", "speed", *TYPED, stdin=slave, **where)
    os.close(slave)
    bench.wait_until(lambda: bench.motors[0] == 20000 or pilot.process.poll() is not None, pilot)
    time.sleep(0.5)  # part of the hold
    os.close(master)
    assert pilot.end() == 0, pilot.err
    header = bench.run().header

    assert not any(bench.motors)
    assert header.state == "interrupted"
    assert header.reason.startswith("ended by SIGHUP after")
    assert (header.devices["commands"].model_extra or {}).get("stopped_in_s") is not None


def test_an_implausible_reading_counts_once_it_is_typed_twice(bench: Bench) -> None:
    terminal = Terminal(bench, "log", "speed", *TYPED)
    terminal.answer(
        ("RPM at command 20000", "250000"),
        ("to keep it", "11500"),
        ("RPM at command 30000", "999999"),
        ("to keep it", "999999"),
        ("RPM at command 40000", "19000"),
        ("Enter ends", ""),
    )
    assert terminal.pilot.end() == 0, terminal.shown

    assert "the reading is implausible, 2.5e+05 rpm." in " ".join(terminal.shown.split())
    assert read_rows(bench.run(), "readings").columns["rpm"].tolist() == [11500, 999999, 19000]
    terminal.close()


def test_input_that_ends_before_a_question_stops_the_motors(bench: Bench) -> None:
    master, slave = pty.openpty()
    pilot = bench.start("log", "speed", *TYPED[:7], 2, *TYPED[8:], stdin=slave)
    os.close(slave)
    bench.wait_until(lambda: bench.motors[0] == 20000 or pilot.process.poll() is not None, pilot)
    os.write(master, b"\x04")

    assert pilot.end() == 2
    assert "standard input ended before the reading was typed" in pilot.err
    assert not any(bench.motors)
    os.close(master)


@pytest.mark.parametrize(("kind", "typed"), [("speed", b"11500\n15300\n999999999\n"), ("scales", b"30\n25\n77777\n")])
def test_a_script_is_told_of_an_implausible_reading_and_its_run_is_not_usable(
    bench: Bench, kind: str, typed: bytes
) -> None:
    pilot = bench.start("log", kind, *TYPED, stdin=subprocess.PIPE)
    pilot.process.communicate(typed)
    run = bench.run()

    assert pilot.process.returncode == 0, pilot.err
    assert "is implausible" in pilot.err
    assert len(read_rows(run, "readings").time_s) == 3
    assert run.header.verdict is not None
    assert not run.header.verdict.usable
    assert "command 40000" in run.header.verdict.text


def test_a_script_is_told_of_a_speed_at_command_0_and_its_run_is_not_usable(bench: Bench) -> None:
    staircase = ("--from", 0, "--to", 40000, "--step", 20000, *TYPED[6:])
    pilot = bench.start("log", "speed", *staircase, stdin=subprocess.PIPE)
    pilot.process.communicate(b"7290\n11500\n19000\n")
    verdict = bench.run().header.verdict

    assert pilot.process.returncode == 0, pilot.err
    assert "7290 rpm of a rotor that stands" in pilot.err
    assert verdict is not None
    assert not verdict.usable
    assert verdict.text.startswith("command 0: the reading is implausible")


@pytest.mark.parametrize(
    ("typed", "expected"), [(b"12000\nfast\n", "'fast' is not a reading"), (b"12000\n", "standard input ended")]
)
def test_a_script_that_types_nonsense_or_ends_early_stops_the_motors(bench: Bench, typed: bytes, expected: str) -> None:
    words = (
        "log",
        "scales",
        "--from",
        20000,
        "--to",
        40000,
        "--step",
        10000,
        "--hold",
        0.2,
        "--rest",
        0.1,
        "--yes",
    )
    pilot = bench.start(*words, stdin=subprocess.PIPE)
    pilot.process.communicate(typed)
    assert pilot.process.returncode == 2
    assert expected in pilot.err
    assert not any(bench.motors)
    assert bench.run().header.state == "failed"
    assert len(pd.read_csv(bench.run().device_file("readings"))) == 1


@pytest.mark.parametrize(("option", "truth"), [("deck", {"rpm_deck": True}), ("brushless", {"platform": "cf21bl"})])
def test_speeds_that_the_vehicle_tells_itself_are_logged(tmp_path: Path, option: str, truth: dict[str, Any]) -> None:
    words = ("log", "speed", "--from", 30000, "--to", 30000, "--hold", 0.6, "--rest", 0.3, "--yes")
    with bench_in(tmp_path, crazyflie=truth) as bench:
        pilot = bench.start(*words, "--tachometer", option)
        assert pilot.end() == 0, pilot.err
        log = pd.read_csv(bench.run().device_file("crazyflie"))
    brushed_rpm, brushless_rpm = (381 + 0.0408 * 30000) * 60 / (2 * np.pi), 0.36 * 30000
    column, rpm = ("rpm.m1", brushed_rpm) if option == "deck" else ("motor.m1_rpm", brushless_rpm)
    assert log[column].max() == pytest.approx(rpm, rel=0.02)


def test_speeds_that_the_vehicle_tells_itself_are_resumed_as_such(tmp_path: Path) -> None:
    quick = ("--hold", 0.6, "--rest", 0.3, "--yes")
    with bench_in(tmp_path, crazyflie={"rpm_deck": True}) as bench:
        pilot = bench.start(
            "log", "speed", "--from", 20000, "--to", 30000, "--step", 10000, *quick, "--tachometer", "deck"
        )
        bench.wait_until(lambda: bench.motors[0] == 30000, pilot)
        pilot.send(signal.SIGINT)
        assert pilot.end() == 0, pilot.err
        again = bench.start("log", "speed", "--resume", bench.run().folder, *quick[-1:])
        assert again.end() == 0, again.err
        first, second = sorted((bench.folder / "runs").iterdir())
    assert read_run(second).header.requested["steps"] == [30000]
    assert "rpm.m1" in pd.read_csv(second / "crazyflie.csv").columns
    assert read_run(first).header.devices.keys() == read_run(second).header.devices.keys()


def test_a_vehicle_without_a_deck_says_so(bench: Bench) -> None:
    pilot = bench.start("log", "speed", "--tachometer", "deck", "--yes")
    assert pilot.end() == 3
    assert "this vehicle has no RPM deck: it does not log rpm.m1." in pilot.err


# The console


def test_a_reading_that_was_not_typed_is_asked_for_again(bench: Bench) -> None:
    words = (
        "log",
        "speed",
        "--from",
        20000,
        "--to",
        40000,
        "--step",
        10000,
        "--hold",
        0.2,
        "--rest",
        0.1,
        "--yes",
    )
    pilot = bench.start(*words, stdin=subprocess.PIPE)
    assert pilot.process.stdin is not None
    pilot.process.stdin.write(b"12000\n")
    pilot.process.stdin.flush()
    bench.wait_until(lambda: bench.motors[0] == 30000, pilot)
    time.sleep(0.6)
    pilot.send(signal.SIGINT)
    assert pilot.end() == 0
    again = bench.start("log", "speed", "--resume", bench.run().folder, "--dry-run")
    assert again.end() == 0, again.err
    assert again.out.startswith("2 commands from 30000 to 40000")
    other = bench.start("log", "thrust", "--resume", bench.run().folder, "--dry-run")
    assert other.end() == 2
    assert "is no run of `cfid log thrust` that could be resumed" in other.err


def test_a_run_whose_only_reading_was_taken_back_is_resumed_from_its_first_step(bench: Bench) -> None:
    words = ("log", "speed", "--from", 20000, "--to", 30000, "--step", 10000, "--hold", 0.2, "--rest", 0.1, "--yes")
    pilot = bench.start(*words, stdin=subprocess.PIPE)
    assert pilot.process.stdin is not None
    pilot.process.stdin.write(b"12000\nu\n")
    pilot.process.stdin.flush()
    bench.wait_until(lambda: "taken back" in pilot.err, pilot)
    pilot.send(signal.SIGINT)
    assert pilot.end() == 0
    named = re.search(r"`cfid (log speed --resume \S+)` records what it lacks", " ".join(pilot.out.split()))
    assert named is not None
    again = bench.start(*named[1].split(), "--dry-run")
    assert again.end() == 0, again.err
    assert again.out.startswith("2 commands from 20000 to 30000")


def test_the_console_obeys_lines(bench: Bench) -> None:
    pilot = bench.start("motors", "--yes", stdin=subprocess.PIPE)
    assert pilot.process.stdin is not None
    for line, motors in [
        ("1 3 20000", (20000, 0, 20000, 0)),
        ("a 30000", (30000,) * 4),
        ("stop", (0, 0, 0, 0)),
        ("1 20000, 2 15000", (20000, 15000, 0, 0)),
        ("18000", (18000, 18000, 0, 0)),
    ]:
        pilot.process.stdin.write(f"{line}\n".encode())
        pilot.process.stdin.flush()
        bench.wait_until(lambda motors=motors: bench.motors == motors or pilot.process.poll() is not None, pilot)
        assert bench.motors == motors, pilot.err
    pilot.process.stdin.write(b"q\n")
    pilot.process.stdin.flush()
    assert pilot.end() == 0
    assert not any(bench.motors)


def test_the_console_obeys_keys_at_a_terminal_and_space_stops_at_once(bench: Bench) -> None:
    master, slave = pty.openpty()
    pilot = bench.start("motors", "--yes", stdin=slave)
    os.close(slave)
    bench.wait_until(lambda: "space, Enter, s" in pilot.err, pilot)
    for keys, motors in [
        (b"1 3 20000\n", (20000, 0, 20000, 0)),
        (b"\x1b[A", (20500, 0, 20500, 0)),
        (b"\x1b[B\x1b[B", (19500, 0, 19500, 0)),
        (b" ", (0, 0, 0, 0)),
        (b"all 14x\x7f2000\r", (12000,) * 4),
        (b"\r", (0, 0, 0, 0)),
        (b"7 100\n", (0, 0, 0, 0)),
        (b"2 9000\n", (0, 9000, 0, 0)),
        (b"4 100s", (0, 0, 0, 0)),
        (b"2 9000\n", (0, 9000, 0, 0)),
        (b"4  ", (0, 0, 0, 0)),
        (b"3 9000\n", (0, 0, 9000, 0)),
        (b"1 4\x1b", (0, 0, 0, 0)),
        (b"[A", (0, 0, 0, 0)),
        (b"1 9000\n", (9000, 0, 0, 0)),
        (b"4 30x00 2\n", (0, 0, 0, 0)),
        (b"1 9000\n", (9000, 0, 0, 0)),
    ]:
        os.write(master, keys)
        bench.wait_until(lambda motors=motors: bench.motors == motors or pilot.process.poll() is not None, pilot)
        assert bench.motors == motors, pilot.err
    os.write(master, b"q")
    assert pilot.end() == 0
    assert not any(bench.motors)
    assert "motors are 1 to 4, not 7" in pilot.err
    os.close(master)


@pytest.mark.parametrize("firmware", ["app", "stock"])
def test_a_stop_goes_before_all_keys_that_wait(tmp_path: Path, firmware: str) -> None:
    radio = {"latency_s": 0.0285, "jitter_s": 0.008}
    with bench_in(tmp_path, crazyflie={"firmware": firmware}, radio=radio) as bench:
        master, slave = pty.openpty()
        pilot = bench.start("motors", "--yes", stdin=slave)
        os.close(slave)
        bench.wait_until(lambda: "space, Enter, s" in pilot.err, pilot)
        os.write(master, b"a 30000\n")
        bench.wait_until(lambda: bench.motors == (30000,) * 4, pilot)
        for _ in range(60):
            os.write(master, b"\x1b[A")
            time.sleep(0.02)
        began_s = time.monotonic()
        os.write(master, b" ")
        assert bench.stopped_after(began_s) < 0.7
        time.sleep(1.0)
        assert not any(bench.motors)
        os.write(master, b"q")
        assert pilot.end() == 0, pilot.err
        os.close(master)


def test_a_dry_run_tells_the_time_and_reaches_for_nothing(cfid: Cfid, tmp_path: Path) -> None:
    assert cfid("new", str(tmp_path)).returncode == 0
    stairs = cfid("log", "thrust", "--dry-run", "--campaign", str(tmp_path))
    sines = cfid("log", "sine", "--l", "1,2,4", "--dry-run", "--campaign", str(tmp_path))
    assert stairs.stdout == "33 commands from 0 to 64000 on motors 1, 3, 10 s each with 3 s of pause: 7:12 min\n"
    assert sines.stdout == "3 sines of 12 s: 0:34 min\n"
