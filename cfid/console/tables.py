"""Print results on the terminal: values and standard uncertainties to their significant digits."""

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table
from rich.text import Text

from cfid.console.messages import printable
from cfid.quantities.rounding import value_and_std
from cfid.records.parameters import Parameter


def print_parameters(parameters: Mapping[str, Parameter], *, title: str) -> None:
    """Print value, standard uncertainty and unit of every parameter, except lists of rows, which commands print.

    Nothing is printed if all parameters are lists of rows.
    """
    table = Table(title=Text(printable(title)), title_justify="left")
    for heading in ("parameter", "value", "std", "unit"):
        table.add_column(heading, justify="right" if heading in ("value", "std") else "left", overflow="fold")
    for name, parameter in parameters.items():
        for number in parameter.numbers(name):
            cells = (number.name, *value_and_std(number.value, number.std), parameter.unit)
            table.add_row(*(Text(printable(cell)) for cell in cells))
    if table.row_count:
        Console().print(table)
