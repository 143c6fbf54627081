"""`cfid new`: create a campaign folder with a commented rig.toml."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from cfid.console.campaign import make_campaign
from cfid.console.messages import echo


def new_campaign(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to make; it may exist if it is empty.")],
    *,
    kind: Annotated[
        Literal["rig", "thesis", "owner"],
        typer.Option(
            help="rig: encoder, load cell, mounts; thesis: mount xy and the line as its calculation has them; owner: "
            "threads, the vehicle's gyro, kitchen scales."
        ),
    ] = "rig",
) -> None:
    """Make a campaign folder with a commented rig.toml.

    Example: [bold]cfid new my-crazyflie[/bold]
    """
    path = make_campaign(folder, kind=kind)
    echo(f"{path}: put your vehicle's mass, centre of mass and mounts there, then record.")
