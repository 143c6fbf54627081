"""`cfid fleet`: compare many campaigns, of one vehicle or one day each."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.messages import note
from cfid.errors import CfidError

if TYPE_CHECKING:
    from cfid.estimate.repetition import Repeats
    from cfid.fleet.summary import KnownValue, Summary

_FOLDERS_FOR_A_PROCESS = 4  # reading fewer takes less time than starting a process


def fleet(
    folders: Annotated[list[Path], typer.Argument(metavar="DIR ...", help="Campaign folders.")],
    only: Annotated[str, typer.Option(metavar="TEXT", help="Only parameters whose names contain this.")] = "",
    jobs: Annotated[int, typer.Option(min=0, help="Number of processes; 0 is one for each processor.")] = 0,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Of a Dask cluster that sees the folders.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare the results of several campaigns: values, mean, scatter, agreement and drift of each number.

    Example: [bold]cfid fleet vehicle-1 vehicle-2 vehicle-3 --only inertia.matrix[/bold]
    """
    from cfid.errors import CfidError, ConfigError
    from cfid.fleet.summary import Summary

    # A campaign named twice would agree with itself.
    answers = _summaries(list(dict.fromkeys(folder.resolve() for folder in folders)), jobs=jobs, scheduler=scheduler)
    summaries = [answer for answer in answers if isinstance(answer, Summary)]
    if not summaries:
        raise ConfigError(" ".join(str(answer) for answer in answers))
    quantities = {name: known for name, known in _by_name(summaries).items() if only in name}
    (_print_json if json else _print_tables)(summaries, quantities)
    for answer in answers:
        for sentence in [str(answer)] if isinstance(answer, CfidError) else _findings(answer):
            note(sentence)


def _summaries(folders: Sequence[Path], *, jobs: int, scheduler: str | None) -> "list[Summary | CfidError]":
    from cfid.fleet.summary import summarise

    if scheduler is not None:
        return _on_cluster(summarise, folders, scheduler)
    workers = min(jobs or _processors(), -(-len(folders) // _FOLDERS_FOR_A_PROCESS))
    if workers < 2:
        return [summarise(folder) for folder in folders]
    from concurrent.futures import ProcessPoolExecutor

    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(summarise, folders))


def _processors() -> int:
    import os

    return os.cpu_count() or 1


def _on_cluster(work: Callable[[Path], Any], folders: Iterable[Path], address: str) -> list[Any]:
    from cfid.errors import ConfigError

    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--scheduler: Dask is not installed here: pip install 'cfid[fleet]'.") from None
    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(f"--scheduler {address}: no Dask scheduler answers there: {error}") from None
    with client:
        return list(client.gather(client.map(work, list(folders), pure=False)))


def _findings(summary: "Summary") -> list[str]:
    return [f"{summary.folder.name}: {finding.text}" for finding in summary.findings]


def _by_name(summaries: "Sequence[Summary]") -> "dict[str, list[KnownValue | None]]":
    """Return each number with its value in each campaign; the same name with another unit is another number."""
    tables = [{(known.name, known.unit): known for known in summary.known} for summary in summaries]
    keys = dict.fromkeys(key for table in tables for key in table)
    units = Counter(name for name, _ in keys)
    return {
        name if units[name] == 1 else f"{name}, {unit}": [table.get((name, unit)) for table in tables]
        for name, unit in keys
    }


def _compared(row: "Sequence[KnownValue | None]") -> "Repeats | None":
    """Return how the accepted numbers of a row agree, None for fewer than two."""
    import numpy as np

    from cfid.estimate.repetition import repeats

    accepted = [known for known in row if known is not None and known.accepted]
    if len(accepted) < 2:
        return None
    return repeats(
        time_s=np.array([known.recorded.timestamp() for known in accepted]),
        value=np.array([known.value for known in accepted]),
        std=np.array([np.nan if known.std is None else known.std for known in accepted]),
    )


def _print_json(summaries: "Sequence[Summary]", quantities: "dict[str, list[KnownValue | None]]") -> None:
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
    compared = {name: _compared(row) for name, row in quantities.items()}
    content = {
        "command": "fleet",
        "campaigns": campaigns,
        "parameters": {
            name: {
                "unit": next(known.unit for known in row if known is not None),
                "values": [None if known is None else known.value for known in row],
                "stds": [None if known is None else known.std for known in row],
                "repeats": None if (found := compared[name]) is None else {**asdict(found), "agree": found.agree},
            }
            for name, row in quantities.items()
        },
    }
    typer.echo(json.dumps(plain(content), indent=2, allow_nan=False))


def _print_tables(summaries: "Sequence[Summary]", quantities: "dict[str, list[KnownValue | None]]") -> None:
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    from cfid.console.tables import value_and_deviation
    from cfid.records.lab_book import lines

    console = Console()
    table = Table(box=SIMPLE, pad_edge=False)
    for heading in ("", "campaign", "vehicle", "runs", "not complete"):
        table.add_column(heading, overflow="fold")
    for number, summary in enumerate(summaries, 1):
        counts = str(summary.complete_runs), str(summary.other_runs)
        table.add_row(str(number), summary.folder.name, summary.vehicle, *counts)
    console.print(table)
    for number, summary in enumerate(summaries, 1):
        for line in lines(summary.lab_book):
            console.print(f"  {number:3}  {line}", highlight=False, markup=False)
    for name, row in quantities.items():
        unit = next(known.unit for known in row if known is not None)
        console.print(f"[bold]{name}[/bold], {unit}", highlight=False)
        for number, known in enumerate(row, 1):
            if known is not None:
                value, std = value_and_deviation(known.value, known.std)
                verdict = "" if known.accepted else "  rejected"
                console.print(f"  {number:3}  {value} +- {std}{verdict}", highlight=False)
        for line in _judgement(_compared(row)):
            console.print(f"       {line}", highlight=False)


def _judgement(found: "Repeats | None") -> list[str]:
    from cfid.console.tables import value_and_deviation

    if found is None:
        return []
    mean, std = value_and_deviation(found.mean, found.mean_std)
    lines = [f"mean {mean} +- {std}, scatter {found.scatter:.2g}{_agreement(found)}"]
    if found.drift_per_day is not None:
        lines.append(f"drift {found.drift_per_day:.2g} +- {found.drift_std_per_day:.2g} a day")
    return lines


def _agreement(found: "Repeats") -> str:
    if found.probability is None:
        return ""
    words = "they agree" if found.agree else "they differ by more than their uncertainties"
    return f"; {words} (probability {found.probability:.2g})"
