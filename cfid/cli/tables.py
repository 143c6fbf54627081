"""Results on the terminal: values and deviations to the digits that mean something."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cfid.parameters import Parameter

_DIGITS = 7  # of a value whose deviation is unknown; the thesis prints as many
_MATRIX = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_ALL_ENTRIES = {f"{row}{column}": (i, j) for i, row in enumerate("xyz") for j, column in enumerate("xyz")}


def print_parameters(parameters: "Mapping[str, Parameter]", *, title: str) -> None:
    """Print value, one standard deviation and unit of every parameter; a list of rows is its command's to print."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for heading in ("parameter", "value", "std", "unit"):
        table.add_column(heading, justify="right" if heading in ("value", "std") else "left", overflow="fold")
    for name, parameter in parameters.items():
        for label, value, std in _scalars(name, parameter):
            table.add_row(label, *value_and_deviation(value, std), parameter.unit)
    Console().print(table)


def value_and_deviation(value: Any, std: Any) -> tuple[str, str]:
    """Return a value to the digit that its deviation's second digit stands at, and the deviation."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return ("-" if value is None else str(value)), "-"
    if not isinstance(std, int | float) or not math.isfinite(std) or std <= 0:
        return f"{value:.{_DIGITS}g}", "-"
    digits = 1 + max(math.floor(math.log10(abs(value))) - math.floor(math.log10(std)), 0) + 1 if value else 2
    return f"{value:#.{min(digits, 12)}g}", f"{std:#.2g}"


def _scalars(name: str, parameter: "Parameter") -> Iterator[tuple[str, Any, Any]]:
    from cfid.parameters import plain

    value, std = plain(parameter.value), plain(parameter.std)
    if _is_rows(value):
        return
    if not isinstance(value, list):
        yield name, value, std
    elif len(value) == 3 and isinstance(value[0], list):
        entries = _MATRIX if all(value[j][i] == value[i][j] for i, j in _MATRIX.values()) else _ALL_ENTRIES
        for entry, (i, j) in entries.items():
            yield f"{name} {entry}", value[i][j], std[i][j] if std else None
    else:
        for i, item in enumerate(value):
            yield f"{name} [{i}]", item, std[i] if std else None


def _is_rows(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], Mapping)
