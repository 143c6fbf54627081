"""Print results on the terminal: values and standard uncertainties to their significant digits."""

from collections.abc import Mapping, Sequence

from cfid.console.messages import echo, printable
from cfid.quantities.rounding import with_std
from cfid.quantities.values import Number, units_of
from cfid.records.parameters import Parameter


def print_parameters(parameters: Mapping[str, Parameter], *, title: str) -> None:
    """Print a line for every number: name, value and standard uncertainty, unit, and the latter relative to the value.

    Lists of rows have no line: commands print them. Nothing is printed if all parameters are lists of rows.
    """
    rows = []
    for name, parameter in parameters.items():
        numbers = list(parameter.numbers(name))
        for number, unit in zip(numbers, units_of(name, parameter.unit, len(numbers)), strict=True):
            rows.append((number.name, with_std(number.value, number.std), unit, _relative(number)))
    if not rows:
        return
    echo(title)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, value, unit, relative in rows:
        cells = (name.ljust(widths[0]), value.rjust(widths[1]), unit.ljust(widths[2]), relative.rjust(widths[3]))
        echo(printable("  ".join(cells).rstrip()))


def _relative(number: Number) -> str:
    """Return a standard uncertainty as a share of the value, "" where it is no smaller part of it."""
    if not number.std or not number.value or abs(number.std) >= abs(number.value):
        return ""
    return f"{100 * abs(number.std / number.value):.2g} %"


def columned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of as many cells each as lines, with cells below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
