"""The report's tables as text, for HTML, Markdown and TeX alike."""

from typing import NamedTuple

from cfid.report.agreement import Agreement
from cfid.report.comparison import ComparisonRow, PublishedComparison
from cfid.report.content import RunLine
from cfid.report.formats.numbers import against, cell_text, plus_minus_in, power_of_ten, printed, with_power
from cfid.report.repeats import Repeat, RepeatedFit
from cfid.report.sheet import Row, ValueOrigin
from cfid.report.summary import FirstScreen
from cfid.report.tables import ReportTable

ABOUT_SHEET = (
    "Each value has its standard uncertainty and its 95 % interval, 1.96 standard uncertainties either side as of a "
    "normal distribution. Coefficients of one polynomial belong together: their errors are correlated."
)
ABOUT_REPEATS = (
    "One quantity from different recordings. The mean is weighted by the uncertainties, drift is the last reading less "
    "the first. χ² adds up the squared distances from the mean in standard uncertainties; “by chance” is how often "
    "independent readings with these uncertainties would scatter as much or more. Below 1 % they do not agree, and one "
    "quantity in a hundred falls below by chance. What all readings share, such as mass and geometry, is in each "
    "uncertainty but does not scatter: agreement does not prove that part, and the mean's uncertainty keeps it. "
    "Rejected readings are shown and left out of the test."
)
ABOUT_AGREEMENT = (
    "One property by two experiments, with the difference over its joint uncertainty; causes that both share, as an "
    "arm, count once. Beyond 3 standard uncertainties one of the two is wrong, but for a first "
    "one that may exceed the second."
)
ABOUT_PUBLISHED = (
    "Published values in one unit, with their difference from yours. Vehicles, propellers, batteries and loads "
    "differ: a difference is not an error by itself."
)


_SMALLEST = 1e-5  # of a number after scaling by its power of ten


class Grid(NamedTuple):
    """Headings and rows of text; a cell is empty if its value is unknown."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def summary_grid(summary: FirstScreen) -> Grid:
    """Return the main numbers in plain units."""
    return Grid(("", "value", "uncertainty"), tuple((one.title, one.value, one.std) for one in summary.numbers))


def row_grid(rows: tuple[Row, ...], heading: str = "") -> Grid:
    """Return numbers with their standard uncertainties and 95 % intervals."""
    families: dict[tuple[str, str], list[float | None]] = {}
    for row in rows:
        families.setdefault(row.family, []).extend([row.value, row.std])
    lines = []
    for row in rows:
        power = _power(row, families[row.family])
        value, std, low, high = printed(row.value, row.std, power)
        interval = f"{low} to {high}" if low else ""
        lines.append((row.symbol, value, std, interval, with_power(row.unit, power)))
    return Grid((heading, "value", "std", "95 % interval", "unit"), tuple(lines))


def _power(row: Row, family: list[float | None]) -> int:
    """Return the family's power of ten, or the row's own where the family's would leave only zeros.

    A value that is known to many digits, such as a time since 1970, is printed in its own unit.
    """
    sizes = [abs(x) for x in (row.value, row.std) if x]
    shared, own = power_of_ten(family), power_of_ten(sizes)
    for power in (shared, own):
        if all(size >= _SMALLEST * 10.0**power for size in sizes):
            return power
    return min(own, 0)


def verdict(accepted: bool | None) -> str:
    """Return the verdict on a quantity in one word; a value stated by hand is `stated`."""
    return "stated" if accepted is None else "accepted" if accepted else "rejected"


def origin_text(origin: ValueOrigin) -> str:
    """Return how a quantity was found, and when."""
    sources = [_counted(origin.recordings, "recording"), _counted(origin.files, "file")]
    origins = " and ".join(filter(None, sources))
    day = f"{origin.found:%Y-%m-%d %H:%M} UTC" if origin.found else ""
    return ", ".join(filter(None, [origin.how, f"from {origins}" if origins else "", day]))


def _counted(count: int, what: str) -> str:
    return {0: "", 1: f"one {what}"}.get(count, f"{count} {what}s")


def table_grid(table: ReportTable) -> Grid:
    """Return a fit's table as text."""
    return Grid(table.columns, tuple(tuple(cell_text(cell) for cell in row) for row in table.rows))


def repeat_grid(fit: RepeatedFit) -> Grid:
    """Return the readings of all quantities side by side, with the test of their agreement."""
    made = (f"{one.found:%Y-%m-%d %H:%M}{'' if one.accepted else ', rejected'}" for one in fit.made)
    head = ("", "unit", *made, "mean", "drift", "χ²", "by chance", "agree")
    return Grid(head, tuple(_repeat_row(repeat) for repeat in fit.quantities))


