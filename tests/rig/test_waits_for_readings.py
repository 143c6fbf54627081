"""A command is held for a typed reading as long as the plan allows, then motors pause until the operator resumes."""

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from cfid.records.run import Run
from tests.flying_in_a_folder import Bench, Pilot, bench_in
from tests.rig.test_vehicle_commands import Terminal

pytestmark = pytest.mark.usefixtures("in_time")

HOLD_S, WAIT_S = 0.4, 2.0
TIMES = ("--hold", HOLD_S, "--rest", 0.2, "--wait", WAIT_S, "--yes")
STAIRS = ("--from", 20000, "--to", 30000, "--step", 10000, "--motor", 1, *TIMES)
WIND = ("--angle", 48, "--wind", "2,3", "--fan-voltage", 8, "--commands", "20000,30000", *TIMES)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as bench:
        yield bench


def wait_for_pause(bench: Bench, pilot: Pilot) -> float:
    """Wait until motors ran and are off again; return how long they ran."""
    known = len(bench.history)
    bench.wait_until(
        lambda: any(any(motors) for _, motors in bench.history[known:]) or pilot.process.poll() is not None, pilot
    )
    bench.wait_until(lambda: not any(bench.motors), pilot)
    running = [(time_s, motors[0]) for time_s, motors in bench.history[known - 1 :]]
    begun_s = next(time_s for time_s, command in running if command)
    return running[-1][0] - begun_s


def held(run: Run) -> list[int]:
    """Return the commands of motor 1, without their repetitions."""
    commands = pd.read_csv(run.device_file("commands"))["m1"]
    return [int(command) for command in commands[commands.diff() != 0]]


def check_times(run: Run) -> None:
    """Check that every reading was typed while its command was in force."""
    commands, readings = (pd.read_csv(run.device_file(name)) for name in ("commands", "readings"))
    for row in readings.itertuples():
        assert commands[commands.t <= row.t].m1.iloc[-1] == row.command


def test_motors_pause_where_nobody_answers_and_the_reading_is_asked_again(bench: Bench) -> None:
    terminal = Terminal(bench, "log", "speed", *STAIRS)
    ran_s = wait_for_pause(bench, terminal.pilot)
    terminal.wait_for("Enter resumes")
    paused = len(bench.history)
    time.sleep(1.0)
    assert len(bench.history) == paused
    assert ran_s == pytest.approx(HOLD_S + WAIT_S, abs=0.5)

    terminal.answer(
        ("Enter resumes", "12000"),
        ("RPM at command 20000", "11500"),
        ("RPM at command 30000", "15300"),
        ("Enter ends", ""),
    )
    assert terminal.pilot.end() == 0, terminal.shown
    readings = pd.read_csv(bench.run().device_file("readings"))

    assert "pause in 1 s" in terminal.shown
    assert readings[["command", "rpm"]].to_numpy().tolist() == [[20000, 11500], [30000, 15300]]
    assert held(bench.run()) == [0, 20000, 0, 20000, 0, 30000, 0]
    assert bench.run().header.requested["wait_s"] == WAIT_S
    check_times(bench.run())
    terminal.close()


@pytest.mark.parametrize(
    ("kind", "options", "values"),
    [("scales", STAIRS, (25.0, 20.0)), ("wind", WIND, (11500.0, 15300.0))],
)
def test_a_line_that_a_script_writes_in_the_pause_resumes_and_is_no_reading(
    bench: Bench, kind: str, options: tuple[object, ...], values: tuple[float, float]
) -> None:
    pilot = bench.start("log", kind, *options, stdin=subprocess.PIPE)
    assert wait_for_pause(bench, pilot) == pytest.approx(HOLD_S + WAIT_S, abs=0.5)
    pilot.process.communicate(f"99\n{values[0]:g}\n{values[1]:g}\n".encode())

    assert pilot.process.returncode == 0, pilot.err
    run = bench.run()
    readings = pd.read_csv(run.device_file("readings"))
    assert readings.iloc[:, 1:3].to_numpy().tolist() == [[20000, values[0]], [30000, values[1]]]
    assert held(run) == [0, 20000, 0, 20000, 0, 30000, 0]
    check_times(run)


def test_a_wait_is_refused_where_nothing_is_typed_and_beyond_a_batterys_life(bench: Bench) -> None:
    for options in (("--tachometer", "ut372", "--wait", 5), ("--wait", 3600)):
        pilot = bench.start("log", "speed", "--yes", *options)
        assert pilot.end() == 2, pilot.err
        assert "--wait" in pilot.err
    assert not any(any(motors) for _, motors in bench.history)
