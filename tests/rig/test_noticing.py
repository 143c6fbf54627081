"""Faults during a recording are reported within its first steps, and the operator may end it there."""

import math
import os
import pty
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.motors.during import Steps
from cfid.records.rig_file import EncoderLines, LineValue
from cfid.swing.during import Release
from cfid.transfer.sines.during import Felt
from tests.flying_in_a_folder import Bench, bench_in

pytestmark = pytest.mark.usefixtures("in_time")

Array = npt.NDArray[np.float64]

STAIRS = ("log", "thrust", "--from", 20000, "--to", 40000, "--step", 5000, "--hold", 1.6, "--rest", 0.6, "--yes")
FULL: dict[str, Any] = {"battery": {"kind": "lipo"}}
BLOCK_S, RATE_HZ = 0.05, 700


def staircase(hold_s: float, thrust_n: Any) -> list[str]:
    """Return the notes about three steps, block by block; `thrust_n` takes the seconds since a step began."""
    steps, rng, said = Steps(1e6), np.random.default_rng(1), []
    for k, command in enumerate((0, 20000, 0, 25000, 0, 30000, 0)):
        said.append(steps("commands", [np.array([10.0 * k]), *np.full((4, 1), command)]))
        for since_s in np.arange(0, hold_s, BLOCK_S):
            force = (thrust_n(since_s) if command else 0.0) + rng.normal(0.3, 0.02, int(BLOCK_S * RATE_HZ))
            said.append(steps("loadcell", [np.zeros(len(force)), *[1e6 * force] * 6]))
    return [text for text in said if text]


def test_a_staircase_that_settles_is_left_in_peace() -> None:
    assert staircase(3.0, lambda since_s: 0.1 * (1 - np.exp(-since_s / 0.06))) == []


def test_steps_that_do_not_settle_are_said_once_after_the_second() -> None:
    (said,) = staircase(3.0, lambda since_s: 0.1 * (1 - np.exp(-since_s / 3.0)))

    assert said.startswith("command 20000 does not settle: between the last quarters of its hold Fz changes by ")
    assert "command 25000 does not settle" in said
    assert "command 30000" not in said


def test_motors_that_the_cell_does_not_feel_are_said() -> None:
    (said,) = staircase(3.0, lambda since_s: 0.0)

    assert said.startswith("no thrust is felt at command 20000: ")


def sine(amplitude_n: float) -> tuple[list[str], float]:
    """Return the note about a sine of 2 Hz, and its time in s after the first report."""
    felt, rng = Felt(2 * np.pi * 2.0, 1e6), np.random.default_rng(2)
    for begin_s in np.arange(0.0, 8.0, BLOCK_S):
        if abs(begin_s - 1.0) < 1e-9:
            assert felt("crossings", [np.array([1.0])]) == ""
        time_s = begin_s + np.arange(35) / RATE_HZ
        force = 0.5 + amplitude_n * np.sin(4 * np.pi * time_s + 0.7) + rng.normal(0, 0.02, 35)
        if text := felt("loadcell", [time_s, *[1e6 * force] * 6]):
            return [text], begin_s - 1.0
    return [], float("nan")


def test_a_sine_that_the_cell_does_not_feel_is_said_within_three_seconds() -> None:
    (said,), after_s = sine(0.0)

    assert said.startswith("the load cell does not feel it: ")
    assert after_s < 3.0
    assert sine(0.02)[0] == []


def swing(angle_deg: Any, turn: float = 8192) -> list[tuple[float, str]]:
    release = Release(turn)
    said = []
    for begin_s in np.arange(0.0, 40.0, BLOCK_S):
        time_s = begin_s + np.arange(0, BLOCK_S, 0.001)
        angles = turn * (angle_deg(time_s) / 360 + 0.999) % turn  # across the turn's end
        if text := release("encoder", [time_s, np.rint(angles).astype(np.int64) if turn == 8192 else angles]):
            said.append((begin_s, text))
    return said


def test_a_swing_without_a_release_is_said_once_and_a_late_one_is_none() -> None:
    ((after_s, said),) = swing(lambda time_s: 0.3 * np.sin(time_s))

    assert 19 < after_s < 21
    assert "no release within 20 s: the angle moved by 0.6 degrees" in said
    assert swing(lambda time_s: np.where(time_s > 15, 20 * np.cos(8 * (time_s - 15)), 20.0)) == []


@pytest.mark.parametrize(("unit", "turn"), [("deg", math.tau), ("rad", math.tau), ("counts", 4096)])
def test_a_swing_without_a_release_is_said_of_an_encoder_that_sends_lines(unit: str, turn: float) -> None:
    setting = EncoderLines(kind="lines", port="port", rate_hz=100, values=(LineValue(name="phi", unit=unit),))
    ((after_s, said),) = swing(lambda time_s: 0.3 * np.sin(time_s), turn=float(setting.turn(4096)))

    assert setting.turn(4096) == turn
    assert 19 < after_s < 21
    assert "the angle moved by 0.6 degrees" in said


# Over real wires


def deafen(bench: Bench) -> None:
    """Let the load cell feel nothing from now on."""
    cell = bench.rig.loadcell.box.load_cell
    read = cell.read

    def deaf(time_s: Array, wrench: Array) -> Any:
        return read(time_s, 0 * wrench)

    cell.read = deaf  # type: ignore[method-assign]


@pytest.mark.parametrize("words", [STAIRS], ids=["thrust"])
def test_a_script_gets_the_sentence_and_goes_on(tmp_path: Path, words: Sequence[object]) -> None:
    with bench_in(tmp_path, **FULL) as bench:
        bench.in_loop(lambda: deafen(bench))
        pilot = bench.start(*words)
        assert pilot.end() == 0, pilot.err
        run = bench.run()
    assert pilot.err.count("note: no thrust is felt at command 20000") == 1
    assert "n ends it" not in pilot.err
    assert run.header.state == "complete"


@pytest.mark.parametrize(("key", "state"), [(b"n", "interrupted"), (b"y", "complete")])
def test_at_a_terminal_n_ends_the_recording_and_y_goes_on(tmp_path: Path, key: bytes, state: str) -> None:
    end, pilots_end = pty.openpty()
    with bench_in(tmp_path, **FULL) as bench:
        bench.in_loop(lambda: deafen(bench))
        pilot = bench.start(*STAIRS, stdin=pilots_end)
        os.close(pilots_end)
        bench.wait_until(lambda: "n ends it" in pilot.err or pilot.process.poll() is not None, pilot)
        os.write(end, key)
        assert pilot.end() == 0, pilot.err
        os.close(end)
        run, still = bench.run(), bench.motors
    assert run.header.state == state
    assert ("ended by the operator" in run.header.reason) == (state == "interrupted")
    assert not any(still)
