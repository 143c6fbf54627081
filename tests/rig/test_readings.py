"""Readings that an operator or a script types, or a device shows, while motors are held for them."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from cfid.motors.plan import WAIT_S
from cfid.recordings.vehicle import read_rows
from cfid.records.files import RIG_FILE
from cfid.records.run import Run
from cfid.sim.faults import SOUND_ENCODER, FaultySerial
from cfid.sim.propulsion import Four
from tests.virtual_bench import Bench, Pilot, bench_in
from tests.virtual_lab import Board

TYPED = ("--from", 20000, "--to", 40000, "--step", 10000, "--hold", 0.2, "--rest", 0.1, "--yes")
SPEEDS = ((20000, "11500"), (30000, "15300"), (40000, "19000"))


@pytest.fixture
def bench(tmp_path: Path) -> Any:
    with bench_in(tmp_path) as bench:
        yield bench


class Terminal:
    """A terminal at which a recording asks for readings."""

    def __init__(self, bench: Bench, *words: object) -> None:
        self.pilot = bench.start(*words, terminal=True, screen=True)
        self._answered = 0  # number of characters shown before the last answer

    def wait_for(self, text: str) -> None:
        """Wait until a text is shown that was not yet shown at the last answer."""
        self.pilot.wait_until(lambda: text in self.pilot.err[self._answered :], text)

    def answer(self, *answers: tuple[str, str]) -> None:
        """Type lines, each once its question is shown; a question must come after the previous answer."""
        for question, line in answers:
            self.wait_for(question)
            self._answered = len(self.pilot.err)
            self.pilot.type(f"{line}\n")

    def read(self, *readings: tuple[int, str]) -> None:
        self.answer(*((f"RPM at command {command}", value) for command, value in readings))


def readings(run: Run) -> list[list[float]]:
    """Return the readings that count, each with its command."""
    columns = read_rows(run, "readings").columns
    return [list(row) for row in zip(columns["command"], columns[list(columns)[-1]], strict=True)]


def held(run: Run) -> list[int]:
    """Return the commands of motor 1, without their repetitions."""
    commands = pd.read_csv(run.device_file("commands"))["m1"]
    return [int(command) for command in commands[commands.diff() != 0]]


def stopped(run: Run) -> bool:
    return (run.header.devices["commands"].model_extra or {}).get("stopped_in_s") is not None


# A script


@pytest.mark.parametrize(
    ("kind", "typed", "expected"),
    [
        ("speed", "12000\n\n15000.5\n", [[20000, 12000], [30000, 15000.5]]),
        (
            "scales",
            "u\n12\nundo\n30\n25\n60\n31\n26\n",
            [[30000, 30], [20000, 25], [40000, 60], [30000, 31], [20000, 26]],
        ),
        ("speed", "11500\n19000\n9000\nu\n15300\n23000\n", [[20000, 11500], [40000, 19000], [30000, 15300]]),
    ],
    ids=["one left out", "one taken back", "the last taken back"],
)
def test_a_script_types_readings_and_takes_them_back(
    bench: Bench, kind: str, typed: str, expected: list[list[float]]
) -> None:
    pilot = bench.start("log", kind, *TYPED, typed=typed)
    assert pilot.end() == 0, pilot.err
    assert readings(bench.run()) == expected
    assert bench.run().header.state == "complete"
    on_disk = pd.read_csv(bench.run().device_file("readings"))
    assert 2 * on_disk.withdrawn.sum() == len(on_disk) - len(expected)  # one taken back is two rows


# A terminal


def test_an_implausible_reading_counts_once_it_is_typed_twice(bench: Bench) -> None:
    terminal = Terminal(bench, "log", "speed", *TYPED)
    terminal.read((20000, "250000"))
    terminal.answer(("to keep it", "11500"))
    terminal.read((40000, "999999"))
    terminal.answer(("to keep it", "999999"))
    terminal.read(SPEEDS[1])
    terminal.answer(("Enter ends", ""))
    assert terminal.pilot.end() == 0
    assert [value for _, value in readings(bench.run())] == [11500, 999999, 15300]


@pytest.mark.parametrize("ended", ["Ctrl-D", "hung up"])
def test_input_that_ends_at_a_reading_stops_the_motors(bench: Bench, ended: str) -> None:
    """A terminal that is closed ends the recording as SIGHUP does."""
    terminal = Terminal(bench, "log", "speed", *TYPED)
    terminal.wait_for("RPM at command 20000")
    assert any(bench.motors)
    keyboard = terminal.pilot.keyboard
    assert keyboard is not None
    if ended == "Ctrl-D":
        keyboard.type("\x04")
    else:
        keyboard.hang_up()
    code, state = (2, "failed") if ended == "Ctrl-D" else (0, "interrupted")
    assert terminal.pilot.end() == code
    assert not any(bench.motors)
    assert stopped(bench.run())
    assert bench.run().header.state == state


# A reading that nobody types

HOLD_S = 0.4
TIMES = ("--hold", HOLD_S, "--rest", 0.2, "--yes")
STAIRS = ("--from", 20000, "--to", 30000, "--step", 10000, "--motor", 1, *TIMES)


def wait_for_pause(bench: Bench, pilot: Pilot) -> None:
    """Wait until motors ran, for as long as they are held for a reading."""
    pilot.wait_until_motors_run(0.0)
    begun_s = bench.history[-1][0]
    pilot.wait_until(lambda: not any(bench.motors), "a pause")
    assert bench.history[-1][0] - begun_s == pytest.approx(HOLD_S + WAIT_S, abs=0.05)


def check_times(run: Run) -> None:
    """Check that every reading was typed while its command was in force, and that one step was held twice."""
    commands, typed = (pd.read_csv(run.device_file(name)) for name in ("commands", "readings"))
    for row in typed.itertuples():
        assert commands[commands.t < row.t].m1.iloc[-1] == row.command
    assert held(run) == [0, 20000, 0, 20000, 0, 30000, 0]


def test_motors_pause_where_nobody_answers_and_the_reading_is_asked_again(bench: Bench) -> None:
    terminal = Terminal(bench, "log", "speed", *STAIRS)
    wait_for_pause(bench, terminal.pilot)
    terminal.wait_for("Enter resumes")
    paused = len(bench.history)
    terminal.pilot.go_on_for(5.0)
    assert len(bench.history) == paused
    terminal.answer(("Enter resumes", "12000"))
    terminal.read(*SPEEDS[:2])
    terminal.answer(("Enter ends", ""))
    assert terminal.pilot.end() == 0
    assert readings(bench.run()) == [[20000, 11500], [30000, 15300]]
    assert bench.run().header.requested["wait_s"] == WAIT_S
    check_times(bench.run())


# Devices that show speed or weight

STAIRCASE = ("--from", 20000, "--to", 50000, "--step", 10000, "--hold", 1.5, "--rest", 0.8, "--yes")
IDLE_RAD_PER_S, RAD_PER_S_PER_COMMAND = 381.0, 0.0408  # of the simulated rotors


def serve(bench: Bench, name: str, line: Callable[[Four], str]) -> str:
    """Plug in a device that sends twenty lines a second, which depend on the motors' commands; return its port."""
    board = Board(lambda n: f"{line(bench.motors)}\r\n".encode(), rate_hz=20)
    path = f"/virtual/{name}-{bench.uri[6:]}"
    bench.hardware.plug_in(path, FaultySerial(board, SOUND_ENCODER, opened_s=bench.hardware.seconds()))
    return path


