"""Render a report as HTML, Markdown, TeX or JSON; texts of others are escaped in each.

A page of HTML has its figures embedded, and no script. Markdown has tables that GitHub and pandoc read, and links to
figures. TeX has the tables alone, which any pdflatex with longtable compiles.
"""

import base64
import contextlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from cfid.console.messages import printable_lines
from cfid.records.files import lies_in
from cfid.report import texts
from cfid.report.experiments import stems_of
from cfid.report.sealed import MARK

Format = Literal["html", "md", "json", "tex"]

LARGEST_SVG_BYTES = 400_000  # of a larger figure, its PNG is embedded, which a browser draws faster
_LARGEST_BYTES = 20_000_000  # larger figures are not embedded at all
_KINDS = {".svg": "image/svg+xml", ".png": "image/png"}
_FIRST = {  # the figures of the first screen by the end of their names, with their captions
    "_swing": "One swing and its fit",
    "fit_thrust": "Thrust over command",
    "tf_step": "Thrust after a step of the command",
    "drag_models": "Drag force over the rotors' speed",
}
_INDEX = re.compile(r"\b([^\W\d_]\d?)_(\w+)")
_POWER = re.compile(r"\^(\w+)")
_BRACKETS = re.compile(r" \(([^()]+)\)$")
_CODE = re.compile(r"`([^`]+)`")
_MARKDOWN = str.maketrans(
    {sign: f"\\{sign}" for sign in "\\*_`|[]{}"} | {"&": "&amp;", "<": "&lt;", ">": "&gt;", "$": "&#36;", "~": "&#126;"}
)
_TEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        **{sign: f"\\{sign}" for sign in "{}_&%#$"},
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        **{sign: f"${sign}$" for sign in "<>|"},
        '"': "''",
        "`": "'",
        "−": "$-$",
        "·": r"$\cdot$",
        "±": r"$\pm$",
        "°": r"$^\circ$",
        "…": r"\dots{}",
        "“": "``",
        "”": "''",
        "²": "$^2$",
        "³": "$^3$",
        "χ": r"$\chi$",
        "τ": r"$\tau$",
        "ω": r"$\omega$",
        "δ": r"$\delta$",
        "Σ": r"$\Sigma$",
        **{raised: f"$^{{{digit}}}$" for raised, digit in zip("⁻⁰¹⁴⁵⁶⁷⁸⁹", "-01456789", strict=True)},
        **dict(zip("äöüÄÖÜß", (r"\"a", r"\"o", r"\"u", r"\"A", r"\"O", r"\"U", r"\ss{}"), strict=True)),
    }
)


def rendered(report: Mapping[str, Any], form: Format, folder: Path) -> str:
    """Return a report's text; figures are read from `folder`, the campaign's, and a missing one is named instead.

    Characters that a terminal would obey become question marks, or escapes in JSON.
    """
    if form == "json":
        return json.dumps({"made_by": MARK, **report}, indent=1, allow_nan=False) + "\n"
    settings: dict[Format, dict[str, Any]] = {
        "html": {},
        "md": {"finalize": _escaping(_markdown)},
        "tex": {
            "finalize": _escaping(_tex),
            "block_start_string": "<%",
            "block_end_string": "%>",
            "variable_start_string": "<<",
            "variable_end_string": ">>",
            "comment_start_string": "<#",
            "comment_end_string": "#>",
        },
    }
    environment = Environment(
        loader=PackageLoader("cfid.report"),
        autoescape=True,  # with `finalize`, which leaves nothing to escape for HTML
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        **settings[form],
    )
    environment.filters |= {"raw": Markup, "formula": _formula, "aside": _aside, "commands": _html_commands}
    if form == "md":
        environment.filters |= {"code": _code, "commands": _commands, "fenced": _fenced, "figure": _figure_link}
    text = environment.get_template(f"report.{form}.j2").render(
        report=report,
        texts=texts,
        mark=MARK,
        sources=texts.sources_of(report["published"]),
        compared=_embedded(folder, "figures/compare") if form == "html" else "",
        figures=_figures(report["experiments"], folder) if form == "html" else [],
    )
    return printable_lines(text)


