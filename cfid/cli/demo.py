"""`cfid demo`: a whole campaign on the simulated rig, so that a newcomer sees every step with a known truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.campaign import Campaign
    from cfid.sim.truth_file import SimTruth


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder to make.")] = Path("cfid-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another rig and other recordings.")] = 1,
    truth: Annotated[
        Path | None, typer.Option(help="TOML file of what the rig really is, as `cfid rig sim` takes it.")
    ] = None,
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """Make a campaign on the simulated rig, fit and report it, and compare with the truth that the simulation knows.

    Every experiment of the thesis: swings, weights, test body, staircase, tachometer, sines, pings, wind. Lists are
    thinned where the thesis has dozens, and the load cell samples at 1 kHz.

    Example: [bold]cfid demo my-demo --seed 7[/bold]
    """
    from cfid.cli.demo_fits import fit_everything, print_comparison
    from cfid.cli.demo_recordings import write_runs
    from cfid.sim.demo import simulate_demo

    real = _truth(truth)
    campaign = _new_campaign(folder)
    try:
        typer.echo(f"recording on the simulated rig (seed {seed}) ...", err=True)
        known, runs = simulate_demo(campaign.rig, real, seed=seed)
        folders = write_runs(campaign, runs)
        typer.echo(f"{len(folders)} runs recorded; fitting ...", err=True)
        fit_everything(campaign, figures=figures)
        print_comparison(campaign, known)
    except KeyboardInterrupt:
        typer.echo(f"\nstopped: {folder} holds a part of the demo; delete it before you start again.", err=True)
        raise


def _truth(path: Path | None) -> "SimTruth":
    from cfid.sim.demo import DEMO_TRUTH
    from cfid.sim.truth_file import load_truth

    return DEMO_TRUTH if path is None else load_truth(path)


def _new_campaign(folder: Path) -> "Campaign":
    from cfid.campaign import RIG_FILE, find_campaign
    from cfid.cli.campaign import make_campaign

    if (folder / RIG_FILE).exists():
        raise ConfigError(f"{folder} holds a campaign already: delete it, or give another folder.")
    make_campaign(folder)
    campaign = find_campaign(folder, start=folder)
    assert campaign is not None  # it was named
    return campaign
