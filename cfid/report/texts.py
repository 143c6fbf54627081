"""The report's tables as text: headings and rows for every template, with numbers to two digits of their uncertainty.

Numbers of one table row or quantity share a power of ten, which precedes the unit.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from cfid.quantities.rounding import value_and_std
from cfid.units import COVERAGE_95

Content = Mapping[str, Any]

_PLAIN = (1e-1, 1e4)  # sizes that need no power of ten
_SMALLEST = 1e-5  # of a number after scaling by its power of ten
_MILLI = -3
_THOUSANDTHS = {"kg": "g", "kg/s": "g/s", "s": "ms", "m": "mm", "N": "mN", "Nm": "mNm", "N m": "mN m"}
_MOST_COLUMNS = 10  # of a table on a page
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Grid(NamedTuple):
    """Headings and rows of text; a cell is empty if its value is unknown."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def number_grid(rows: Sequence[Content], heading: str = "") -> Grid:
    """Return numbers with their standard uncertainties and 95 % intervals."""
    families: dict[tuple[str, str], list[float | None]] = {}
    for row in rows:
        families.setdefault(_family(row), []).extend([row["value"], row["std"]])
    lines = []
    for row in rows:
        power = _power(row, families[_family(row)])
        value, std = _value_and_std(row["value"], row["std"], power)
        interval = ""
        if std:
            low, high = (row["value"] + sign * COVERAGE_95 * row["std"] for sign in (-1, 1))
            interval = " to ".join(_value_and_std(end, row["std"], power)[0] for end in (low, high))
        lines.append((row["symbol"], value, std, interval, with_power(row["unit"], power)))
    return Grid((heading, "value", "std", "95 % interval", "unit"), lines)


def _family(row: Content) -> tuple[str, str]:
    """Return the key of the numbers that share a power of ten."""
    return row["symbol"].partition(" ")[0].partition("_")[0], row["unit"]


def _power(row: Content, family: Iterable[float | None]) -> int:
    """Return the family's power of ten, or the row's own where the family's would leave only zeros.

    A value that is known to many digits, such as a time since 1970, is printed in its own unit.
    """
    sizes = [abs(x) for x in (row["value"], row["std"]) if x]
    shared, own = power_of_ten(family), power_of_ten(sizes)
    for power in (shared, own):
        if all(size >= _SMALLEST * 10.0**power for size in sizes):
            return power
    return min(own, 0)


def verdict(accepted: bool | None) -> str:
    """Return the verdict on a quantity in one word; a value stated by hand is `stated`."""
    return "stated" if accepted is None else "accepted" if accepted else "rejected"


def origin_text(origin: Content) -> str:
    """Return how a quantity was found, and when."""
    counts = {"recording": origin["recordings"], "file": origin["files"]}
    sources = [f"one {what}" if count == 1 else f"{count} {what}s" for what, count in counts.items() if count]
    day = f"{minute(origin['found'])} UTC" if origin["found"] else ""
    return ", ".join(filter(None, [origin["how"], f"from {' and '.join(sources)}" if sources else "", day]))


def minute(time: str) -> str:
    """Return day, hour and minute of a time in ISO format."""
    return time[:16].replace("T", " ")


def recorded(about: Content) -> str:
    """Return the days of the runs and their number, with those being recorded and those that no fit selects."""
    days = " to ".join(dict.fromkeys(start[:10] for start in about["recorded"]))
    runs = "1 run" if about["runs"] == 1 else f"{about['runs']} runs"
    parts = {"being recorded": about["growing_runs"], "not usable or excluded": about["unused_runs"]}
    named = " and ".join(f"{count} of them {state}" for state, count in parts.items() if count)
    return f"Recorded {days} in {', '.join(filter(None, [runs, named]))}."


def summary_grid(summary: Content) -> Grid:
    """Return the main numbers in plain units."""
    rows = [(number["title"], number["value"], number["std"]) for number in summary["numbers"]]
    return Grid(("", "value", "uncertainty"), rows)


