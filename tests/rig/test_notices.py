"""What is wrong in the first steps of a recording is said there, and the operator may end the recording."""

import os
import pty
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.motors.record import Steps
from tests.virtual_bench import Bench, bench_in

Array = npt.NDArray[np.float64]

STAIRS = ("log", "thrust", "--from", 20000, "--to", 30000, "--step", 5000, "--hold", 1.4, "--rest", 0.4, "--yes")
BLOCK_S, RATE_HZ = 0.05, 700


def staircase(thrust_n: Any) -> list[str]:
    """Return the notes about three steps of 3 s, block by block; `thrust_n` takes the seconds since a step began."""
    steps, rng, said = Steps(1e6), np.random.default_rng(1), []
    for k, command in enumerate((0, 20000, 0, 25000, 0, 30000, 0)):
        said.append(steps("commands", [np.array([10.0 * k]), *np.full((4, 1), command)]))
        for since_s in np.arange(0, 3.0, BLOCK_S):
            force = (thrust_n(since_s) if command else 0.0) + rng.normal(0.3, 0.02, int(BLOCK_S * RATE_HZ))
            said.append(steps("loadcell", [np.zeros(len(force)), *[1e6 * force] * 6]))
    return [text for text in said if text]


@pytest.mark.parametrize(
    ("thrust_n", "named"),
    [
        (lambda since_s: 0.1 * (1 - np.exp(-since_s / 0.06)), []),
        (lambda since_s: 0.1 * (1 - np.exp(-since_s / 3.0)), ["20000 does not settle", "25000 does not settle"]),
        (lambda since_s: 0.0, ["no thrust is felt at command 20000"]),
    ],
    ids=["settles", "does not", "not felt"],
)
def test_steps_that_do_not_settle_or_are_not_felt_are_said_once_after_the_second(
    thrust_n: Any, named: list[str]
) -> None:
    said = staircase(thrust_n)

    assert len(said) == bool(named)
    assert all(text in said[0] for text in named)
    assert not any("30000" in text for text in said)


def deafen(bench: Bench) -> None:
    """Let the load cell feel nothing from now on."""
    cell = bench.rig.loadcell.box.load_cell
    read = cell.read

    def deaf(time_s: Array, wrench: Array) -> Any:
        return read(time_s, 0 * wrench)

    cell.read = deaf  # type: ignore[method-assign]


@pytest.mark.parametrize(("key", "state"), [(b"n", "interrupted"), (b"y", "complete"), (b"", "complete")])
def test_at_a_terminal_n_ends_the_recording_and_a_script_goes_on(tmp_path: Path, key: bytes, state: str) -> None:
    operator, terminal = pty.openpty()
    with bench_in(tmp_path, battery={"kind": "lipo"}) as bench, os.fdopen(terminal, encoding="utf-8") as stdin:
        deafen(bench)
        pilot = bench.start(*STAIRS, "--no-preflight", stdin=stdin if key else None)
        pilot.wait_until_said("no thrust is felt at command 20000")
        os.write(operator, key)
        assert pilot.end() == 0, pilot.err
        run = bench.run()
    os.close(operator)

    assert pilot.err.count("felt at command 20000") == 1
    assert ("n ends it" in pilot.err) == bool(key)
    assert run.header.state == state
    assert ("operator" in run.header.reason) == (state == "interrupted")
    assert not any(bench.motors)
