"""Run the demo's fits with the operator's own commands, and print the true values next to the estimates."""

import math
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TextIO

from cfid.console.messages import echo
from cfid.console.program import cfid_command
from cfid.errors import FitError
from cfid.quantities.rounding import with_std
from cfid.records.campaign import Campaign
from cfid.records.values import Values
from cfid.units import COVERAGE_95

HANDED_ON = ("export firmware", "export crazyflow", "export mujoco", "report")


def run_command(words: str, folder: Path, *, environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a command of cfid as a process of its own in a campaign's folder; return its output and its exit code."""
    command = cfid_command(*words.split())
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def keep_ended(words: str, ended: subprocess.CompletedProcess[str], printed: TextIO) -> None:
    """Write a command and its output into a file. Raises FitError where it failed."""
    printed.write(f"\n$ cfid {words}\n{ended.stdout}{ended.stderr}")
    if ended.returncode:
        raise FitError(f"cfid {words} failed: {ended.stderr.strip()}")


def runs_by_kind(campaign: Campaign) -> dict[str, list[str]]:
    """Return the names of the campaign's runs by kind, in the order of recording."""
    names: dict[str, list[str]] = {}
    for run in campaign.runs(complete=False):
        names.setdefault(run.header.kind, []).append(run.folder.name)
    return names


def print_comparison(campaign: Campaign, truth: Mapping[str, float]) -> None:
    """Print the true value next to every estimate, and which 95 % intervals do not contain it."""
    rows = list(compared(campaign.values(), truth))
    width = max(len(name) for name, *_ in rows)
    echo(f"{'':<{width}}  {'truth':>11}  measured")
    for name, true, value, std in rows:
        beyond = "" if covers(true, value, std) else "  beyond 95 %"
        echo(f"{name:<{width}}  {true:>11.5g}  {with_std(value, std)}{beyond}")
    inside = sum(covers(true, value, std) for _, true, value, std in rows)
    missed = "" if inside == len(rows) else "; such an interval misses one time in twenty, numbers of one fit together"
    echo(f"{inside} of {len(rows)} true values lie in the 95 % intervals{missed}")


def compared(values: Values, truth: Mapping[str, float]) -> Iterator[tuple[str, float, float, float | None]]:
    """Return name, true value, estimate and standard uncertainty of every number whose true value is known."""
    numbers = {
        number.name: (number.value, number.std)
        for quantity in values
        for number in quantity.parameter.numbers(quantity.key)
        if number.value is not None
    }
    for name in (name for name in truth if name in numbers):
        yield name, truth[name], *numbers[name]


def covers(true: float, value: float, std: float | None) -> bool:
    """Return whether the 95 % interval of an estimate contains the true value."""
    return std is not None and math.isclose(true, value, rel_tol=0, abs_tol=COVERAGE_95 * std)
