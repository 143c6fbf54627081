"""`cfid fleet`: compare many campaigns, of one vehicle or one day each."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cfid.console.messages import echo, note, printable
from cfid.counted import counted

if TYPE_CHECKING:
    from cfid.errors import CfidError
    from cfid.fleet.comparison import ComparedNumber
    from cfid.fleet.summary import Summary

_FOLDERS_FOR_A_PROCESS = 16  # reading fewer folders takes less time than starting a process
_MOST_NAMES = 3

Index = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="File with one campaign per line, relative to the file; # starts a comment."),
]
Jobs = Annotated[int, typer.Option(min=0, help="Number of processes; 0 means one per processor.")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Address of a Dask cluster that can read the folders.")
]


def fleet(
    folders: Annotated[list[str] | None, typer.Argument(metavar="DIR ...", help="Campaign folders, or globs.")] = None,
    *,
    index: Index = None,
    only: Annotated[str, typer.Option(metavar="TEXT", help="Compare only parameters whose names contain this.")] = "",
    details: Annotated[bool, typer.Option("--details", help="Show every campaign's value of every parameter.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table to a new .csv, .parquet or .html file.")
    ] = None,
    jobs: Jobs = 0,
    scheduler: Scheduler = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare the results of several campaigns: mean, scatter, expected scatter, outliers and drift of each number.

    `cfid fleet fit` refits campaigns; write ./fit for a campaign folder named fit.

    Example: [bold]cfid fleet vehicle-1 vehicle-2 vehicle-3 --only inertia.matrix[/bold]
    """
    from cfid.errors import ConfigError, DataError
    from cfid.fleet.comparison import compare
    from cfid.fleet.places import campaigns
    from cfid.fleet.tables import SUFFIXES

    if out is not None and out.suffix not in SUFFIXES:
        raise ConfigError(f"--out {out}: should end in {', '.join(SUFFIXES)}.")
    places, faults = campaigns(folders or [], index, addresses=False)
    summaries, unreadable = _summaries(places, jobs=jobs, scheduler=scheduler)
    comparisons = [one for one in compare(summaries) if only in one.name]
    if summaries:
        _hand_out(comparisons, summaries, details=details, out=out, json=json)
        _print_findings(summaries, details=details)
    if faults := [*faults, *unreadable]:
        count = len(summaries) + len(faults)
        head = f"{len(faults)} of {counted(count, 'campaign')} cannot be read:"
        raise DataError("\n  ".join([head, *(printable(str(one)) for one in faults)]))


def processors() -> int:
    """Return the number of processors that this process may use."""
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _summaries(places: Sequence[str], *, jobs: int, scheduler: str | None) -> "tuple[list[Summary], list[CfidError]]":
    """Return the campaigns' summaries in order, with distinct names, and the errors of unreadable campaigns."""
    from dataclasses import replace

    from cfid.fleet.summary import Summary, summarise, with_shared
    from cfid.fleet.workers import on_cluster, on_processes

    number = min(jobs or processors(), -(-len(places) // _FOLDERS_FOR_A_PROCESS))
    if scheduler is not None:
        answers = dict(on_cluster(summarise, places, scheduler))
    elif number < 2:
        answers = {place: summarise(place) for place in places}
    else:
        answers = dict(on_processes(summarise, places, number=number))
    read = [answers[place] for place in places]
    summaries = [one for one in read if isinstance(one, Summary)]
    names = Counter(one.name for one in summaries)
    apart = [one if names[one.name] == 1 else replace(one, name=str(one.folder)) for one in summaries]
    return with_shared(apart), [one for one in read if not isinstance(one, Summary)]


def _hand_out(
    comparisons: "Sequence[ComparedNumber]",
    summaries: "Sequence[Summary]",
    *,
    details: bool,
    out: Path | None,
    json: bool,
) -> None:
    """Write the table to a file if one is named, else print it; print the JSON object if requested."""
    from cfid.fleet import tables

    if out is not None:
        rows = tables.detail_rows(comparisons, summaries) if details else tables.comparison_rows(comparisons)
        tables.write_table(out, rows, title=counted(len(summaries), "campaign"))
    if json:
        _print_json(comparisons, summaries)
    elif out is not None:
        echo(out)
    else:
        if details:
            tables.print_details(comparisons, summaries)
        tables.print_comparisons(comparisons, summaries)


def _print_findings(summaries: "Sequence[Summary]", *, details: bool) -> None:
    """Print each finding; of many findings of one kind, print without `details` only the first and the count."""
    found = defaultdict[str, list[tuple[str, str]]](list)
    for summary in summaries:
        for finding in summary.findings:
            found[finding.code].append((summary.name, finding.text))
    for code, every in found.items():
        for name, text in every if details or len(every) <= _MOST_NAMES else every[:1]:
            note(f"{name}: {text}")
        if not details and len(every) > _MOST_NAMES:
            campaigns = len({name for name, _ in every})
            note(f"{code}: {len(every) - 1} more, in {campaigns} campaigns altogether; --details names them.")


def _print_json(comparisons: "Sequence[ComparedNumber]", summaries: "Sequence[Summary]") -> None:
    import json
    from dataclasses import asdict

    from cfid.records.parameters import plain

    campaigns = [
        {
            "folder": str(summary.folder),
            "vehicle": summary.vehicle,
            "complete_runs": summary.complete_runs,
            "other_runs": summary.other_runs,
            "lab_book": summary.lab_book,
            "findings": [finding.as_json() for finding in summary.findings],
        }
        for summary in summaries
    ]
    content = {
        "command": "fleet",
        "campaigns": campaigns,
        "parameters": {
            one.name: {
                "unit": one.unit,
                "values": [None if known is None else known.value for known in one.values],
                "stds": [None if known is None else known.std for known in one.values],
                "repeats": None if one.repeats is None else {**asdict(one.repeats), "agree": one.repeats.agree},
            }
            for one in comparisons
        },
    }
    echo(json.dumps(plain(content), indent=2, allow_nan=False))