def _repeat_row(repeat: Repeat) -> tuple[str, ...]:
    values = [reading.value if reading else None for reading in repeat.readings]
    power = power_of_ten(values)
    readings = (plus_minus_in(one.value, one.std, power) if one else "" for one in repeat.readings)
    test = "" if repeat.chi_squared is None else f"{repeat.chi_squared:.1f} of {repeat.freedom}"
    chance = "" if repeat.probability is None else f"{100 * repeat.probability:.2g} %"
    agrees = "" if repeat.agrees is None else "yes" if repeat.agrees else "no"
    mean = plus_minus_in(repeat.mean, repeat.mean_std, power)
    drift = plus_minus_in(repeat.drift, repeat.drift_std, power)
    return (repeat.quantity, with_power(repeat.unit, power), *readings, mean, drift, test, chance, agrees)


def agreement_grid(agreements: tuple[Agreement, ...]) -> Grid:
    """Return properties as found by two experiments each, with the difference over its joint uncertainty."""
    return Grid(
        ("", "first", "second", "unit", "difference", "over its std", "agree"),
        tuple(_agreement_row(one) for one in agreements),
    )


def _agreement_row(one: Agreement) -> tuple[str, ...]:
    power = power_of_ten([one.first_value, one.second_value])
    first = plus_minus_in(one.first_value, one.first_std, power)
    second = plus_minus_in(one.second_value, one.second_std, power)
    return (
        one.title,
        f"{first} ({one.first})",
        f"{second} ({one.second})",
        with_power(one.unit, power),
        plus_minus_in(one.difference, one.difference_std, power),
        f"{one.in_std:+.1f}",
        ("yes, may exceed it" if one.at_least else "yes") if one.agrees else "no",
    )


def comparison_grid(comparison: PublishedComparison, sources: dict[str, int]) -> Grid:
    """Return a comparison with values in one power of ten, and with sources as numbers of the list that follows."""
    lines = [comparison.yours, *comparison.others] if comparison.yours else list(comparison.others)
    power = power_of_ten(value for line in lines for value in line.values)
    unit = with_power(comparison.unit, power)
    heads = tuple(f"{column}, {unit}" if len(comparison.columns) == 1 else column for column in comparison.columns)
    rows = []
    for line in lines:
        source = f"[{sources[line.source]}]" if line.source else ""
        rows.append((line.who, line.vehicle, *_values(line, comparison, power), source))
    return Grid(("", "vehicle", *heads, "source"), tuple(rows))


def comparison_notes(comparison: PublishedComparison) -> list[str]:
    """Return the notes on a comparison's rows, each note once with the rows that it concerns."""
    lines = [*([comparison.yours] if comparison.yours else []), *comparison.others]
    who = [line.who for line in lines]
    named: dict[str, list[str]] = {}
    for line in lines:
        name = line.who if who.count(line.who) == 1 else f"{line.who} ({line.vehicle})"
        for note in filter(None, (line.frame, line.note)):
            named.setdefault(note, []).append(name)
    return [f"{', '.join(names)}: {note}." for note, names in named.items()]


def comparison_unit(comparison: PublishedComparison) -> str:
    """Return the unit of a comparison with several columns, with the power of ten of its values."""
    lines = [comparison.yours, *comparison.others] if comparison.yours else comparison.others
    power = power_of_ten(value for line in lines for value in line.values)
    return with_power(comparison.unit, power) if len(comparison.columns) > 1 else ""


def _values(line: ComparisonRow, comparison: PublishedComparison, power: int) -> list[str]:
    yours = comparison.yours
    if line is yours:
        std = comparison.yours_std or (None,) * len(line.values)
        return [plus_minus_in(x, s, power) for x, s in zip(line.values, std, strict=True)]
    texts = []
    for place, value in enumerate(line.values):
        difference = against(value, yours.values[place]) if yours else ""
        texts.append(plus_minus_in(value, None, power) + (f" ({difference})" if difference else ""))
    return texts


def sources_of(comparisons: tuple[PublishedComparison, ...]) -> dict[str, int]:
    """Return the sources of comparisons, numbered in order of appearance."""
    named = dict.fromkeys(line.source for one in comparisons for line in one.others)
    return {source: number for number, source in enumerate(named, start=1)}


def runs_grid(runs: tuple[RunLine, ...]) -> Grid:
    """Return the campaign's recordings."""
    rows = []
    for run in runs:
        excluded = f"excluded: {run.excluded}" if run.excluded else ""
        note = "; ".join(filter(None, ["simulated" * run.simulated, excluded, run.note]))
        lost = cell_text("unknown" if run.lost is None else run.lost)
        rows.append((run.name, run.what, run.state, cell_text(run.rows), lost, note))
    return Grid(("run", "what", "state", "rows", "lost", "note"), tuple(rows))
