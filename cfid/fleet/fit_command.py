"""`cfid fleet fit`: refit many campaigns from their recordings, with the results in a new folder."""

import os
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console.messages import clock, echo, note, printable
from cfid.counted import counted
from cfid.fleet.command import Index, Jobs, Scheduler, processors

if TYPE_CHECKING:
    from cfid.errors import DataError
    from cfid.fleet.refit import Refitted
    from cfid.fleet.results import Results

_MOVED = 0.1  # standard uncertainties, from which on a number counts as moved
_LINES = 20  # printed about the progress
_MOST_LISTED = 10  # in a message
# Every process needs these. pandas is not among them: its imports may start threads, and no process should be forked
# from one with threads.
_NEEDED = ("cfid.fleet.refit", "scipy.optimize", "scipy.signal")


def fleet_fit(
    places: Annotated[
        list[str] | None, typer.Argument(metavar="DIR ...", help="Campaign folders, globs, or fsspec addresses.")
    ] = None,
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
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Refit campaigns from their recordings: each fit in force, into a new folder. No campaign is changed.

    After an interruption, the same command continues where it stopped. Compare the results with `cfid fleet "OUT/*"`.

    Example: [bold]cfid fleet fit vehicles/* --out refitted --set peaks=12[/bold]
    """
    from cfid.errors import DataError, FitError
    from cfid.fleet.places import campaigns
    from cfid.fleet.recipes import changes_of
    from cfid.fleet.refit import refit
    from cfid.fleet.results import results_in
    from cfid.fleet.workers import on_cluster, on_processes

    found, unmatched = campaigns(places or [], index)
    every = [one for one in found if one != os.path.realpath(out)]  # a glob may match it too
    changes = changes_of(changed or [], method)
    work = partial(refit, changes=changes)
    with results_in(out, changes=changes) as results:
        left = [one for one in every if one not in results.done]
        results.name(left)
        answers = (
            on_processes(work, left, number=jobs or processors(), imports=_NEEDED)
            if scheduler is None
            else on_cluster(work, left, scheduler)
        )
        faults = [*map(str, unmatched), *_keep(results, answers, every)]
        rows = [results.done[one] for one in every if one in results.done]
    (_print_json if json else _print_summary)(rows, faults)
    failed = [text for row in rows for text in _failures(row)]
    how_many = f"{counted(len(failed), 'fit')} of {out} {'was' if len(failed) == 1 else 'were'} not made:"
    missing = [how_many, *_shortened(failed)] if failed else []
    if faults:
        total = len(every) + len(unmatched)
        unread = [f"{len(faults)} of {counted(total, 'campaign')} not refitted:", *map(printable, faults)]
        raise DataError("\n".join("\n  ".join(texts) for texts in (unread, missing) if texts))
    if missing:
        raise FitError("\n  ".join(missing))


def _keep(results: "Results", answers: "Iterator[tuple[str, Refitted | DataError]]", every: Sequence[str]) -> list[str]:
    """Store each answer as it arrives; return sentences on the campaigns that cannot be refitted."""
    from cfid.errors import DataError
    from cfid.version import __version__

    def done() -> int:
        return sum(one in results.done for one in every)  # the folder may hold other campaigns of earlier commands

    faults = []
    began_s, before = time.monotonic(), done()
    if before:
        note(f"done already, and kept: {before} of {counted(len(every), 'campaign')}.")
    if changed := results.changed(every):
        which = ", ".join(_shortened(changed))
        note(f"{counted(len(changed), 'campaign')} changed since: {which}. A new folder refits them as they are now.")
    try:
        for campaign, answer in answers:
            if isinstance(answer, DataError):
                faults.append(str(answer))
            elif answer.cfid_version != __version__:
                faults.append(f"{campaign}: the worker has cfid {answer.cfid_version}, this is {__version__}.")
            elif answer.fault:
                faults.append(answer.fault)
            else:
                results.keep(campaign, answer)
            _print_progress(done() + len(faults), len(every), before, time.monotonic() - began_s)
    except KeyboardInterrupt:
        note(f"{done()} of {counted(len(every), 'campaign')} done; the same command goes on with the others.")
        raise
    return faults


def _print_progress(done: int, total: int, before: int, seconds: float) -> None:
    """Print the progress of the fleet, after some of its campaigns."""
    if done == total or done % -(-total // _LINES) == 0:
        rest_s = seconds / (done - before) * (total - done)
        ahead = "" if done == total else f", {clock(rest_s)} to go"
        echo(f"{done} of {counted(total, 'campaign')} in {clock(seconds)}{ahead}", err=True)


def _failures(row: Mapping[str, Any]) -> list[str]:
    failed = [fit for fit in row["fits"] if not fit["done"]]
    return [printable(": ".join(filter(None, (row["folder"], fit["name"], fit["text"])))) for fit in failed]


def _shortened(texts: Sequence[str]) -> list[str]:
    """Return sentences on fits; of many, return the first and the number of the others, which the manifest contains."""
    more = len(texts) - _MOST_LISTED
    return [*texts[:_MOST_LISTED], *([f"and {more} more, which the manifest names."] if more > 0 else [])]


def _print_json(rows: "Sequence[Mapping[str, Any]]", faults: Sequence[str]) -> None:
    import json

    echo(json.dumps({"command": "fleet fit", "campaigns": list(rows), "not_refitted": list(faults)}, indent=2))


def _print_summary(rows: "Sequence[Mapping[str, Any]]", _: Sequence[str]) -> None:
    """Print a row for each fit: in how many campaigns it was made, and how far its numbers moved from the kept ones."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    fits = defaultdict[str, list[tuple[str, Mapping[str, Any]]]](list)
    for row in rows:
        for fit in row["fits"]:
            fits[fit["name"]].append((row["folder"], fit))
    if not fits:
        return
    table = Table(box=SIMPLE, pad_edge=False)
    for heading in ("fit", "made", "not made", f"moved by {_MOVED:g} std or more", "most moved", "of", "in"):
        table.add_column(heading, overflow="fold")
    for name, every in sorted(fits.items()):
        made = [(folder, fit) for folder, fit in every if fit["done"]]
        moved = [(fit["moved_in_std"], fit["most_moved"], folder) for folder, fit in made if fit["moved_in_std"]]
        most, key, where = max(moved, default=(0.0, "", ""))
        shown = (f"{most:.2g} std", key, where) if most else ("0", "", "")
        many = sum(size >= _MOVED for size, _, _ in moved)
        cells = (name, str(len(made)), str(len(every) - len(made)), str(many), *shown)
        table.add_row(*(escape(printable(cell)) for cell in cells))
    Console().print(table)
