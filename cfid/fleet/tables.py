"""A fleet's comparison as a table: on the terminal, and as a CSV, Parquet or HTML file."""

from collections.abc import Mapping, Sequence
from html import escape as escaped
from io import BytesIO
from pathlib import Path
from typing import Any

from pandas import DataFrame
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cfid.console.messages import printable
from cfid.console.tables import UNLIMITED, print_table
from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.fleet.comparison import ComparedNumber
from cfid.fleet.summary import Summary
from cfid.quantities.rounding import value_and_std
from cfid.records import lab_book
from cfid.records.files import refuse_kept, write_new

SUFFIXES = (".csv", ".parquet", ".html")

_NUMBER_WIDE = 29  # characters of most numbers' names: on a narrow terminal, longer names are folded first
_NARROW = 80  # columns: on fewer, a table may not fit
_NUMBERS = {
    "mean", "mean_std", "scatter", "expected_scatter", "probability", "drift_per_day", "drift_std_per_day", "std",
}  # fmt: skip
_MOST_NAMES = 3  # of outliers, in a cell of the table on the terminal
_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>{title}</title>
<style>body {{ font-family: sans-serif }} th, td {{ padding: 0.2em 0.8em; text-align: left }}
td {{ border-top: 1px solid #ccc }}</style>
<h1>{title}</h1>
{table}
</html>
"""


def print_comparisons(comparisons: Sequence[ComparedNumber], summaries: Sequence[Summary]) -> None:
    """Print the number of campaigns, and one row per compared number."""
    runs = sum(summary.complete_runs for summary in summaries)
    others = sum(summary.other_runs for summary in summaries)
    console = Console()
    console.print(
        f"{counted(len(summaries), 'campaign')}, {counted(runs, 'complete run')}, {others} not complete",
        highlight=False,
    )
    if not comparisons:
        console.print("No number is fitted in these campaigns, or none has the name asked for.", highlight=False)
        return
    table = Table(box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("number", overflow="fold")
    for heading in ("mean", "scatter", "expected"):
        table.add_column(heading, no_wrap=True)
    table.add_column("outliers", overflow="fold")
    for one in comparisons:
        table.add_row(*map(_cell, (one.name, *_figures(one), "; ".join(_remarks(one, of=len(summaries))))))
    # rich would fold outliers too, and cut off text that then does not fit
    longest = max((len(one.name) for one in comparisons), default=0)
    excess = console.measure(table, options=console.options.update(max_width=UNLIMITED)).maximum - console.width
    table.columns[0].width = min(longest, max(longest - excess, _NUMBER_WIDE))
    print_table(table, narrow=_NARROW)
    apart = [one.name for one in comparisons if one.repeats is not None and not one.repeats.agree]
    if apart:
        console.print(
            f"* {len(apart)} of {len(comparisons)} numbers differ by more than their uncertainties.", highlight=False
        )


def print_details(comparisons: Sequence[ComparedNumber], summaries: Sequence[Summary]) -> None:
    """Print every campaign, and below the name of every number all its values."""
    console = Console()
    table = Table(box=SIMPLE, pad_edge=False)
    for heading in ("", "campaign", "vehicle", "runs", "not complete"):
        table.add_column(heading, overflow="fold")
    for number, summary in enumerate(summaries, 1):
        counts = str(summary.complete_runs), str(summary.other_runs)
        table.add_row(str(number), _cell(summary.name), _cell(summary.vehicle), *counts)
    console.print(table)
    for number, summary in enumerate(summaries, 1):
        for line in lab_book.lines(summary.lab_book):
            console.print(f"  {number:3}  {printable(line)}", highlight=False, markup=False)
    for one in comparisons:
        console.print(f"[bold]{_cell(one.name)}[/bold], {_cell(one.unit)}", highlight=False)
        for number, (summary, known) in enumerate(zip(summaries, one.values, strict=True), 1):
            if known is not None:
                value, std = value_and_std(known.value, known.std)
                mark = "  rejected" if not known.accepted else "  outlier" if summary.name in one.outliers else ""
                console.print(f"  {number:3}  {value} +- {std}{mark}", highlight=False)


def _in_a_spreadsheet(text: str) -> str:
    """Return a text that a spreadsheet reads as text, not as a formula that somebody else wrote."""
    return f"'{printable(text)}" if text[:1] in tuple("=+-@") else printable(text)


def write_table(path: Path, rows: Sequence[Mapping[str, Any]], *, title: str) -> None:
    """Write rows to a new file in the format of its suffix. Raises ConfigError."""
    shown = _in_a_spreadsheet if path.suffix == ".csv" else printable
    texts = [{key: shown(one) if isinstance(one, str) else one for key, one in row.items()} for row in rows]
    frame = DataFrame(texts)
    for name in _NUMBERS & {*frame.columns}:
        frame[name] = frame[name].astype(float)  # even if no value is known
    content = BytesIO()
    if path.suffix == ".csv":
        frame.to_csv(content, index=False)
    elif path.suffix == ".html":
        table = frame.to_html(index=False, border=0, na_rep="", float_format=lambda number: f"{number:.6g}")
        content.write(_PAGE.format(title=escaped(title), table=table).encode("utf-8", "replace"))
    else:
        try:
            frame.to_parquet(content, index=False)
        except ImportError:
            raise ConfigError(f"{path}: Parquet needs pyarrow: pip install 'cfid[parquet]'.") from None
    try:
        refuse_kept(path)
        write_new(path, content.getvalue())
    except FileExistsError:
        raise ConfigError(f"{path} exists already: nothing was changed. Name another file.") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}.") from None


def comparison_rows(comparisons: Sequence[ComparedNumber]) -> list[dict[str, Any]]:
    """Return one row per number."""
    return [
        {
            "number": one.name,
            "unit": one.unit,
            "campaigns": sum(known is not None for known in one.values),
            "used": one.used,
            "mean": found.mean if found else None,
            "mean_std": found.mean_std if found else None,
            "scatter": found.scatter if found else None,
            "expected_scatter": one.expected_scatter,
            "probability": found.probability if found else None,
            "outliers": "; ".join(one.outliers),
            "rejected": "; ".join(one.rejected),
            "without_std": "; ".join(one.unstated),
            "drift_per_day": found.drift_per_day if found else None,
            "drift_std_per_day": found.drift_std_per_day if found else None,
        }
        for one in comparisons
        for found in [one.repeats]
    ]


def detail_rows(comparisons: Sequence[ComparedNumber], summaries: Sequence[Summary]) -> list[dict[str, Any]]:
    """Return one row per number and campaign."""
    return [
        {
            "campaign": summary.name,
            "vehicle": summary.vehicle,
            "number": one.name,
            "unit": one.unit,
            "value": known.value,
            "std": known.std,
            "recorded": known.recorded.isoformat(),
            "accepted": known.accepted,
            "outlier": summary.name in one.outliers,
        }
        for one in comparisons
        for summary, known in zip(summaries, one.values, strict=True)
        if known is not None
    ]


def _cell(text: str) -> str:
    """Return a text of a campaign for a table on the terminal, on one line, without markup."""
    return escape(printable(text))


def _figures(one: ComparedNumber) -> tuple[str, str, str]:
    """Return the mean with its significant digits, the scatter and the expected scatter."""
    found = one.repeats
    if found is None:
        alone = next((known for known in one.values if known is not None and known.accepted), None)
        return value_and_std(alone and alone.value, alone and alone.std)[0], "", ""
    expected = "" if one.expected_scatter is None else f"{one.expected_scatter:.2g}"
    scatter = f"{found.scatter:.2g}{'' if found.agree else ' *'}"
    return value_and_std(found.mean, found.mean_std)[0], scatter, expected


def _remarks(one: ComparedNumber, *, of: int) -> list[str]:
    """Return remarks: in how few campaigns a number is, rejected values, outliers by name, a drift beyond chance."""
    found, remarks = one.repeats, []
    if one.used < of:
        remarks.append(f"in {one.used}")
    if one.rejected:
        remarks.append(f"{len(one.rejected)} rejected")
    if one.unstated:
        remarks.append(f"{len(one.unstated)} without std")
    if one.outliers:
        more = len(one.outliers) - _MOST_NAMES
        remarks.append(", ".join([*one.outliers[:_MOST_NAMES], *([f"{more} more"] if more > 0 else [])]))
    if found is not None and one.drifts:
        remarks.append(f"{found.drift_per_day:+.2g} +- {found.drift_std_per_day:.1g} a day")
    return remarks
