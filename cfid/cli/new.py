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
    platform: Annotated[
        Literal["cf2", "cf21", "cf21bl", "other"] | None,
        typer.Option(
            help="Vehicle: Crazyflie 2.0, 2.1, 2.1 Brushless or another; default: cf21 of an owner, else cf2."
        ),
    ] = None,
) -> None:
    """Make a campaign folder with a commented rig.toml.

    Example: cfid new my-crazyflie --kind owner --platform cf21bl
    """
    path = make_campaign(folder, kind=kind, platform=platform)
    todo = "" if kind in ("simulated", "thesis") else ": put what you measured there in place of each ?"
    echo(f"{path}{todo}")
    if kind == "simulated":
        echo(f"in another terminal: cfid -C {quote(str(folder))} rig sim")
    echo(f"next: cd {quote(str(folder))} && cfid next")
