"""`cfid fleet`: compare many campaigns, of one vehicle or one day each, and refit them from their recordings."""

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cfid.console.messages import echo, note, print_json, printable
from cfid.console.program import program
from cfid.counted import counted
from cfid.errors import CfidError, ConfigError, DataError, FitError
from cfid.estimate.propagation import Repeats
from cfid.fleet.campaigns import campaign_folders, workers
from cfid.fleet.comparison import ComparedNumber, Summary, compare, distinct, summarise
from cfid.fleet.refit import changes_of, refits, refitted
from cfid.quantities.rounding import value_and_std
from cfid.records.files import write_files

_SUFFIXES = (".csv", ".parquet", ".html")
_FOLDERS_FOR_A_PROCESS = 16  # reading fewer folders takes less time than starting a process
_STATISTICS = [field.name for field in fields(Repeats)]
_MOST_NAMES = 3  # of outliers, in a line
_MOST_LINES = 30  # of numbers, so that the table fits a screen
_MOVED = 0.1  # standard uncertainties, from which on a number counts as moved

Index = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="File with one campaign per line, relative to the file; # starts a comment."),
]
Jobs = Annotated[int, typer.Option(min=0, help="Number of processes; 0 means one per processor.")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Address of a Dask cluster that can read and write the folders.")
]