def table_grid(table: Content) -> Grid:
    """Return a fit's table as text; one with many columns and fewer rows has its columns as rows."""
    table_rows = [list(table["columns"]), *([cell_text(cell) for cell in row] for row in table["rows"])]
    if len(table["columns"]) > max(_MOST_COLUMNS, len(table["rows"])):
        table_rows = [list(row) for row in zip(*table_rows, strict=True)]
    return Grid(table_rows[0], table_rows[1:])


def verdict_grid(experiments: Iterable[Content]) -> Grid:
    """Return the verdict on each experiment with all its findings."""
    rows = [
        (
            experiment["title"],
            experiment["found"][:10],
            verdict(experiment["accepted"]),
            " ".join((*experiment["rejections"], *experiment["remarks"], *experiment["notes"])),
        )
        for experiment in experiments
    ]
    return Grid(("", "fitted", "", "findings"), rows)


def repeat_grid(repeat: Content) -> Grid:
    """Return the readings of all quantities of a kind of fit side by side, with the test of their agreement."""
    made = (minute(fit["found"]) + ("" if fit["accepted"] else ", rejected") for fit in repeat["made"])
    rows = []
    for quantity in repeat["quantities"]:
        readings = [reading or {"value": None, "std": None} for reading in quantity["readings"]]
        power = power_of_ten(reading["value"] for reading in readings)
        is_tested = quantity["chi_squared"] is not None
        rows.append(
            (
                quantity["quantity"],
                cell_text(quantity["agrees"]),
                with_power(quantity["unit"], power),
                *(plus_minus(reading["value"], reading["std"], power) for reading in readings),
                plus_minus(quantity["mean"], quantity["mean_std"], power),
                plus_minus(quantity["drift"], quantity["drift_std"], power),
                f"{quantity['chi_squared']:.1f} of {quantity['freedom']}" if is_tested else "",
                f"{100 * quantity['probability']:.2g} %" if is_tested else "",
            )
        )
    return Grid(("", "agree", "unit", *made, "mean", "drift", "χ²", "by chance"), rows)


def agreement_verdict(pair: Content) -> str:
    """Return whether two experiments agree on a property, in one word."""
    return "agree" if pair["agrees"] else "disagree"


def agreement_text(pair: Content) -> str:
    """Return a property as found by two experiments, with their distance, or which of the two is a lower limit."""
    power = power_of_ten([pair["first_value"], pair["second_value"]])
    unit = with_power(pair["unit"], power)
    first, second = (
        f"{_with_unit(plus_minus(pair[f'{which}_value'], pair[f'{which}_std'], power), unit)} by {pair[which]}"
        for which in ("first", "second")
    )
    if pair["at_least"]:
        return f"{pair['title']}: {first}; it has to be at least {second}"
    return f"{pair['title']}: {first}, {second}, {abs(pair['in_std']):.1f} standard uncertainties apart"


def _with_unit(number: str, unit: str) -> str:
    """Return a number with its unit; a power of ten multiplies value and uncertainty."""
    if unit.startswith("10"):
        return f"({number})·{unit}" if "±" in number else f"{number}·{unit}"
    return f"{number} {unit}".rstrip()


def published_grid(rows: Sequence[Content], sources: Mapping[str, int]) -> Grid:
    """Return published values beside the campaign's, with sources as numbers of the list that follows."""
    lines = []
    for row in rows:
        power = power_of_ten([row["value"], row["own"]])
        far = "" if row["deviations"] is None else f", {row['deviations']:.3g} std"
        verdict = "" if row["own"] is None else "excluded" if row["excluded"] else "agrees" if far else "not judged"
        lines.append(
            (
                row["quantity"],
                with_power(row["unit"], power),
                plus_minus(row["own"], row["own_std"], power),
                plus_minus(row["value"], row["std"], power),
                f"{row['ratio']:.3g}" if row["own"] and row["ratio"] is not None else "",
                verdict + far,
                f"{row['who']}, {row['vehicle']} [{sources[row['source']]}]",
            )
        )
    return Grid(("", "unit", "yours", "theirs", "ratio", "", "who"), lines)


