"""Motors that something else drives end a command, whichever way they are driven, and what drives them is named."""

import json
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest

from cfid.rig.motors import MAY_BE_RUNNING
from cfid.sim.crazyflie_services import parameters
from tests.flying_in_a_folder import Bench, bench_in

THRUST = 25000
VEHICLES: dict[str, dict[str, Any]] = {
    "app": {"firmware": "app"},
    "stock": {"firmware": "stock"},
    "brushless": {"platform": "cf21bl"},
}
HOLD = ("motors", "set", 30000, "--yes", "--for")
STAIRS = ("log", "thrust", "--motor", "1,2,3,4", "--from", 20000, "--to", 30000, "--step", 10000, "--yes")
QUICK = ("--hold", 1, "--rest", 1)


@pytest.fixture(params=VEHICLES)
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path, crazyflie=VEHICLES[request.param]) as bench:
        yield bench


@contextmanager
def setpoints(bench: Bench, *, arm: bool = True) -> Iterator[None]:
    """Stream setpoints as a second client of the vehicle does; one that has to be armed is armed first."""
    ended = Event()
    address, port = bench.uri.removeprefix("udp://").split(":")

    def stream() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.connect((address, int(port)))
            thrust = 0
            while not ended.wait(0.05):
                client.send(b"\x30" + struct.pack("<fffH", 0, 0, 0, thrust))
                thrust = THRUST

    if arm:
        bench.in_loop(lambda: bench.rig.crazyflie.vehicle.receive(b"\x9d\1\1", time.monotonic()))
        time.sleep(0.6)
    thread = Thread(target=stream)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def overridden(bench: Bench, *commands: int) -> None:
    """Set the parameters motorPowerSet as another program does."""
    names = [parameter.name for parameter in parameters(rpm_deck=False)]
    values = [(f"m{motor}", struct.pack("<H", command)) for motor, command in enumerate(commands, 1)]
    for name, value in (*values, ("enable", b"\1")):
        write = b"\x2e" + struct.pack("<H", names.index(f"motorPowerSet.{name}")) + value
        bench.in_loop(partial(bench.rig.crazyflie.vehicle.receive, write, time.monotonic()))


def until_motors_run(bench: Bench) -> None:
    end_s = time.monotonic() + 20
    while max(bench.motors) < THRUST:
        assert time.monotonic() < end_s
        time.sleep(0.01)


def checked(bench: Bench) -> dict[str, str]:
    """Return the answer of `rig check` about the supervisor."""
    check = bench.start("rig", "check", "--json")
    check.end()
    (answer,) = [one for one in json.loads(check.out)["devices"]["crazyflie"] if one["asked"] == "supervisor"]
    return dict(answer)


@pytest.mark.parametrize("words", [(*HOLD, 1), (*STAIRS, *QUICK)])
def test_a_command_does_not_start_motors_while_another_client_flies_the_vehicle(
    bench: Bench, words: tuple[object, ...]
) -> None:
    with setpoints(bench):
        until_motors_run(bench)
        driven = bench.motors
        refused = bench.start(*words)
        assert refused.end() == 3, refused.out
        assert "setpoints" in refused.err
        assert str(driven[0]) in refused.err
        assert {motors for _, motors in bench.history} <= {(0,) * 4, (7000,) * 4, driven}
        answer = checked(bench)
        assert answer["state"] == "fault"
        assert "setpoints" in answer["advice"]
    assert not list(bench.folder.glob("runs/*"))


