"""`cfid fleet fit`: refit many campaigns from their recordings, with the results in a new folder."""

import json as encoder
import os
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from cfid.console.messages import echo, note, printable
from cfid.console.program import program
from cfid.console.tables import print_table
from cfid.counted import counted
from cfid.errors import CfidError, DataError, FitError
from cfid.fleet.campaigns import campaign_folders
from cfid.fleet.command import Index, Jobs, Scheduler
from cfid.fleet.recipes import changes_of
from cfid.fleet.refit import refits, refitted

_MOVED = 0.1  # standard uncertainties, from which on a number counts as moved


def fleet_fit(
    folders: Annotated[list[str] | None, typer.Argument(metavar="DIR ...", help="Campaign folders, or globs.")] = None,
    *,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results: a new one, or one to continue.")],
    index: Index = None,
    method: Annotated[
        Literal["default", "thesis"] | None,
        typer.Option(help="Method of all fits that have both; default: the method of each original fit."),
    ] = None,
    changed: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Change an option of the fits that have it; can be repeated."),
    ] = None,
    jobs: Jobs = 0,
    scheduler: Scheduler = None,
) -> None:
    """Refit campaigns from their recordings: each fit that counts, into a new folder. No campaign is changed.

    After an interruption, the same command continues where it stopped. Compare the results with `cfid fleet "OUT/*"`.

    Example: [bold]cfid fleet fit vehicles/* --out refitted --set peaks=12[/bold]
    """
    campaigns, faults = campaign_folders(folders or [], index)
    campaigns = [folder for folder in campaigns if folder != os.path.realpath(out)]  # a glob may match it too
    changes = changes_of(changed or [], method)
    listed = list(refitted(campaigns, out, changes))
    outcomes = {made: outcome for _, made, outcome in listed if outcome}
    if outcomes:
        note(f"done already, and kept: {len(outcomes)} of {counted(len(listed), 'campaign')}.")
    waiting = {made: folder for folder, made, outcome in listed if not outcome}
    try:
        for made, outcome in refits(waiting, out, changes, jobs=jobs, scheduler=scheduler):
            if isinstance(outcome, CfidError):
                faults.append(outcome)
            else:
                outcomes[made] = outcome
    except KeyboardInterrupt:
        note(f"{len(outcomes)} of {counted(len(listed), 'campaign')} done; the same command continues with the others.")
        raise
    results = {made.name: outcomes[made] for _, made, _ in listed if made in outcomes}
    if program().json:
        content = {"command": "fleet fit", "campaigns": results, "not_refitted": list(map(str, faults))}
        echo(encoder.dumps(content, indent=2))
    elif results:
        _print_summary(results)
    failed = [
        f"{name}: {fit['name']}: {fit['fault']}"
        for name, outcome in results.items()
        for fit in outcome["fits"]
        if fit["fault"]
    ]
    texts = [] if not failed else [f"{counted(len(failed), 'fit')} of {out} could not be repeated:", *failed]
    if faults:
        total = counted(len(results) + len(faults), "campaign")
        raise DataError("\n  ".join([f"{len(faults)} of {total} not refitted:", *map(str, faults), *texts]))
    if texts:
        raise FitError("\n  ".join(texts))


def _print_summary(results: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a row for each fit: in how many campaigns it was made, and how far its numbers moved from the kept ones."""
    fits = defaultdict[str, list[tuple[str, Mapping[str, Any]]]](list)
    for name, outcome in results.items():
        for fit in outcome["fits"]:
            fits[fit["name"]].append((name, fit))
    table = Table(box=SIMPLE, pad_edge=False)
    for heading in ("fit", "made", "not made", f"moved by {_MOVED:g} std or more", "most moved", "of", "in"):
        table.add_column(heading, overflow="fold")
    for name, outcomes in sorted(fits.items()):
        made = [(campaign, fit) for campaign, fit in outcomes if not fit["fault"]]
        moves = [(fit["moved"], fit["most"], campaign) for campaign, fit in made if fit["moved"]]
        farthest, key, where = max(moves, default=(0.0, "", ""))
        counts = len(made), len(outcomes) - len(made), sum(move >= _MOVED for move, _, _ in moves)
        cells = (name, *map(str, counts), f"{farthest:.2g} std" if moves else "0", key, where)
        table.add_row(*(Text(printable(cell)) for cell in cells))
    print_table(table)
