"""`cfid new`: create a campaign folder with a commented rig.toml."""

from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

import typer

from cfid.console.campaign import make_campaign
from cfid.console.messages import echo


def new_campaign(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to make; it may exist if it is empty.")],
    *,
    kind: Annotated[
        Literal["rig", "owner", "simulated", "thesis"],
        typer.Option(
            help="rig: encoder, load cell, mounts; owner: threads, the vehicle's gyro, kitchen scales; simulated: with "
            "the numbers of the simulated rig; thesis: with those of its calculation."
        ),
    ] = "rig",
) -> None:
    """Make a campaign folder with a commented rig.toml.

    Example: cfid new my-crazyflie
    """
    path = make_campaign(folder, kind=kind)
    todo = "" if kind in ("simulated", "thesis") else ": put what you measured there in place of each ?"
    echo(f"{path}{todo}")
    if kind == "simulated":
        echo(f"in another terminal: cfid -C {quote(str(folder))} rig sim")
    echo(f"next: cd {quote(str(folder))} && cfid next")
