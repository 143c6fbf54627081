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
        Literal["thesis"] | None, typer.Option(help="thesis: mount xy and the line as its calculation has them.")
    ] = None,
) -> None:
    """Make a campaign folder with a commented rig.toml.

    Example: [bold]cfid new my-crazyflie[/bold]
    """
    path = make_campaign(folder, thesis=kind is not None)
    echo(f"{path}: put your vehicle's mass, centre of mass and mounts there, then record.")
