"""`cfid demo`: record, fit and report a whole campaign on the simulated rig, whose true values are known."""

from pathlib import Path
from typing import Annotated

import typer

from cfid.console.campaign import make_campaign
from cfid.console.messages import echo, result
from cfid.demo.fits import HANDED_ON, Commands, print_comparison
from cfid.demo.recordings import Laboratory, experiments
from cfid.demo.truth import demo_truth, true_values
from cfid.errors import ConfigError
from cfid.records.campaign import open_campaign
from cfid.sim.truth import load_truth


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
    commands = Commands(campaign, figures=figures)
    laboratory, plan = Laboratory(campaign, drawn, seed=seed), experiments(drawn, seed=seed)
    count = sum(len(recordings) for recordings, _ in plan)
    echo(f"recording on the simulated rig (seed {seed}), and fitting meanwhile ...", err=True)
    try:
        for recordings, fits in plan:
            for recording in recordings:
                laboratory.make(recording)
                echo(f"{laboratory.made} of {count} recorded: cfid {recording.words}", err=True)
            commands.start(fits)
        commands.finish()
        commands.start(HANDED_ON)
        commands.finish()
    except BaseException as error:
        commands.cancel()
        if isinstance(error, KeyboardInterrupt):
            echo(f"\nstopped: {folder} holds a part of the demo; delete it before you start again.", err=True)
        raise
    print_comparison(campaign, true_values(drawn, campaign.rig, seed=seed))
    result(f"the campaign is {folder}: open {folder / 'report.html'}; `cfid parameters` there lists what is known.")