def state(bench: Bench, name: str, value: str, line: Callable[[Four], str], more: str = "") -> None:
    """Plug in such a device, and state it in rig.toml."""
    port = serve(bench, name, line)
    with (bench.folder / RIG_FILE).open("a") as file:
        file.write(
            f"\n[devices.{name}]\nkind = 'lines'\nport = '{port}'\nrate_hz = 20\n"
            f"values = [{{ name = '{value}' }}]\n{more}\n"
        )


def rpm(motors: Four) -> float:
    """Return what a tachometer shows of a rotor; the last speed stays on display while the rotor stands."""
    return (IDLE_RAD_PER_S + RAD_PER_S_PER_COMMAND * (motors[0] or 50000)) * 60 / math.tau


@pytest.mark.parametrize("markers", [1, 2])
def test_a_speed_map_is_fitted_to_what_a_tachometer_sent_by_its_own_markers(bench: Bench, markers: int) -> None:
    """One device sends the rotor's speed and one counts both blades, while a hand-held one has two markers."""
    state(bench, "tachometer", "rpm", lambda motors: f"{markers * rpm(motors):.1f}", f"markers = {markers}")
    pilot = bench.start("log", "speed", "--tachometer", "lines", *STAIRCASE)
    assert pilot.end() == 0, pilot.err
    fit = bench.start("fit", "speed", bench.run().folder, "--json", "--no-figures")
    assert fit.end() == 0, fit.err
    slope, offset = json.loads(fit.out)["parameters"]["motor.speed_poly"]["value"]
    assert slope == pytest.approx(RAD_PER_S_PER_COMMAND, rel=1e-3)
    assert offset == pytest.approx(IDLE_RAD_PER_S, rel=1e-3)


@pytest.mark.parametrize(("name", "value", "command"), [("tachometer", "rpm", "speed"), ("scales", "grams", "scales")])
def test_a_plug_that_is_pulled_while_motors_run_stops_them_and_fails_the_run(
    bench: Bench, name: str, value: str, command: str
) -> None:
    state(bench, name, value, lambda motors: f"{rpm(motors):.1f}", "markers = 1" if command == "speed" else "")
    tachometer = ("--tachometer", "lines") if command == "speed" else ()
    pilot = bench.start("log", command, *tachometer, *STAIRCASE)
    pilot.wait_until_motors_run(0.5)
    pulled_s = bench.hardware.seconds()
    bench.hardware.ports[f"/virtual/{name}-{bench.uri[6:]}"].unplug()
    assert pilot.end() == 3
    assert bench.run().header.state == "failed"
    assert bench.stopped_after(pulled_s) < 0.7


def test_no_motor_starts_before_a_line_of_the_tachometer_matches(bench: Bench) -> None:
    state(bench, "tachometer", "rpm", lambda _: "28187500,83943", "markers = 1")
    pilot = bench.start("log", "speed", "--tachometer", "lines", *STAIRCASE)
    assert pilot.end() == 3, pilot.err
    assert held(bench.run()) == [0]
    assert len(bench.history) == 1
    assert "devices.tachometer" in pilot.err


def thrust_n(command: int) -> float:
    return 1.8e-8 * (IDLE_RAD_PER_S + RAD_PER_S_PER_COMMAND * command) ** 2 if command else 0.0


def grams(motors: Four) -> float:
    return 50 - 1e3 * sum(map(thrust_n, motors)) / 9.81
