"""Print results on the terminal: values and standard uncertainties to their significant digits."""

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from cfid.console.messages import echo, fitted, printable
from cfid.records.parameters import Parameter

UNLIMITED = 10_000  # columns: more than any table needs

_NARROW = 60  # columns: on fewer, a table may have to break words
_DIGITS = 7  # of a value of unknown uncertainty; the thesis prints the same number


def print_parameters(parameters: Mapping[str, Parameter], *, title: str) -> None:
    """Print value, standard uncertainty and unit of every parameter, except lists of rows, which commands print.

    Nothing is printed if all parameters are lists of rows.
    """
    table = Table(title=Text(printable(title)), title_justify="left")
    for heading in ("parameter", "value", "std", "unit"):
        table.add_column(heading, justify="right" if heading in ("value", "std") else "left", overflow="fold")
    for name, parameter in parameters.items():
        for one in parameter.numbers(name):
            cells = (one.name, *value_and_deviation(one.value, one.std), parameter.unit)
            table.add_row(*(Text(printable(cell)) for cell in cells))
    if table.row_count:
        print_table(table)


def print_table(table: Table, *, narrow: int = _NARROW) -> None:
    """Print a table; on a terminal with fewer than `narrow` columns that would break words, print each row as lines."""
    console = Console()
    unlimited = console.options.update(max_width=UNLIMITED)
    if console.width >= narrow or console.measure(table, options=unlimited).minimum <= console.width:
        console.print(table)
        return
    if table.title:
        echo(str(table.title))
    for row in zip(*(column.cells for column in table.columns), strict=True):
        echo()
        for column, cell in zip(table.columns, row, strict=True):
            if text := str(cell):
                echo(fitted(f"{column.header}: {'; '.join(text.splitlines())}", indent=2))
    echo()


def value_and_deviation(value: Any, std: Any) -> tuple[str, str]:
    """Return a value, rounded to the second digit of its standard uncertainty, and the uncertainty."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return ("-" if value is None else str(value)), "-"
    if not isinstance(std, int | float) or not math.isfinite(std) or std <= 0:
        return f"{value:.{_DIGITS}g}", "-"
    digits = 1 + max(math.floor(math.log10(abs(value))) - math.floor(math.log10(std)), 0) + 1 if value else 2
    return f"{value:#.{min(digits, 12)}g}", f"{std:#.2g}"
