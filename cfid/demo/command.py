"""`cfid demo`: record, fit and report a whole campaign on the simulated rig, whose true values are known."""

import os
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from cfid.console.campaign import make_campaign
from cfid.console.messages import echo, result
from cfid.demo.fits import HANDED_ON, keep_ended, print_comparison, run_command, runs_by_kind
from cfid.demo.recordings import Laboratory, experiments
from cfid.demo.truth import demo_truth, true_values
from cfid.errors import ConfigError
from cfid.records.campaign import open_campaign
from cfid.sim.truth import load_truth

PRINTED = "demo.txt"  # what the demo's commands printed, in the campaign's folder
_AT_ONCE = 2  # fits at a time: one for each processor of a small computer


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder to make.")] = Path("cfid-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the rig's parameters and recordings.")] = 1,
    truth: Annotated[
        Path | None, typer.Option(help="TOML file with the true parameters, as for `cfid rig sim`.")
    ] = None,
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """Simulate a campaign, fit and report it, and compare with the truth.

    The demo has every experiment of the thesis: swings, weights, test body, staircase, tachometer, sines, pings, wind.
    Where the thesis has dozens of settings, the demo has a few, and the load cell samples at 1 kHz (7 kHz for the
    steps).

    Example: cfid demo my-demo --seed 7
    """
    if folder.is_dir() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty: delete it, or give another folder.")
    drawn = demo_truth(seed) if truth is None else load_truth(truth)
    make_campaign(folder, seed=seed, kind="simulated")
    campaign = open_campaign(folder)
    laboratory, plan = Laboratory(campaign, drawn, seed=seed), experiments(drawn, seed=seed)
    count = sum(len(recordings) for recordings, _ in plan)
    # The recordings' commands change the environment meanwhile (typer does): a process that then starts with it reads
    # freed memory.
    run = partial(run_command, folder=campaign.folder, environment=dict(os.environ))
    fits_options = "" if figures else " --no-figures"
    running: list[tuple[str, Future[subprocess.CompletedProcess[str]]]] = []
    echo(f"{count} recordings on the simulated rig (seed {seed}), and their fits: about a minute ...", err=True)
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
            for words in HANDED_ON:
                keep_ended(words, run(words), printed)
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, KeyboardInterrupt):
                echo(f"\nstopped: {folder} holds a part of the demo; delete it before you start again.", err=True)
            raise
    print_comparison(campaign, true_values(drawn, campaign.rig, seed=seed))
    header = folder / "exports" / "cfid_platform_defaults.h"
    result(f"report: {folder / 'report.html'}\nheader: {header}\nwhat the commands printed: {folder / PRINTED}")
