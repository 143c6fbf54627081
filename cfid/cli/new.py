"""`cfid new`: create a campaign folder with a commented rig.toml."""

from pathlib import Path
from typing import Annotated

import typer

from cfid.console.campaign import make_campaign
from cfid.console.messages import echo


def new_campaign(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to make; it may exist if it is empty.")],
) -> None:
    """Make a campaign folder with a commented rig.toml.

    Example: [bold]cfid new my-crazyflie[/bold]
    """
    path = make_campaign(folder)
    echo(f"{path}: put your vehicle's mass, centre of mass and mounts there, then record.")
