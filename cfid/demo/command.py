"""`cfid demo`: record, fit and report a whole campaign on the simulated rig, whose true values are known."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.messages import echo, result

if TYPE_CHECKING:
    from cfid.demo.fits import Commands
    from cfid.records.campaign import Campaign


def demo(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder to make.")] = Path("cfid-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Seed of the rig's parameters and recordings.")] = 1,
    truth: Annotated[
        Path | None, typer.Option(help="TOML file with the true parameters, as for `cfid rig sim`.")
    ] = None,
    wire: Annotated[
        bool,
        typer.Option(
            "--wire", help="Record in real time over the devices' own interfaces: fewer experiments, two minutes."
        ),
    ] = False,
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """Make a campaign on the simulated rig, fit and report it, and compare the estimates with the true values.

    The demo has every experiment of the thesis: swings, weights, test body, staircase, tachometer, sines, pings, wind.
    Where the thesis has dozens of settings, the demo has a few, and the load cell samples at 1 kHz (7 kHz for the
    steps).

    Example: [bold]cfid demo my-demo --seed 7[/bold]
    """
    from cfid.demo.fits import HANDED_ON, Commands, print_comparison

    _check(folder, truth)
    campaign = _new_campaign(folder, seed)
    try:
        with Commands(campaign, figures=figures) as commands:
            known = (_record_over_wires if wire else _record)(campaign, commands, truth, seed)
            commands.finish()
            commands.start(("report",) if wire else HANDED_ON)
            commands.finish()
        print_comparison(campaign, known)
        result(f"the campaign is {folder}: open {folder / 'report.html'}; `cfid parameters` there lists what is known.")
    except KeyboardInterrupt:
        echo(f"\nstopped: {folder} holds a part of the demo; delete it before you start again.", err=True)
        raise


def _record(campaign: "Campaign", commands: "Commands", truth: Path | None, seed: int) -> dict[str, float]:
    """Make all recordings in virtual time, fit each experiment once it is recorded, and return the true values."""
    from cfid.demo.recordings import Laboratory, experiments
    from cfid.demo.truth import demo_truth, true_values
    from cfid.sim.truth import load_truth

    drawn = demo_truth(seed) if truth is None else load_truth(truth)
    laboratory, plan = Laboratory(campaign, drawn, seed=seed), experiments(drawn, seed=seed)
    count = sum(len(recordings) for recordings, _ in plan)
    echo(f"recording on the simulated rig (seed {seed}), and fitting meanwhile ...", err=True)
    for recordings, fits in plan:
        for recording in recordings:
            laboratory.make(recording)
            echo(f"{laboratory.made} of {count} recorded: cfid {recording.words}", err=True)
        commands.start(fits)
    return true_values(drawn, campaign.rig, seed=seed)


def _record_over_wires(campaign: "Campaign", commands: "Commands", truth: Path | None, seed: int) -> dict[str, float]:
    from cfid.demo.fits import FITS_OVER_WIRES
    from cfid.demo.truth import true_motors
    from cfid.demo.wire import record_over_wires
    from cfid.sim.truth import USUAL_TRUTH, load_truth

    record_over_wires(campaign, truth=truth, seed=seed)
    commands.start(FITS_OVER_WIRES)
    known = true_motors(USUAL_TRUTH if truth is None else load_truth(truth))
    # This computer adds an unknown delay, which is larger than that of the simulated radio.
    return {name: value for name, value in known.items() if name not in ("tf.delay_s", "latency.rtt_mean_s")}


def _check(folder: Path, truth: Path | None) -> None:
    """Refuse an existing campaign or an invalid truth before anything is created. Raises ConfigError."""
    from cfid.errors import ConfigError
    from cfid.records.files import RIG_FILE, RUNS_FOLDER
    from cfid.sim.truth import load_truth

    left = (folder / RIG_FILE, folder / "parameters.toml", folder / "fits", *(folder / RUNS_FOLDER).glob("*"))
    if any(path.exists() for path in left):
        raise ConfigError(f"{folder} holds a campaign already: delete it, or give another folder.")
    if folder.is_dir() and any(folder.iterdir()):
        raise ConfigError(f"{folder} is not empty: give a new folder.")
    if truth is not None:
        load_truth(truth)


def _new_campaign(folder: Path, seed: int) -> "Campaign":
    from cfid.console.campaign import make_campaign
    from cfid.records.campaign import find_campaign

    make_campaign(folder, seed=seed)
    campaign = find_campaign(folder, start=folder)
    assert campaign is not None  # the folder was given
    return campaign
