"""Print results on the terminal: values and standard uncertainties to their significant digits."""

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table
from rich.text import Text

from cfid.console.messages import echo, fitted, printable
from cfid.quantities.rounding import value_and_std
from cfid.records.parameters import Parameter

UNLIMITED = 10_000  # columns: more than any table needs

_NARROW = 60  # columns: on fewer, a table may have to break words


def print_parameters(parameters: Mapping[str, Parameter], *, title: str) -> None:
    """Print value, standard uncertainty and unit of every parameter, except lists of rows, which commands print.

    Nothing is printed if all parameters are lists of rows.
    """
    table = Table(title=Text(printable(title)), title_justify="left")
    for heading in ("parameter", "value", "std", "unit"):
        table.add_column(heading, justify="right" if heading in ("value", "std") else "left", overflow="fold")
    for name, parameter in parameters.items():
        for one in parameter.numbers(name):
            cells = (one.name, *value_and_std(one.value, one.std), parameter.unit)
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
