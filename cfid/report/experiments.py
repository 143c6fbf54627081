"""The results of each experiment from its valid fit: verdict, figures, tables, findings and sources."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from cfid.experiments import EXPERIMENTS
from cfid.findings import Finding, begun, rejection, texts
from cfid.records.files import lies_in
from cfid.records.fits import Fit
from cfid.records.parameters import Source
from cfid.records.values import Values
from cfid.report.measurements import Measurement
from cfid.report.sheet import Row
from cfid.report.tables import ReportTable, parameter_tables, quality_tables

_KINDS = list(EXPERIMENTS)


@dataclass(frozen=True)
class Experiment:
    """One measurement; the paths of its figures and sources are relative to the campaign's folder."""

    name: str
    title: str
    command: str
    method: str
    found: datetime
    cfid_version: str
    accepted: bool
    findings: tuple[Finding, ...]
    parameters: tuple[Row, ...]
    tables: tuple[ReportTable, ...]
    lines: tuple[str, ...]
    figures: tuple[str, ...]
    notes: tuple[str, ...]
    sources: tuple[Source, ...]

    @property
    def rejections(self) -> tuple[str, ...]:
        """The reasons why quantities of the experiment were rejected."""
        return tuple(map(begun, texts(self.findings, "rejection")))

    @property
    def remarks(self) -> tuple[str, ...]:
        """The warnings, followed by the notes."""
        return tuple(map(begun, (*texts(self.findings, "warning"), *texts(self.findings, "note"))))

    @property
    def anchor(self) -> str:
        """The target of links to the experiment."""
        stem = "".join(letter if letter.isalnum() else "-" for letter in self.name)
        first = self.sources[0].sha256[:8] if self.sources else "0"
        return f"{stem}-{self.found:%Y%m%d%H%M%S}-{first}"  # the hash separates fits of the same second


def experiments_of(
    measured: Mapping[str, Sequence[Measurement]],
    fits: Iterable[Fit],
    values: Values,
    folder: Path,
) -> tuple[Experiment, ...]:
    """Return all measurements in the order of the thesis' chapters, of each kind that in force first, then the latest.

    Figures outside `folder`, the campaign's, are left out with a note.
    """
    drawn_by = {figure: fit for fit in fits for figure in fit.figures}  # a later fit replaces an earlier one's figures
    kinds, held = sorted(measured, key=_place), values.in_force
    return tuple(
        _experiment(one, drawn_by, values.outdated(one.fit), folder, held[kind])
        for kind in kinds
        for one in sorted(measured[kind], key=lambda one: (one.fit is held[one.fit.name], one.fit.order))[::-1]
    )


def title_of(name: str) -> str:
    """Return the title of a kind of fit, such as `swing x` for the swing about x."""
    kind, _, rest = name.partition(" ")
    title = EXPERIMENTS[kind].title if kind in EXPERIMENTS else kind
    return f"{title} {rest}".rstrip()


def _place(name: str) -> int:
    kind = name.partition(" ")[0]
    return _KINDS.index(kind) if kind in _KINDS else len(_KINDS)


def _experiment(
    measurement: Measurement, drawn_by: Mapping[str, Fit], stale: tuple[str, ...], folder: Path, held: Fit
) -> Experiment:
    fit = measurement.fit
    other = "earlier" if fit.order < held.order else "not in force"
    title = title_of(fit.name) + ("" if fit is held else f", {other}: {fit.section.found:%Y-%m-%d %H:%M}")
    own = [figure for figure in fit.figures if drawn_by.get(figure) is fit]
    inside = [figure for figure in own if lies_in(folder, folder / figure)]
    outside = [figure for figure in own if figure not in inside]
    return Experiment(
        name=fit.name,
        title=title,
        command=fit.command,
        method=fit.section.method,
        found=fit.section.found,
        cfid_version=fit.section.cfid_version,
        accepted=fit.section.accepted,
        findings=(*fit.findings, *(rejection("stale", text) for text in stale)),
        parameters=tuple(
            Row(f"{key} {entry.place}".rstrip(), entry.value, entry.std, parameter.unit)
            for key, parameter in fit.section.parameters.items()
            for entry in parameter.numbers(key)
        ),
        tables=(*quality_tables(fit.quality), *parameter_tables(fit.section.parameters)),
        lines=fit.lines,
        figures=tuple(inside),
        notes=(
            *_replaced(measurement),
            *_drawn_over(len(stems_of(fit.figures)) - len(stems_of(own))),
            *_outside(stems_of(outside)),
        ),
        sources=fit.section.sources,
    )


def _replaced(measurement: Measurement) -> list[str]:
    if not measurement.replaced:
        return []
    count = len(measurement.replaced)
    fits = "Another fit" if count == 1 else f"{count} other fits"
    return [f"{fits} of the same recordings {'is' if count == 1 else 'are'} not shown: this one counts."]


def stems_of(figures: Iterable[str]) -> list[str]:
    """Return the paths of figures without suffix, each once, since a figure is stored as both a PNG and an SVG file."""
    return list(dict.fromkeys(figure.removesuffix(".png").removesuffix(".svg") for figure in figures))


def _outside(stems: Sequence[str]) -> list[str]:
    if not stems:
        return []
    return [f"Not shown, since a report reads figures of the campaign's folder alone: {', '.join(stems)}."]


def _drawn_over(count: int) -> list[str]:
    if not count:
        return []
    return [f"{count} of its figures {'was' if count == 1 else 'were'} replaced by a later fit's."]
