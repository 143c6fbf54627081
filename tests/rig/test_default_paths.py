"""Each command that reaches a vehicle ends well with its default options, on each vehicle that it is for."""

import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

from cfid.records.run import list_runs
from tests.flying_in_a_folder import bench_in

pytestmark = pytest.mark.usefixtures("in_time")

VEHICLES = {
    "app": {"firmware": "app"},
    "stock": {"firmware": "stock"},
    "app, deck": {"firmware": "app", "rpm_deck": True},
    "stock, deck": {"firmware": "stock", "rpm_deck": True},
    "app, Brushless": {"firmware": "app", "platform": "cf21bl"},
    "stock, Brushless": {"firmware": "stock", "platform": "cf21bl"},
}
BARE = ("app", "stock", "app, Brushless", "stock, Brushless")
DECK = ("app, deck", "stock, deck")
BRUSHLESS = ("app, Brushless", "stock, Brushless")
WITH_APP = ("app", "app, Brushless")

STEP = ("--from", 20000, "--to", 20000, "--hold", 0.8, "--rest", 0.5)
ALL = ("--motor", "1,2,3,4")


class Command(NamedTuple):
    """A command's words, what is typed, the vehicles that it is for, and whether motors turn."""

    words: tuple[object, ...]
    typed: bytes = b""
    vehicles: tuple[str, ...] = BARE
    drives: bool = True


COMMANDS = {
    "log thrust": Command((*STEP, *ALL, "--yes")),
    "log speed": Command((*STEP, *ALL, "--yes"), b"12000\n"),
    "log speed --tachometer deck": Command((*STEP, *ALL, "--yes"), vehicles=DECK),
    "log speed --tachometer brushless": Command((*STEP, *ALL, "--yes"), vehicles=BRUSHLESS),
    "log scales": Command((*STEP, *ALL, "--yes"), b"30\n"),
    "log sine": Command(("--l", 8, "--n", 500, "--before", 0.5, "--yes"), vehicles=WITH_APP),
    "log wind": Command(
        ("--wind", 0, "--tachometer", "none", "--commands", 20000, "--hold", 0.8, "--rest", 0.5, "--yes")
    ),
    "log ping": Command(("--count", 5), drives=False),
    "log gyro": Command(("--axis", "x", "--for", 1), drives=False),
    "motors": Command(("--yes",), b"1 2 3 4 20000\n0\n"),
    "motors set": Command((20000, "--for", 0.5, "--yes")),
    "motors stop": Command((), drives=False),
    "rig preflight": Command(("--for", 0.5, "--yes"), vehicles=BARE[1:]),  # with the app: test_preflight
}


@pytest.mark.parametrize(("name", "vehicle"), [(name, one) for name, c in COMMANDS.items() for one in c.vehicles])
def test_a_command_ends_well_with_its_default_options(tmp_path: Path, name: str, vehicle: str) -> None:
    command = COMMANDS[name]
    with bench_in(tmp_path, crazyflie=VEHICLES[vehicle]) as bench:
        pilot = bench.start(*name.split(), *command.words, stdin=subprocess.PIPE)
        pilot.process.communicate(command.typed)
        turned = any(any(motors) for _, motors in bench.history)

        assert pilot.process.returncode == 0, f"{pilot.out}{pilot.err}"
        assert turned == command.drives
        assert not any(bench.motors)
        runs = list_runs(tmp_path / "runs")
        assert [run.header.state for run in runs if not isinstance(run, Exception)] == ["complete"] * len(runs)
        assert len(runs) == name.startswith("log ")
