"""Run the demo's fits with the operator's own commands, and print the true values next to the estimates."""

import math
import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Self

from rich.console import Console
from rich.table import Table

from cfid.console.messages import echo, headline, result
from cfid.console.processes import cfid_command
from cfid.errors import FitError
from cfid.quantities.rounding import value_and_std
from cfid.records.campaign import Campaign
from cfid.records.run import Run, list_runs
from cfid.records.values import Values
from cfid.units import COVERAGE_95

_AT_ONCE = 2  # fits at a time: one for each processor of a small computer

FITS_OVER_WIRES = (
    "fit swing {swing[0]}",
    "fit thrust {thrust[0]}",
    "fit torque {thrust[0]}",
    "tf identify",
    "tf latency {ping[0]}",
)
HANDED_ON = ("export firmware", "export crazyflow", "export mujoco", "report")


class Commands:
    """Commands of cfid in processes of their own, two at a time; as a context manager, it ends those that still run."""

    def __init__(self, campaign: Campaign, *, figures: bool) -> None:
        """Take the campaign that the commands are run in."""
        self._campaign = campaign
        self._processes = _Processes(campaign, figures=figures)
        self._pool = ThreadPoolExecutor(_AT_ONCE)
        self._running: list[tuple[str, Future[tuple[int, str, str]]]] = []

    def start(self, commands: Sequence[str]) -> None:
        """Begin commands as soon as there is room; run names replace names of kinds."""
        names = runs_by_kind(self._campaign)
        for words in (command.format(**names) for command in commands):
            self._running.append((words, self._pool.submit(self._processes.run, words)))

    def finish(self) -> None:
        """Wait for all, and print their output in order. Raises FitError, which names the command that failed."""
        running, self._running = self._running, []
        for words, output in running:
            _print_output(words, *output.result())

    def __enter__(self) -> Self:
        """Return the commands."""
        return self

    def __exit__(self, *_: object) -> None:
        """End those that still run."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._processes.end()


class _Processes:
    """Commands of cfid, each in a separate process, in the campaign's folder."""

    def __init__(self, campaign: Campaign, *, figures: bool) -> None:
        """Prepare to run commands, without starting a process."""
        self._folder, self._drawn = campaign.folder, [] if figures else ["--no-figures"]
        # The recordings' commands change the environment meanwhile (typer does): a process that then starts with it
        # reads freed memory.
        self._environment = dict(os.environ)
        self._started: list[subprocess.Popen[str]] = []

    def run(self, words: str) -> tuple[int, str, str]:
        """Run a command until it ends; return its exit code, stdout and stderr."""
        drawn = self._drawn if words.startswith(("fit", "tf")) else []
        process = subprocess.Popen(
            cfid_command(*words.split(), *drawn),
            cwd=self._folder,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._started.append(process)
        out, err = process.communicate()
        return process.returncode, out, err

    def end(self) -> None:
        """End the processes that still run."""
        for process in self._started:
            process.terminate()


def _print_output(words: str, code: int, out: str, err: str) -> None:
    headline(f"\n$ cfid {words}")
    echo(out, nl=False)
    if code:
        raise FitError(f"cfid {words} failed: {err.strip()}")


def runs_by_kind(campaign: Campaign) -> dict[str, list[str]]:
    """Return the names of the campaign's runs by kind, in the order of recording."""
    found: dict[str, list[str]] = {}
    for run in list_runs(campaign.runs_folder):
        if isinstance(run, Run):
            found.setdefault(run.header.kind, []).append(run.folder.name)
    return found


def print_comparison(campaign: Campaign, truth: Mapping[str, float]) -> None:
    """Print the true value next to every estimate, and whether the 95 % interval contains it."""

    table = Table(title="true values of the simulation and estimates", title_justify="left")
    table.add_column("parameter", overflow="fold")
    for heading in ("truth", "estimate", "std", "in 95 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    rows = list(compared(campaign.values(), truth))
    for name, true, value, std in rows:
        table.add_row(name, f"{true:.5g}", *value_and_std(value, std), "yes" if covers(true, value, std) else "no")
    Console().print(table)
    inside = sum(covers(true, value, std) for _, true, value, std in rows)
    result(
        f"{inside} of {len(rows)} lie in their 95 % interval. 'no' is no failure: a 95 % interval misses one time in "
        "twenty, and numbers of one fit miss together. `--seed` draws another lab."
    )


def compared(values: Values, truth: Mapping[str, float]) -> Iterator[tuple[str, float, float, float | None]]:
    """Return name, true value, estimate and standard uncertainty of every number whose true value is known."""
    found = {
        number.name: (number.value, number.std)
        for value in values
        for number in value.parameter.numbers(value.key)
        if number.value is not None
    }
    for name, true in truth.items():
        if name in found:
            yield name, true, *found[name]


def covers(true: float, value: float, std: float | None) -> bool:
    """Return whether the 95 % interval of an estimate contains the true value."""
    return std is not None and math.isclose(true, value, rel_tol=0, abs_tol=COVERAGE_95 * std)
