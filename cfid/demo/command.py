"""`cfid demo`: record, fit and report a whole campaign on the simulated rig, whose true values are known."""

import os
import subprocess
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from cfid.console.campaign import make_campaign
from cfid.console.messages import echo, result
from cfid.demo.fits import HANDED_ON, print_comparison, print_ended, run_command, runs_by_kind
from cfid.demo.recordings import Laboratory, experiments
from cfid.demo.truth import demo_truth, true_values
from cfid.errors import ConfigError
from cfid.records.campaign import open_campaign
from cfid.sim.truth import load_truth

_AT_ONCE = 2  # fits at a time: one for each processor of a small computer


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder to make.")] = Path("cfid-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the rig's parameters and recordings.")] = 1,
    truth: Annotated[
        Path | None, typer.Option(help="TOML file with the true parameters, as for `cfid rig sim`.")
    ] = None,
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """Make a campaign on the simulated rig, fit and report it, and compare the estimates with the true values.

    The demo has every experiment of the thesis: swings, weights, test body, staircase, tachometer, sines, pings, wind.
    Where the thesis has dozens of settings, the demo has a few, and the load cell samples at 1 kHz (7 kHz for the
    steps).

    Example: [bold]cfid demo my-demo --seed 7[/bold]
    """
    if folder.is_dir() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty: delete it, or give another folder.")
    drawn = demo_truth(seed) if truth is None else load_truth(truth)
    make_campaign(folder, seed=seed)
    campaign = open_campaign(folder)
    laboratory, plan = Laboratory(campaign, drawn, seed=seed), experiments(drawn, seed=seed)
    count = sum(len(recordings) for recordings, _ in plan)
    # The recordings' commands change the environment meanwhile (typer does): a process that then starts with it reads
    # freed memory.
    run = partial(run_command, folder=campaign.folder, environment=dict(os.environ))
    fits_options = "" if figures else " --no-figures"
    running: list[tuple[str, Future[subprocess.CompletedProcess[str]]]] = []
    echo(f"recording on the simulated rig (seed {seed}), and fitting meanwhile ...", err=True)
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        try:
            for recordings, fits in plan:
                for recording in recordings:
                    laboratory.make(recording)
                    echo(f"{laboratory.made} of {count} recorded: cfid {recording.words}", err=True)
                names = runs_by_kind(campaign)
                for words in (fit.format(**names) for fit in fits):
                    running.append((words, pool.submit(run, words + fits_options)))
            for words, future in running:
                print_ended(words, future.result())
            for words in HANDED_ON:
                print_ended(words, run(words))
        except BaseException as error:
            pool.shutdown(wait=False, cancel_futures=True)
            if isinstance(error, KeyboardInterrupt):
                echo(f"\nstopped: {folder} holds a part of the demo; delete it before you start again.", err=True)
            raise
    print_comparison(campaign, true_values(drawn, campaign.rig, seed=seed))
    result(f"the campaign is {folder}: open {folder / 'report.html'}; `cfid parameters` there lists what is known.")
