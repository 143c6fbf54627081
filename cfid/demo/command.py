"""`cfid demo`: record, fit and report a whole campaign on the simulated rig, whose true values are known."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.progress import Progress

from cfid.console.campaign import make_campaign
from cfid.console.messages import echo, result
from cfid.demo import brushless
from cfid.demo.fits import HANDED_ON, keep_ended, print_comparison, run_command, runs_by_kind
from cfid.demo.recordings import Laboratory, Plan, experiments
from cfid.demo.truth import demo_truth, true_values
from cfid.errors import ConfigError
from cfid.export.target import targets
from cfid.records.campaign import Campaign, open_campaign
from cfid.sim.truth import SimTruth, load_truth

PRINTED = "demo.txt"  # what the demo's commands printed, in the campaign's folder
_AT_ONCE = 2  # fits at a time: one for each processor of a small computer


@dataclass(frozen=True, kw_only=True)
class _Scene:
    """A new campaign, its rig's truth, what is recorded and fitted, and the commands that then hand it on.

    `known` contains the true values by the names of the parameters' numbers; `lasts` states how long all takes.
    """

    campaign: Campaign
    truth: SimTruth
    plan: Plan
    handed_on: Sequence[str]
    known: Mapping[str, float]
    lasts: str


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder to make.")] = Path("cfid-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the rig's parameters and recordings.")] = 1,
    truth: Annotated[
        Path | None, typer.Option(help="TOML file with the true parameters, as for `cfid rig sim`.")
    ] = None,
    platform: Annotated[
        Literal["cf2", "cf21bl"],
        typer.Option(help="cf2: the thesis' rig. cf21bl: a Brushless with thread, scales, a ruler, and flights."),
    ] = "cf2",
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """Simulate a campaign, fit and report it, and compare with the truth.

    The demo has every experiment of the thesis: swings, weights, test body, staircase, tachometer, sines, pings, wind.
    Where the thesis has dozens of settings, the demo has a few, and the load cell samples at 1 kHz (7 kHz for the
    steps).

    With a Brushless, the demo has what its owner can do at home: swings on threads, kitchen scales, and four flights of
    20 s whose logs have the rotors' speeds. It writes every export.

    Example: cfid demo my-demo --seed 7
    """
    if folder.is_dir() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty: delete it, or give another folder.")
    stated = None if truth is None else load_truth(truth)
    scene = (_at_home if platform == "cf21bl" else _in_the_lab)(folder, stated, seed=seed)
    campaign, plan = scene.campaign, scene.plan
    laboratory = Laboratory(campaign, scene.truth, seed=seed)
    count = sum(len(recordings) for recordings, _ in plan)
    # The recordings' commands change the environment meanwhile (typer does): a process that then starts with it reads
    # freed memory.
    run = partial(run_command, folder=campaign.folder, environment=dict(os.environ))
    fits_options = "" if figures else " --no-figures"
    running: list[tuple[str, Future[subprocess.CompletedProcess[str]]]] = []
    echo(f"{count} recordings on the simulated rig (seed {seed}), and their fits: {scene.lasts} ...", err=True)
    # A console of its own, since recordings keep what they print, and no thread, since they redirect it.
    progress = Progress(console=Console(file=sys.stderr), transient=True, auto_refresh=False)
    with ThreadPoolExecutor(_AT_ONCE) as pool, progress, (folder / PRINTED).open("w", encoding="utf-8") as printed:
        task = progress.add_task("recording", total=count)
        try:
            for recordings, fits in plan:
                for recording in recordings:
                    laboratory.make(recording)
                    printed.write(f"$ cfid {recording.words}\n")
                    progress.update(task, completed=laboratory.made, refresh=True)
                names = runs_by_kind(campaign)
                for words in (fit.format(**names) for fit in fits):
                    running.append((words, pool.submit(run, words + fits_options)))
            progress.update(task, description="fitting", refresh=True)
            for words, future in running:
                keep_ended(words, future.result(), printed)
            for words in scene.handed_on:
                keep_ended(words, run(words), printed)
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, KeyboardInterrupt):
                echo(f"\nstopped: {folder} holds a part of the demo; delete it before you start again.", err=True)
            raise
    print_comparison(campaign, scene.known)
    header = folder / "exports" / "cfid_platform_defaults.h"
    result(f"report: {folder / 'report.html'}\nheader: {header}\nwhat the commands printed: {folder / PRINTED}")


def _in_the_lab(folder: Path, stated: SimTruth | None, *, seed: int) -> _Scene:
    make_campaign(folder, seed=seed, kind="simulated")
    campaign, truth = open_campaign(folder), stated or demo_truth(seed)
    return _Scene(
        campaign=campaign,
        truth=truth,
        plan=experiments(truth, seed=seed),
        handed_on=HANDED_ON,
        known=true_values(truth, campaign.rig, seed=seed),
        lasts="about a minute",
    )


def _at_home(folder: Path, stated: SimTruth | None, *, seed: int) -> _Scene:
    brushless.state_measured(make_campaign(folder, seed=seed, kind="owner", platform="cf21bl"))
    campaign, truth = open_campaign(folder), stated or brushless.owned_truth()
    vehicle = brushless.flying(truth, campaign.rig, seed=seed)
    echo("four flights of the simulated Brushless ...", err=True)
    brushless.write_flights(folder, vehicle, seed=seed)
    return _Scene(
        campaign=campaign,
        truth=truth,
        plan=brushless.EXPERIMENTS,
        handed_on=(*(f"export {name}" for name in targets(folder)[0]), "report"),
        known=brushless.true_values(truth, vehicle),
        lasts="a few minutes",
    )
