"""Render a report as Markdown: tables that GitHub and pandoc read, figures as links relative to the campaign.

Names, notes and findings are escaped, so they cannot add a tag, link or attribute to a page rendered from the report.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from cfid.report.content import Report
from cfid.report.experiments import Experiment, title_of
from cfid.report.formats import grids
from cfid.report.formats.sealed import MARK
from cfid.report.sheet import SheetEntry
from cfid.report.summary import FirstScreen

_ESCAPED = str.maketrans(
    {
        **{sign: f"\\{sign}" for sign in "\\*_`|[]{}"},
        "&": "&amp;",
        "<": "&lt;",
        ">": "&gt;",
        "$": "&#36;",
        "~": "&#126;",
    }
)


def as_markdown(report: Report) -> str:
    """Return the whole report as text."""
    return "\n".join([f"<!-- {MARK} -->", "", *_parts(report), ""])


def _parts(report: Report) -> Iterator[str]:
    about = report.about
    yield f"# {_plain(about.vehicle)}\n"
    if about.recorded:
        yield f"Recorded {about.days} in {about.recorded_in}. "
    yield f"Campaign {_plain(about.campaign)}. Body frame: {_plain(about.body_frame)}. "
    yield f"Written {about.written:%Y-%m-%d %H:%M} UTC by cfid {about.cfid_version}.\n"
    if about.lab_book:
        yield f"Lab book: {_plain('; '.join(about.lab_book))}.\n"
    if about.simulated_runs:
        yield f"**{about.simulated_runs} of {about.runs} runs are simulated: no vehicle was measured in them.**\n"
    yield from _summary(report.summary)
    yield from (f"- could not be read: {_plain(sentence)}" for sentence in report.unreadable)
    yield f"\n## Sheet\n\n{grids.ABOUT_SHEET}\n"
    for group in report.sheet:
        yield f"### {group.title}\n"
        for quantity in group.quantities:
            yield from _quantity(quantity)
    if report.experiments:
        yield "## Experiments\n"
    for experiment in report.experiments:
        yield from _experiment(experiment)
    yield from _repeats(report)
    if report.agreements:
        yield f"## Across experiments\n\n{grids.ABOUT_AGREEMENT}\n"
        yield _table(grids.agreement_grid(report.agreements))
        yield from (f"- {_plain(finding.text)}" for one in report.agreements for finding in one.findings)
        yield ""
    yield from _published(report)
    if report.runs:
        yield "## Recordings\n"
        yield _table(grids.runs_grid(report.runs))


def _summary(summary: FirstScreen) -> Iterator[str]:
    yield "\n## What was measured, and how sure\n"
    yield _table(grids.summary_grid(summary))
    if summary.weakest:
        yield f"**Weakest:** {_plain(summary.weakest)}\n"
    yield from (f"- {_plain(text)}" for text in summary.findings)
    yield f"\n**Next:** {_commands(f'`{summary.next_command}`')}: {_plain(summary.next_why)}\n"
    yield from (f"- {_commands(text)}" for text in summary.remarks)


def _quantity(quantity: SheetEntry) -> Iterator[str]:
    yield f"**{_plain(quantity.title)}**" + (f": {_plain(quantity.equation)}" if quantity.equation else "") + "\n"
    if quantity.origin:
        yield f"{_plain(grids.origin_text(quantity.origin))}: {grids.verdict(quantity.origin.accepted)}.\n"
        yield from (f"- {_plain(text)}" for text in quantity.origin.findings)
        yield _table(grids.row_grid(quantity.rows))
    if quantity.zeros:
        yield f"{_plain(quantity.zeros)}\n"
    if quantity.missing:
        yield f"{_commands(quantity.missing)}\n"


def _experiment(experiment: Experiment) -> Iterator[str]:
    yield f"### {_plain(experiment.title)}\n"
    method = "" if experiment.method == "default" else f", method {_plain(experiment.method)}"
    yield (
        f"cfid {_plain(experiment.command)}{method}, {experiment.found:%Y-%m-%d %H:%M} UTC, cfid "
        f"{_plain(experiment.cfid_version)}: {grids.verdict(experiment.accepted)}.\n"
    )
    yield from (f"- {_plain(text)}" for text in (*experiment.rejections, *experiment.remarks, *experiment.notes))
    yield ""
    # Of a figure's two files, link the one that every Markdown viewer shows.
    pixels = [figure for figure in experiment.figures if figure.endswith(".png")]
    yield from (f"![{_plain(Path(figure).stem)}](<{quote(figure, errors='replace')}>)\n" for figure in pixels)
    if experiment.parameters:
        yield _table(grids.row_grid(experiment.parameters, "parameter"))
    if experiment.lines:
        yield _fenced("\n".join(experiment.lines))
    for table in experiment.tables:
        yield f"*{_plain(table.title)}*\n"
        yield _table(grids.table_grid(table))
    yield from (f"- {_plain(source.path)} sha256 {_plain(source.sha256)}" for source in experiment.sources)
    yield ""


def _repeats(report: Report) -> Iterator[str]:
    if report.repeats:
        yield f"## Repeats\n\n{grids.ABOUT_REPEATS}\n"
    for fit in report.repeats:
        yield f"### {_plain(title_of(fit.name))}\n"
        yield f"{fit.shared}\n"
        yield _table(grids.repeat_grid(fit))


def _published(report: Report) -> Iterator[str]:
    yield f"## Your vehicle against published\n\n{grids.ABOUT_PUBLISHED}\n"
    sources = grids.sources_of(report.comparisons)
    for comparison in report.comparisons:
        unit = grids.comparison_unit(comparison)
        yield f"### {comparison.title}{f' ({unit})' if unit else ''}\n\n{_plain(comparison.about)}\n"
        yield _table(grids.comparison_grid(comparison, sources))
        yield from (f"- {_plain(note)}" for note in grids.comparison_notes(comparison))
        yield ""
    yield from (f"{number}. {_plain(source)}" for source, number in sources.items())
    yield ""


def _table(grid: grids.Grid) -> str:
    rows = [grid.head, ("---",) * len(grid.head), *grid.rows]
    return "\n".join("| " + " | ".join(map(_plain, row)) + " |" for row in rows) + "\n"


def _plain(text: str) -> str:
    """Return a text on one line without characters that are special in Markdown, or in HTML inside Markdown."""
    return re.sub(r"\s+", " ", text).translate(_ESCAPED)


def _commands(text: str) -> str:
    """Return a sentence with the text between backquotes as code."""
    parts = re.sub(r"\s+", " ", text).split("`")
    return "".join(f"`{part}`" if place % 2 and part else _plain(part) for place, part in enumerate(parts))


def _fenced(text: str) -> str:
    """Return lines unchanged, between fences that are longer than any fence in them."""
    fence = max(["``", *re.findall("`+", text)], key=len) + "`"
    return f"{fence}\n{text}\n{fence}\n"
