"""`cfid report`: write a campaign's results to one file."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from cfid.console.campaign import here
from cfid.console.messages import echo, note, print_json
from cfid.console.program import program
from cfid.errors import ConfigError
from cfid.guide.command import Kind
from cfid.records.campaign import Campaign
from cfid.report.build import build
from cfid.report.render import rendered
from cfid.report.sealed import write_report
from cfid.version import __version__

Format = Literal["html", "md", "json", "tex"]


def report(
    *,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to write; default: report.html in the campaign.")
    ] = None,
    form: Annotated[
        Format | None,
        typer.Option("--format", help="Format of the file; tex has only the tables; default: from --out, else html."),
    ] = None,
    kind: Kind = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that cfid did not write.")] = False,
) -> None:
    """Write one file of results: numbers, parameter sheet, figures.

    The page needs no network. It lists missing quantities with the commands that determine them, and compares
    experiments that measure the same property, and your vehicle with published values.

    Example: cfid report --format tex
    """
    found = here()
    formats: dict[str, Format] = {"": "html", **{f".{one}": one for one in get_args(Format)}}
    # a file name that is only a suffix, such as .md, also states a format
    chosen = form or formats.get("" if out is None else Path(f"_{out.name}").suffix)
    if out == Path("-"):
        raise ConfigError("a report is a file: --out must name one, not -.")
    if chosen is None:
        raise ConfigError(f"--out {out}: should end in {', '.join(filter(None, formats))}, or --format name one.")
    path = out or found.folder / f"report.{chosen}"
    content = build(found, now=datetime.now(UTC), kind=kind)
    if chosen == "html":
        _draw_published(found)
    write_report(path, rendered(content, chosen, found.folder), force=force)
    disagreements = [agreement["finding"] for agreement in content["agreements"] if agreement["finding"]]
    notes = [*content["unreadable"], *disagreements]
    if program().json:
        print_json({"command": "report", "file": str(path), "notes": notes, "version": __version__})
        return
    for sentence in notes:
        note(sentence)
    echo(path)


def _draw_published(campaign: Campaign) -> None:
    """Draw published values beside the campaign's, as `cfid compare` does."""
    from cfid.comparison.claims import comparisons_with
    from cfid.comparison.figures import comparison_figure
    from cfid.drawing.save import save_figure

    figure = comparison_figure(comparisons_with(campaign, campaign.values()), name=campaign.rig.vehicle.name)
    save_figure(figure, campaign.folder / "figures" / "compare")
