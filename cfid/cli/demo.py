"""`cfid demo`: a whole campaign on the simulated rig, so that a newcomer sees every step with a known truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid import __version__
from cfid.errors import ConfigError

if TYPE_CHECKING:
    from cfid.campaign import Campaign
    from cfid.sim.demo import SimulatedRun


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder to make.")] = Path("cfid-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another rig and other recordings.")] = 1,
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """Make a campaign on the simulated rig, fit it, and compare with the truth that the simulation knows.

    So far: swings of the vehicle and of the test body, and dropped weights (chapter 2 of the thesis).

    Example: [bold]cfid demo my-demo --seed 7[/bold]
    """
    from cfid.cli.demo_fits import fit_everything, print_comparison
    from cfid.sim.demo import simulate_demo

    campaign = _new_campaign(folder)
    try:
        typer.echo(f"recording on the simulated rig (seed {seed}) ...", err=True)
        truth, simulated = simulate_demo(campaign.rig, seed=seed)
        folders = [_record(campaign, run) for run in simulated]
        typer.echo(f"{len(folders)} runs recorded; fitting ...", err=True)
        fit_everything(campaign, figures=figures)
        print_comparison(campaign, truth)
    except KeyboardInterrupt:
        typer.echo(f"\nstopped: {folder} holds a part of the demo; delete it before you start again.", err=True)
        raise


def _new_campaign(folder: Path) -> "Campaign":
    from cfid.campaign import RIG_FILE, find_campaign
    from cfid.cli.campaign import make_campaign

    if (folder / RIG_FILE).exists():
        raise ConfigError(f"{folder} holds a campaign already: delete it, or give another folder.")
    make_campaign(folder)
    campaign = find_campaign(folder, start=folder)
    assert campaign is not None  # it was named
    return campaign


def _record(campaign: "Campaign", run: "SimulatedRun") -> Path:
    from datetime import UTC, datetime

    from cfid.run import DeviceRecord, Label, create_run

    record = DeviceRecord(
        file="encoder.csv", columns=("t", "phi"), counts_per_turn=campaign.rig.encoder.counts_per_turn
    )
    label = Label(axis=run.axis, weight_g=run.weight_g, body=run.body)
    with create_run(
        campaign.runs_folder,
        kind=run.kind,
        label=label,
        devices={"encoder": record},
        started=datetime.now(UTC),
        cfid_version=__version__,
        simulated=True,
    ) as writer:
        writer.append("encoder", (run.time_s, run.counts))
    return writer.folder
