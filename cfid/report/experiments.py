"""The results of each experiment from its valid fit: verdict, numbers, figures, tables, findings and sources."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cfid.experiments import EXPERIMENTS
from cfid.findings import begun, rejection, texts
from cfid.quantities.registry import find
from cfid.quantities.values import is_rows
from cfid.records.files import lies_in
from cfid.records.fits import Fit
from cfid.records.parameters import Section, plain
from cfid.records.uncertain import OWN_FIT, number_of, parts_of
from cfid.records.values import Values
from cfid.report.sheet import number_rows

_KINDS = list(EXPERIMENTS)
_MOST_PARTS = 3  # of a variance: smaller parts are summed as others
_TITLES = {
    "budget_kg_m2": "uncertainty budget: what each input adds to the standard uncertainty, kg m^2",
    "swings": "swings: window and verdict of each",
    "mounts": "mounts: distances, and where an error in them does not matter",
    "models": "models compared",
}


def experiments_of(measurements: Mapping[str, Mapping[Fit, int]], values: Values, folder: Path) -> list[dict[str, Any]]:
    """Return all measurements in the order of the thesis' chapters, of each kind that in force first, then the latest.

    Paths are relative to `folder`, the campaign's; figures outside of it are left out with a note.
    """
    fits = [fit for fit in values.fits if fit.section.parameters]
    drawn_by = {figure: fit for fit in fits for figure in fit.figures}  # a later fit replaces an earlier one's figures
    experiments = []
    for kind in sorted(measurements, key=_place):
        held = values.in_force[kind]
        latest_first = sorted(
            measurements[kind].items(), key=lambda each: (each[0] is held, each[0].order), reverse=True
        )
        experiments += [_experiment(each, held, drawn_by, values, folder) for each in latest_first]
    return experiments


def title_of(name: str) -> str:
    """Return the title of a kind of fit, such as `Swing x` for the swing about x."""
    kind, _, rest = name.partition(" ")
    return f"{EXPERIMENTS[kind].title if kind in EXPERIMENTS else kind} {rest}".rstrip()


def stems_of(figures: Iterable[str]) -> list[str]:
    """Return the paths of figures without suffix, each once, since a figure is stored as both a PNG and an SVG file."""
    return list(dict.fromkeys(figure.removesuffix(".png").removesuffix(".svg") for figure in figures))


def _place(name: str) -> int:
    kind = name.partition(" ")[0]
    return _KINDS.index(kind) if kind in _KINDS else len(_KINDS)


def _experiment(
    measurement: tuple[Fit, int], held: Fit, drawn_by: Mapping[str, Fit], values: Values, folder: Path
) -> dict[str, Any]:
    (fit, replaced), section = measurement, measurement[0].section
    other = "" if fit is held else ", earlier" if fit.order < held.order else ", not in force"
    own = [figure for figure in fit.figures if drawn_by.get(figure) is fit]
    inside = [figure for figure in own if lies_in(folder, folder / figure)]
    outside = stems_of(figure for figure in own if figure not in inside)
    findings = (*fit.findings, *(rejection("stale", text) for text in values.outdated(fit)))
    return {
        "name": fit.name,
        "title": title_of(fit.name) + (f"{other}: {section.found:%Y-%m-%d %H:%M}" if other else ""),
        "command": fit.command,
        "method": section.method,
        "found": section.found.isoformat(),
        "cfid_version": section.cfid_version,
        "accepted": section.accepted,
        "findings": [asdict(finding) for finding in findings],
        "rejections": [begun(text) for text in texts(findings, "rejection")],
        "remarks": [begun(text) for text in (*texts(findings, "warning"), *texts(findings, "note"))],
        "parameters": [row for key, parameter in section.parameters.items() for row in number_rows(key, parameter)],
        "tables": list(_tables(fit)),
        "lines": list(fit.lines),
        "figures": inside,
        "notes": list(_notes(replaced, len(stems_of(fit.figures)) - len(stems_of(own)), outside)),
        "sources": [asdict(source) for source in section.sources],
    }


def _notes(replaced: int, drawn_over: int, outside: Sequence[str]) -> Iterator[str]:
    if replaced:
        others = "Another fit of the same recordings is" if replaced == 1 else f"{replaced} other fits"
        yield others + (" not shown: this one counts." if replaced == 1 else " of the same recordings are not shown.")
    if drawn_over:
        yield f"{drawn_over} of its figures {'was' if drawn_over == 1 else 'were'} replaced by a later fit's."
    if outside:
        yield f"Not shown, since a report reads figures of the campaign's folder alone: {', '.join(outside)}."


def _tables(fit: Fit) -> Iterator[dict[str, Any]]:
    """Yield a fit's figures of quality in one table, then its lists of rows, and what its uncertainties come from."""
    quality = {name: plain(value) for name, value in fit.quality.items() if name != "common_causes"}
    figures = {name: value for name, value in quality.items() if not is_rows(value)}
    single = [[name.replace("_", " "), value] for name, value in _flat(figures) if value not in (None, [])]
    if single:
        yield {"title": "quality of the fit", "columns": ["figure", "value"], "rows": single}
    parameters = {key: plain(parameter.value) for key, parameter in fit.section.parameters.items()}
    for name, rows in (*quality.items(), *parameters.items()):
        if is_rows(rows):
            quantity, columns = find(name), list(dict.fromkeys(column for row in rows for column in row))
            yield {
                "title": _TITLES.get(name, name.replace("_", " ")) if quantity is None else quantity.title,
                "columns": [column.replace("_", " ") for column in columns],
                "rows": [[row.get(column) for column in columns] for row in rows],
            }
    if causes := [[key, parts] for key in parameters if (parts := _causes(fit.section, key))]:
        title = "what uncertainties come from: parts of the variance, the mean over a quantity's numbers"
        yield {"title": title, "columns": ["quantity", "parts"], "rows": causes}


def _flat(content: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the entries of nested mappings, each with the names on the way to it."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name} ")
        else:
            yield f"{before}{name}", value


def _causes(section: Section, key: str) -> str:
    """Return the largest parts of a parameter's variance by cause, "" if it shares none with other fits.

    The fit's file has the standard uncertainty of each number from each cause.
    """
    moved = {cause: effects[key] for cause, effects in section.common.items() if key in effects}
    count = max((len(effects) for effects in moved.values()), default=0)
    numbers = [number_of(section, key, [float(other == place) for other in range(count)]) for place in range(count)]
    uncertain = [number for number in numbers if number.std_dev > 0]
    parts: dict[str, float] = {}
    for number in uncertain:
        for cause, std in parts_of(number).items():
            parts[cause] = parts.get(cause, 0.0) + (std / number.std_dev) ** 2 / len(uncertain)
    largest = sorted(parts.items(), key=lambda part: -part[1])
    named = [*largest[:_MOST_PARTS], ("others", sum(share for _, share in largest[_MOST_PARTS:]))]
    shares = {cause: f"{100 * share:.0f} %" for cause, share in named}
    return ", ".join(
        f"{'fit' if cause == OWN_FIT else cause} {share}" for cause, share in shares.items() if share != "0 %"
    )
