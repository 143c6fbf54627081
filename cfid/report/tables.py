"""Turn a fit's figures of quality and lists of rows into titled tables."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cfid.quantities.registry import find
from cfid.quantities.values import ENTRIES, is_matrix, is_rows
from cfid.records.parameters import Parameter, plain

_CAUSES = "common_causes"
_LARGEST = 1e100  # of standard uncertainties: the square of a larger one might overflow
_MOST_PARTS = 3  # of a variance: smaller parts are summed as others

_TITLES = {
    _CAUSES: "what uncertainties come from: parts of the variance, the mean over a quantity's numbers",
    "budget_kg_m2": "uncertainty budget: what each input adds to the standard uncertainty, kg m^2",
    "swings": "swings: window and verdict of each",
    "mounts": "mounts: distances, and where an error in them does not matter",
    "models": "models compared",
}


@dataclass(frozen=True)
class ReportTable:
    """A table of plain cells: text, numbers, booleans, lists of these, or None if unknown."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]


def parameter_tables(parameters: Mapping[str, Parameter]) -> Iterator[ReportTable]:
    """Yield a table for each parameter that is a list of rows."""
    for key, parameter in parameters.items():
        if is_rows(plain(parameter.value)):
            yield _of_rows(key, plain(parameter.value))


def quality_tables(quality: Mapping[str, Any]) -> Iterator[ReportTable]:
    """Yield a fit's quality figures: scalars in one table, and lists of rows, mappings and matrices each in its own."""
    single: list[tuple[str, Any]] = []
    tables: list[ReportTable] = []
    for name, value in plain(quality).items():
        if is_rows(value):
            tables.append(_of_rows(name, value))
        elif name == _CAUSES and _is_budget(value):
            tables.append(_of_causes(value))
        elif isinstance(value, Mapping):
            tables += _of_mapping(name, value)
        elif is_matrix(value):
            tables.append(_of_matrices(name, {"": value}))
        elif value is not None and value != []:
            single.append((_words(name), value))
    if single:
        yield ReportTable("quality of the fit", ("figure", "value"), tuple(single))
    yield from tables


def _of_mapping(name: str, content: Mapping[str, Any]) -> list[ReportTable]:
    if not content:
        return []
    if all(is_matrix(value) for value in content.values()):
        return [_of_matrices(name, content)]
    if all(isinstance(value, Mapping) for value in content.values()):
        rows = [{"": key, **_flat(value)} for key, value in content.items()]
        return [_of_rows(name, rows)]
    return [ReportTable(_title(name), ("figure", "value"), tuple((_words(k), v) for k, v in _flat(content).items()))]


def _of_causes(content: Mapping[str, Mapping[str, Any]]) -> ReportTable:
    """Return a table with one row per quantity, which lists the parts of its variance, the largest first.

    One column per cause would not fit on a page. The fit's file contains the standard uncertainty of each number from
    each cause.
    """
    rows = []
    for key, stds in content.items():
        variances = {name: [(std or 0.0) ** 2 for std in _leaves(value)] for name, value in stds.items()}
        totals = [sum(parts) for parts in zip(*variances.values(), strict=True)]
        known = [place for place, total in enumerate(totals) if total > 0]
        parts = {name: sum(one[k] / totals[k] for k in known) / len(known) for name, one in variances.items() if known}
        largest = sorted(parts.items(), key=lambda part: -part[1])
        others = sum(part for _, part in largest[_MOST_PARTS:])
        named = [*largest[:_MOST_PARTS], *([("others", others)] if others else [])]
        rows.append((key, ", ".join(f"{name} {100 * part:.0f} %" for name, part in named if round(100 * part))))
    return ReportTable(_title(_CAUSES), ("quantity", "parts"), tuple(rows))


def _is_budget(content: Any) -> bool:
    """Return whether a quantity has equally many numbers for every cause; an edited fit file may not."""
    if not isinstance(content, Mapping) or not all(isinstance(one, Mapping) and one for one in content.values()):
        return False
    each = [[list(_leaves(value)) for value in one.values()] for one in content.values()]
    alike = all(len({len(leaves) for leaves in one}) == 1 for one in each)
    return alike and all(leaf is None or _has_square(leaf) for one in each for leaves in one for leaf in leaves)


def _has_square(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < _LARGEST


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, list):
        for part in value:
            yield from _leaves(part)
    else:
        yield value


def _of_rows(name: str, rows: Sequence[Mapping[str, Any]]) -> ReportTable:
    columns = tuple(dict.fromkeys(key for row in rows for key in row))
    cells = tuple(tuple(row.get(column) for column in columns) for row in rows)
    return ReportTable(_title(name), tuple(_words(column) for column in columns), cells)


def _of_matrices(name: str, matrices: Mapping[str, Any]) -> ReportTable:
    cells = tuple((key, *(matrix[i][j] for i, j in ENTRIES.values())) for key, matrix in matrices.items())
    return ReportTable(_title(name), ("", *ENTRIES), cells)


def _flat(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in content.items():
        result |= _flat(value, f"{before}{key} ") if isinstance(value, Mapping) else {f"{before}{key}": value}
    return result


def _title(name: str) -> str:
    found = find(name)
    return found.title if found is not None else _TITLES.get(name, _words(name))


def _words(name: str) -> str:
    return name.replace("_", " ")