def published_remarks(rows: Iterable[Content]) -> list[str]:
    """Return what is known against published values, each remark once with the values that it concerns."""
    named: dict[str, dict[str, None]] = {}
    for row in rows:
        if row["remark"]:
            named.setdefault(row["remark"], {})[f"{row['quantity']} of {row['who']} ({row['vehicle']})"] = None
    return [f"{', '.join(names)}: {remark}." for remark, names in named.items()]


def sources_of(rows: Iterable[Content]) -> dict[str, int]:
    """Return the sources of published values, numbered in order of appearance."""
    return {source: number for number, source in enumerate(dict.fromkeys(row["source"] for row in rows), start=1)}


def runs_grid(runs: Iterable[Content]) -> Grid:
    """Return the campaign's recordings."""
    rows = []
    for run in runs:
        excluded = f"excluded: {run['excluded']}" if run["excluded"] else ""
        note = "; ".join(filter(None, ["simulated" * run["simulated"], excluded, run["note"]]))
        lost = "unknown" if run["lost"] is None else cell_text(run["lost"])
        rows.append((run["name"], run["what"], run["state"], cell_text(run["rows"]), lost, note))
    return Grid(("run", "what", "state", "rows", "lost", "note"), rows)


def _value_and_std(value: float | None, std: float | None, power: int) -> tuple[str, str]:
    """Return a value and its standard uncertainty in units of a power of ten; "" is unknown."""
    if value is None or not math.isfinite(value):
        return "", ""
    scale = 10.0**-power
    shown, spread = value_and_std(value * scale, None if std is None else std * scale)
    if std is None or spread == "-":
        return _typeset(shown), ""
    if "e" in spread and "e" not in shown:  # in a row of numbers, a small uncertainty has the decimals of its value
        spread = f"{std * scale:.{len(shown.partition('.')[2])}f}"
    return _typeset(shown), _typeset(spread)


def plus_minus(value: float | None, std: float | None, power: int) -> str:
    """Return a value and its standard uncertainty, if known, in units of a power of ten."""
    shown, spread = _value_and_std(value, std, power)
    if spread:
        return f"{shown} ± {spread}"
    return _number(value * 10.0**-power, 4) if shown and value is not None else ""


def power_of_ten(values: Iterable[float | None]) -> int:
    """Return the multiple of three that scales the largest of some values to 1 to 1000, or 0 if none is needed."""
    largest = max((abs(x) for x in values if x is not None and math.isfinite(x)), default=0.0)
    if largest == 0 or _PLAIN[0] <= largest < _PLAIN[1]:
        return 0
    return 3 * math.floor(math.log10(largest) / 3)


def with_power(unit: str, power: int) -> str:
    """Return a unit after its power of ten, as in `10⁻⁶ kg m²`, or the plain unit of that size: g, ms, mm, mN.

    The unit of a pure number is "".
    """
    name, bracket, rest = unit.partition("(")
    if power == _MILLI and (plain := _THOUSANDTHS.get(name)):
        return f"{plain}{bracket}{rest}"
    raised = "" if unit == "1" else unit.replace("^2", "²").replace("^3", "³")
    return " ".join(filter(None, [f"10{str(power).translate(_SUPERSCRIPTS)}" if power else "", raised]))


def cell_text(value: Any) -> str:
    """Return the text of a table cell with a value of any type, or "" if unknown."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return _typeset(str(value))
    if isinstance(value, float):
        return _number(value, 5) if math.isfinite(value) else ""
    if isinstance(value, Mapping):
        value = [f"{name} {cell_text(item)}" for name, item in value.items()]
    if isinstance(value, list | tuple):
        return ", ".join(cell_text(item) for item in value)
    return str(value)


def _number(value: float, digits: int) -> str:
    return _typeset(f"{value + 0.0:.{digits}g}")  # a sum with zero has no negative zero


def _typeset(number: str) -> str:
    """Return a number with a minus sign that is as wide as a plus sign, and with its exponent raised."""
    mantissa, _, exponent = number.partition("e")
    mantissa = mantissa.replace("-", "−")
    return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPTS)}" if exponent else mantissa
