"""Render a report's tables as plain LaTeX, which any pdflatex with longtable compiles.

Only the other formats contain figures, tables of windows and the fits' lines.
"""

import re
from collections.abc import Iterator

from cfid.report.content import Report
from cfid.report.experiments import title_of
from cfid.report.formats import grids
from cfid.report.formats.sealed import MARK

_ESCAPED = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "{": r"\{",
        "}": r"\}",
        "_": r"\_",
        "&": r"\&",
        "%": r"\%",
        "#": r"\#",
        "$": r"\$",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": "$<$",
        ">": "$>$",
        "|": "$|$",
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
_HEAD = r"""\documentclass[a4paper,landscape,10pt]{article}
\usepackage{longtable}
\ifdefined\pdfpagewidth\pdfpagewidth=\paperwidth\pdfpageheight=\paperheight\fi
\setlength{\textwidth}{26cm}\setlength{\oddsidemargin}{-0.8cm}\setlength{\textheight}{16.5cm}
\setlength{\topmargin}{-1.6cm}\setlength{\LTleft}{0pt}\setlength{\parindent}{0pt}
\setlength{\tabcolsep}{4pt}\sloppy
\begin{document}"""


def as_tex(report: Report) -> str:
    """Return a complete document that compiles."""
    return "\n".join([f"% {MARK}", _HEAD, *_parts(report), r"\end{document}", ""])


def _parts(report: Report) -> Iterator[str]:
    about = report.about
    yield rf"\section*{{{_tex(about.vehicle)}}}"
    if about.recorded:
        yield _tex(f"Recorded {about.days} in {about.recorded_in}.")
    yield _tex(f"Body frame: {about.body_frame}. Written {about.written:%Y-%m-%d} by cfid {about.cfid_version}.")
    if about.lab_book:
        yield _tex(f"Lab book: {'; '.join(about.lab_book)}.")
    if about.simulated_runs:
        yield rf"\textbf{{{about.simulated_runs} of {about.runs} runs are simulated.}}"
    yield r"\subsection*{What was measured, and how sure}"
    yield from _longtable(grids.summary_grid(report.summary), "lll")
    yield _tex(" ".join(filter(None, [report.summary.weakest, *report.summary.findings, *report.summary.remarks])))
    for group in report.sheet:
        yield rf"\subsection*{{{_tex(group.title)}}}"
        for quantity in group.quantities:
            origin = grids.origin_text(quantity.origin) if quantity.origin else ""
            verdict = grids.verdict(quantity.origin.accepted) if quantity.origin else ""
            words = ". ".join(filter(None, [quantity.equation, origin, verdict, quantity.missing]))
            yield rf"\paragraph{{{_tex(quantity.title)}}} {_tex(words)}."
            yield from _longtable(grids.row_grid(quantity.rows), "lllll") if quantity.rows else ()
            yield _tex(quantity.zeros)
    yield from _verdicts(report)
    for fit in report.repeats:
        yield rf"\subsection*{{Repeats: {_tex(title_of(fit.name))}}}"
        grid = grids.repeat_grid(fit)
        yield r"\footnotesize"
        yield from _longtable(grid, "l" * len(grid.head))
        yield r"\normalsize"
    if report.agreements:
        yield r"\subsection*{Across experiments}" + "\n" + r"\footnotesize"
        yield from _longtable(grids.agreement_grid(report.agreements), "lp{5cm}p{5cm}llll")
        yield _tex(" ".join(finding.text for one in report.agreements for finding in one.findings)) + r"\normalsize"
    yield from _published(report)


def _verdicts(report: Report) -> Iterator[str]:
    if not report.experiments:
        return
    yield r"\subsection*{Experiments}"
    rows = []
    for one in report.experiments:
        findings = " ".join((*one.rejections, *one.remarks, *one.notes))
        rows.append((one.title, f"{one.found:%Y-%m-%d}", grids.verdict(one.accepted), findings))
    yield from _longtable(grids.Grid(("", "fitted", "", "left out, and to be known"), tuple(rows)), "lllp{14cm}")


def _published(report: Report) -> Iterator[str]:
    sources = grids.sources_of(report.comparisons)
    yield r"\section*{Against published}" + "\n" + r"\footnotesize"
    for comparison in report.comparisons:
        unit = grids.comparison_unit(comparison)
        yield rf"\subsection*{{{_tex(comparison.title)} {_tex(f'({unit})' if unit else '')}}}"
        yield _tex(comparison.about)
        grid = grids.comparison_grid(comparison, sources)
        yield from _longtable(grid, "l" * len(grid.head))
        yield _tex(" ".join(grids.comparison_notes(comparison)))
    yield r"\begin{enumerate}"
    yield from (rf"\item {_tex(source)}" for source in sources)
    yield r"\end{enumerate}"


def _longtable(grid: grids.Grid, columns: str) -> Iterator[str]:
    yield rf"\begin{{longtable}}{{{columns}}}"
    yield _row(grid.head) + r" \hline \endhead"
    yield from map(_row, grid.rows)
    yield r"\end{longtable}"


def _row(cells: tuple[str, ...]) -> str:
    return " & ".join(map(_tex, cells)) + r" \\"


def _tex(text: str) -> str:
    """Return a text on one line that pdflatex prints verbatim; characters that its fonts lack become question marks."""
    line = re.sub(r"\s+", " ", text).translate(_ESCAPED)
    return "".join(character if " " <= character <= "~" else "?" for character in line)
