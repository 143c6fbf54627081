"""Render a report as one HTML file with embedded figures, without scripts, for light and dark screens and paper."""

import base64
import contextlib
import re
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from cfid.records.files import lies_in
from cfid.report.content import Report
from cfid.report.experiments import Experiment, stems_of, title_of
from cfid.report.formats import grids
from cfid.report.formats.sealed import MARK

LARGEST_SVG_BYTES = 400_000  # of a larger figure, its PNG is embedded, which a browser draws faster
LARGEST_BYTES = 20_000_000  # larger figures are not embedded at all

_KINDS = {".svg": "image/svg+xml", ".png": "image/png"}
_INDEX = re.compile(r"\b([^\W\d_]\d?)_(\w+)")
_POWER = re.compile(r"\^(\w+)")
_BRACKETS = re.compile(r" \(([^()]+)\)$")
_CODE = re.compile(r"`([^`]+)`")


def as_html(report: Report, folder: Path) -> str:
    """Return the page; figures are read from `folder`, the campaign's, and a missing figure is named instead."""
    environment = Environment(
        loader=PackageLoader("cfid.report.formats", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"formula": _formula, "commands": _commands, "aside": _aside}
    return environment.get_template("report.html.j2").render(
        report=report,
        mark=MARK,
        grids=grids,
        title_of=title_of,
        sources=grids.sources_of(report.comparisons),
        figures=_figures(report, folder),
        counts=_counts(report),
    )


def _counts(report: Report) -> dict[str, int]:
    quantities = [quantity for group in report.sheet for quantity in group.quantities]
    found = [quantity.origin for quantity in quantities if quantity.origin]
    return {
        "all": len(quantities),
        "found": sum(origin.accepted is not False for origin in found),
        "rejected": sum(origin.accepted is False for origin in found),
    }


def _figures(report: Report, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the figures of each experiment by its anchor: name, embedded content ("" if none), earlier experiment.

    If two experiments drew the same figure, such as that of a recording they share, it is shown once.
    """
    shown: dict[str, Experiment] = {}
    result: dict[str, list[dict[str, Any]]] = {}
    for experiment in report.experiments:
        figures = result[experiment.anchor] = []
        for stem in stems_of(experiment.figures):
            name = Path(stem).name.replace("_", " ")
            content = _embedded(folder, stem)
            before = shown.setdefault(content, experiment) if content else experiment
            figures.append({"name": name, "content": content, "before": None if before is experiment else before})
    return result


def _embedded(folder: Path, stem: str) -> str:
    """Return a figure's file as a data URL; "" where the folder has no readable file of suitable size."""
    paths = [folder / f"{stem}{suffix}" for suffix in _KINDS]
    with contextlib.suppress(OSError):
        sizes = {path: path.stat().st_size for path in paths if lies_in(folder, path) and path.is_file()}
        files = [path for path, size in sizes.items() if size <= LARGEST_BYTES]
        small = [path for path in files if path.suffix != ".svg" or sizes[path] <= LARGEST_SVG_BYTES]
        for path in (small or files)[:1]:
            return f"data:{_KINDS[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"
    return ""


def _formula(text: str) -> Markup:
    """Return a formula or a symbol with its indices as subscripts and its exponents as superscripts."""
    raised = _POWER.sub(r"<sup>\1</sup>", str(escape(text)))
    return Markup(_INDEX.sub(r"<i>\1</i><sub>\2</sub>", raised))


def _commands(text: str) -> Markup:
    """Return a sentence with the text between backquotes as code."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))


def _aside(text: str) -> Markup:
    """Return a cell with the text in brackets at its end in small print below the rest."""
    return Markup(_BRACKETS.sub(r"<small>\1</small>", str(escape(text))))