def _escaping(escaped: Callable[[str], str]) -> Callable[[Any], Markup]:
    """Return what a template does with each value before it is written: escape it, unless it is a part of the page."""
    return lambda value: value if isinstance(value, Markup) else Markup(escaped(str(value)))


def _markdown(text: str) -> str:
    """Return a text on one line without characters that are special in Markdown, or in HTML inside Markdown."""
    return re.sub(r"\s+", " ", text).translate(_MARKDOWN)


def _tex(text: str) -> str:
    """Return a text on one line that pdflatex prints verbatim; characters that its fonts lack become question marks."""
    line = re.sub(r"\s+", " ", text).translate(_TEX)
    return "".join(character if " " <= character <= "~" else "?" for character in line)


def _code(text: str) -> Markup:
    return _commands(f"`{text}`")


def _commands(text: str) -> Markup:
    """Return a sentence in Markdown with the text between backquotes as code."""
    parts = re.sub(r"\s+", " ", text).split("`")
    return Markup("".join(f"`{part}`" if place % 2 and part else _markdown(part) for place, part in enumerate(parts)))


def _fenced(lines: Sequence[str]) -> Markup:
    """Return lines unchanged, between fences that are longer than any fence in them."""
    text = "\n".join(lines)
    fence = max(["``", *re.findall("`+", text)], key=len) + "`"
    return Markup(f"{fence}\n{text}\n{fence}")


def _figure_link(path: str) -> Markup:
    return Markup(f"![{_markdown(Path(path).stem)}](<{quote(path, errors='replace')}>)")


def _html_commands(text: str) -> Markup:
    """Return a sentence with the text between backquotes as code."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))


def _formula(text: str) -> Markup:
    """Return a formula or a symbol with its indices as subscripts and its exponents as superscripts."""
    raised = _POWER.sub(r"<sup>\1</sup>", str(escape(text)))
    return Markup(_INDEX.sub(r"<i>\1</i><sub>\2</sub>", raised))


def _aside(text: str) -> Markup:
    """Return a cell with the text in brackets at its end in small print below the rest."""
    return Markup(_BRACKETS.sub(r"<small>\1</small>", str(escape(text))))


def _figures(experiments: Sequence[Mapping[str, Any]], folder: Path) -> list[list[dict[str, Any]]]:
    """Return the figures of each experiment: name, embedded content ("" if none), `first`, `before`.

    A figure is shown once: on the first screen if `first` is its caption there, else with the first experiment that
    has it, at the place `before` if that is another one. Experiments that share a recording share its figure.
    """
    captions, shown = dict(_FIRST), dict[str, int]()
    figures: list[list[dict[str, Any]]] = []
    for place, experiment in enumerate(experiments):
        figures.append([])
        for stem in stems_of(experiment["figures"]):
            content, name = _embedded(folder, stem), Path(stem).name
            before = shown.setdefault(content, place) if content else place
            ending = next((ending for ending in captions if content and name.endswith(ending)), "")
            figures[-1].append(
                {
                    "name": name.replace("_", " "),
                    "content": content,
                    "first": captions.pop(ending, ""),
                    "before": None if before == place else before,
                }
            )
    return figures


def _embedded(folder: Path, stem: str) -> str:
    """Return a figure's file as a data URL; "" where the folder has no readable file of suitable size."""
    paths = [folder / f"{stem}{suffix}" for suffix in _KINDS]
    with contextlib.suppress(OSError):
        sizes = {path: path.stat().st_size for path in paths if lies_in(folder, path) and path.is_file()}
        files = [path for path, size in sizes.items() if size <= _LARGEST_BYTES]
        small = [path for path in files if path.suffix != ".svg" or sizes[path] <= LARGEST_SVG_BYTES]
        for path in (small or files)[:1]:
            return f"data:{_KINDS[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"
    return ""