def fleet(
    folders: Annotated[list[str] | None, typer.Argument(metavar="DIR ...", help="Campaign folders, or globs.")] = None,
    *,
    index: Index = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table to a new .csv, .parquet or .html file.")
    ] = None,
    jobs: Jobs = 0,
    scheduler: Scheduler = None,
) -> None:
    """Compare campaigns: mean, scatter, outliers and drift of each number.

    `cfid fleet fit` refits campaigns; write ./fit for a campaign folder named fit.

    Example: cfid fleet vehicle-1 vehicle-2 vehicle-3
    """
    if out is not None and out.suffix not in _SUFFIXES:
        raise ConfigError(f"{out}: should end in {', '.join(_SUFFIXES)}.")
    if out is not None and out.exists():
        raise ConfigError(f"{out}: exists already: name a new file.")
    places, faults = campaign_folders(folders or [], index)
    with workers(jobs, scheduler, most=len(places) // _FOLDERS_FOR_A_PROCESS) as pool:
        answers = list(pool.map(summarise, places))
    summaries = distinct([answer for answer in answers if not isinstance(answer, CfidError)])
    faults += [answer for answer in answers if isinstance(answer, CfidError)]
    numbers = compare(summaries)
    if out is not None:
        _write(out, numbers)
    if program().json:
        _print_json(numbers, summaries)
    elif out is not None:
        echo(out)
    elif summaries:
        _print_screen(numbers, summaries)
    _print_findings(summaries)
    if faults:
        total = counted(len(summaries) + len(faults), "campaign")
        raise DataError("\n  ".join([f"{len(faults)} of {total} cannot be read:", *map(str, faults)]))


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
    """Refit campaigns from their recordings, into a new folder.

    Fits that count are refitted, and no campaign is changed. After an interruption, the same command
    continues where it stopped. Compare the results with `cfid fleet "OUT/*"`.

    Example: cfid fleet fit vehicles/* --out refitted --set peaks=12
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
        print_json(content)
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


def _print_screen(numbers: Sequence[ComparedNumber], summaries: Sequence[Summary]) -> None:
    """Print a line for each number, those first that differ, then those with an aim; and how many others there are."""
    runs = counted(sum(summary.complete_runs for summary in summaries), "complete run")
    others = sum(summary.other_runs for summary in summaries)
    echo(f"{counted(len(summaries), 'campaign')}, {runs}, {others} not complete")
    if not numbers:
        echo("No number is fitted in these campaigns.")
        return
    differing = [number for number in numbers if number.outliers or number.drifts or not _agree(number)]
    others_with_aim = [number for number in numbers if number.is_main and number not in differing]
    table = Table(box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("number", overflow="fold")
    for heading in ("mean", "scatter", "expected", "n"):
        table.add_column(heading, no_wrap=True)
    table.add_column("outliers", overflow="fold")
    for number in ([*differing, *others_with_aim] or numbers)[:_MOST_LINES]:
        table.add_row(*(Text(printable(cell)) for cell in _cells(number)))
    Console().print(table)
    more = len(numbers) - table.row_count
    if more:
        echo(f"and {counted(more, 'other number')}: write the table to a file, or print JSON.")
    apart = sum(not _agree(number) for number in numbers)
    if apart:
        echo(f"* {apart} of {len(numbers)} numbers differ by more than their uncertainties.")


def _agree(number: ComparedNumber) -> bool:
    return number.repeats is None or number.repeats.agree


def _cells(number: ComparedNumber) -> tuple[str, ...]:
    """Return the line of a number: mean with its significant digits, scatters, how many values count, remarks."""
    remarks = [", ".join(number.outliers[:_MOST_NAMES])] if number.outliers else []
    if len(number.outliers) > _MOST_NAMES:
        remarks[0] += f" and {len(number.outliers) - _MOST_NAMES} more"
    if number.rejected:
        remarks.append(f"{len(number.rejected)} rejected")
    if number.without_std:
        remarks.append(f"{len(number.without_std)} without std")
    compared = number.repeats
    if compared is None:
        alone = next((known for known in number.values if known is not None and known.accepted), None)
        mean = value_and_std(alone and alone.value, alone and alone.std)[0]
        return number.name, mean, "", "", str(number.used), "; ".join(remarks)
    if number.drifts:
        remarks.append(f"{compared.drift_per_day:+.2g} +- {compared.drift_std_per_day:.1g} a day")
    scatter = f"{compared.scatter:.2g}{'' if compared.agree else ' *'}"
    expected = "" if number.expected_scatter is None else f"{number.expected_scatter:.2g}"
    mean = value_and_std(compared.mean, compared.mean_std)[0]
    return number.name, mean, scatter, expected, str(number.used), "; ".join(remarks)


def _print_findings(summaries: Sequence[Summary]) -> None:
    """Print the first finding of each code, and the number of the others."""
    findings = [(finding, summary.name) for summary in summaries for finding in summary.findings]
    for code in dict.fromkeys(finding.code for finding, _ in findings):
        same = [(finding.text, name) for finding, name in findings if finding.code == code]
        more = f" ({len(same) - 1} more of {code}, in `--json`.)" if len(same) > 1 else ""
        note(f"{same[0][1]}: {same[0][0]}{more}")


def _row(number: ComparedNumber) -> dict[str, Any]:
    """Return what the file and the JSON object state of a number."""
    statistics = dict.fromkeys(_STATISTICS) if number.repeats is None else asdict(number.repeats)
    names = {"outliers": number.outliers, "rejected": number.rejected, "without_std": number.without_std}
    return {
        "unit": number.unit,
        "used": number.used,
        "expected_scatter": number.expected_scatter,
        **statistics,
        **names,
    }


def _write(path: Path, numbers: Sequence[ComparedNumber]) -> None:
    """Write a row for each number to a new file, in the format of its suffix. Raises ConfigError."""
    from pandas import DataFrame

    rows = [{"number": number.name, **_row(number)} for number in numbers]
    texts = [
        {key: printable("; ".join(value)) if isinstance(value, tuple) else value for key, value in row.items()}
        for row in rows
    ]
    frame = DataFrame(texts).astype(dict.fromkeys(_STATISTICS if rows else (), float))  # even if no value is known
    content = BytesIO()
    if path.suffix == ".csv":
        frame.to_csv(content, index=False)
    elif path.suffix == ".html":
        content.write(frame.to_html(index=False, border=0, na_rep="", float_format="{:.6g}".format).encode())
    else:
        try:
            frame.to_parquet(content, index=False)
        except ImportError:
            raise ConfigError(f"{path}: Parquet needs pyarrow: pip install 'cfid[parquet]'.") from None
    write_files({path: content.getvalue()})


def _print_json(numbers: Sequence[ComparedNumber], summaries: Sequence[Summary]) -> None:
    campaigns = [
        {key: value for key, value in vars(summary).items() if key not in ("known", "recordings")}
        | {"findings": [finding.as_json() for finding in summary.findings]}
        for summary in summaries
    ]
    parameters = {
        number.name: {
            "values": [known and known.value for known in number.values],
            "stds": [known and known.std for known in number.values],
            "recorded": [known and known.recorded.isoformat() for known in number.values],
            **_row(number),
        }
        for number in numbers
    }
    content = {"command": "fleet", "campaigns": campaigns, "parameters": parameters}
    print_json(content)


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
    Console().print(table)
