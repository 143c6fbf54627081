"""Unusable recordings: each fault is reported during the recording, or by the verdict at its end."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.virtual_bench import Bench, bench_in

STAIRS = ("thrust", "--from", 20000, "--to", 32000, "--step", 4000, "--hold", 3, "--rest", 1, "--yes")
SINE = ("sine", "--hz", 20, "--for", 2, "--yes")


def scaled(*factors: float) -> Callable[[Bench], None]:
    """Return a function that multiplies the load on each axis of the load cell by its factor."""

    def spoil(bench: Bench) -> None:
        cell = bench.rig.loadcell.box.load_cell
        read = cell.read
        cell.read = lambda time_s, wrench: read(time_s, np.array(factors) * wrench)  # type: ignore[method-assign]

    return spoil


def overload(bench: Bench) -> None:
    bench.rig.loadcell.box.load_cell.overload()


def empty(bench: Bench) -> None:
    bench.vehicle_suffers(low_battery_after_s=0)


@pytest.mark.parametrize(
    ("words", "spoil", "during", "verdict"),
    [
        (STAIRS, scaled(1, 1, 0, 1, 1, 1), "no thrust is felt at command 20000", "no motor is felt"),
        (STAIRS, overload, "saturation", "saturation"),
        (SINE, scaled(0, 0, 0, 0, 0, 0), "", "does not measure it"),
        (STAIRS, empty, "2.90 V", "2.90 V"),
    ],
    ids=["a dead axis", "a cell beyond its range", "a sine not felt", "an empty battery"],
)
def test_a_fault_beside_running_motors_is_named_and_they_stop(
    tmp_path: Path,
    words: tuple[object, ...],
    spoil: Callable[[Bench], None],
    during: str,
    verdict: str,
) -> None:
    with bench_in(tmp_path) as bench:
        pilot = bench.start("log", *words, "--json")
        pilot.wait_until_motors_run(0.0)
        spoil(bench)
        pilot.end()
        found = bench.run().header.verdict

    assert not any(bench.motors)
    assert during in pilot.err
    assert found is not None
    assert verdict in found.text
