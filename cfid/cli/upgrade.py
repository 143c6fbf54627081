"""`cfid upgrade`: rewrite a campaign of an older version in the formats of this one."""

from pathlib import Path
from typing import Annotated

import typer

from cfid.console.campaign import here
from cfid.console.messages import echo


def upgrade_campaign(
    folder: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", help="Campaign folder; default: the current folder or a parent.")
    ] = None,
) -> None:
    """Rewrite a campaign's parameters.toml and fits in this version's formats; the old files stay in before-upgrade.

    Example: [bold]cfid upgrade my-crazyflie[/bold]
    """
    from cfid.records.upgrade import KEPT_IN, upgrade_files

    campaign = here(folder)
    changed = upgrade_files(campaign)
    for path in changed:
        echo(path)
    if changed:
        echo(f"{len(changed)} rewritten; as they were: {campaign.folder / KEPT_IN}")
    else:
        echo("nothing to do: every file has the format of this version.")