@pytest.mark.parametrize("firmware", ["app", "stock"])  # a stop disarms a Brushless, which ends its setpoints' effect
@pytest.mark.parametrize("words", [(*HOLD, 2), (*STAIRS, *QUICK)])
def test_a_command_whose_motors_another_client_drives_does_not_confirm_their_stop(
    tmp_path: Path, firmware: str, words: tuple[object, ...]
) -> None:
    """With the app, whose null setpoints compete with the client's, motors run in pulses after the stop."""
    with bench_in(tmp_path, crazyflie={"firmware": firmware}) as bench:
        pilot = bench.start(*words)
        pilot.wait_until_motors_run()
        with setpoints(bench, arm=False):
            assert pilot.end() == 3, pilot.out
            assert MAY_BE_RUNNING in pilot.err
            assert "setpoints" in pilot.err
            assert "motors stopped" not in pilot.out


def test_motors_that_turn_in_a_runs_pause_end_it(tmp_path: Path) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        pilot = bench.start(*STAIRS, "--hold", 1, "--rest", 15)
        pilot.wait_until_motors_run()
        with setpoints(bench, arm=False):
            until_motors_run(bench)
            began_s = time.monotonic()
            assert pilot.end() == 3
            assert time.monotonic() - began_s < 10
        assert bench.run().header.state == "failed"


@pytest.mark.parametrize("commands", [(22000, 0, 0, 0), (0, 0, 0, 0)])
def test_overriding_parameters_that_another_program_left_on_are_named_before_a_motor_starts(
    bench: Bench, commands: tuple[int, ...]
) -> None:
    overridden(bench, *commands)
    answer = checked(bench)
    assert answer["state"] == "fault"
    assert "motorPowerSet" in answer["advice"]
    for words in ((*HOLD, 1), (*STAIRS, *QUICK)):
        refused = bench.start(*words)
        assert refused.end() == 3, refused.out
        assert "motorPowerSet" in refused.err
        assert "cfid motors stop" in refused.err
    assert {motors for _, motors in bench.history} <= {(0,) * 4, commands}
    assert bench.start("motors", "stop").end() == 0
    assert checked(bench)["state"] == "ok"


def test_overriding_parameters_end_a_command_that_drives_the_motors(bench: Bench) -> None:
    pilot = bench.start(*HOLD, 60)
    pilot.wait_until_motors_run(0.5)
    overridden(bench, 22000, 0, 0, 0)
    assert pilot.end() == 3
    assert "motorPowerSet" in pilot.err
    assert not any(bench.motors)


def test_overriding_parameters_end_a_sine(tmp_path: Path) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("log", "sine", "--motor", 1, "--l", 100, "--n", 20000, "--yes")
        pilot.wait_until_motors_run(0.5)
        overridden(bench, 0, 22000, 0, 0)
        assert pilot.end() == 3, pilot.out
        assert "motorPowerSet" in pilot.err
        assert not any(bench.motors)


def test_motors_that_stand_still_against_their_command_end_it(bench: Bench) -> None:
    pilot = bench.start(*HOLD, 60)
    pilot.wait_until_motors_run(0.5)
    overridden(bench, 0, 0, 0, 0)
    assert pilot.end() == 3
    assert "motorPowerSet" in pilot.err


def test_motors_of_a_killed_command_are_not_taken_for_a_calm_vehicle(tmp_path: Path) -> None:
    """Stock firmware runs them on: version 0.2 recorded another motor beside them, and took its bias from them."""
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        killed = bench.start("motors", "set", 20000, "--motor", 1, "--yes")
        killed.wait_until_motors_run()
        killed.process.kill()
        killed.process.wait()
        assert checked(bench)["state"] == "fault"
        refused = bench.start("log", "thrust", "--motor", 2, *STAIRS[4:], *QUICK)
        assert refused.end() == 3, refused.out
        assert "cfid motors stop" in refused.err
        assert bench.motors == (20000, 0, 0, 0)


def test_a_vehicle_whose_motors_just_stopped_is_ready_once_it_has_landed(bench: Bench) -> None:
    """It counts as flying for two seconds more, which version 0.2 called ok."""
    assert bench.start(*HOLD, 0.5).end() == 0
    answer = checked(bench)
    assert answer["state"] == "ok"
    assert answer["answer"] != "flying"
