"""The columns of the registry."""

from dataclasses import dataclass
from enum import StrEnum


class Shape(StrEnum):
    """The shape of a value, as messages print it."""

    NUMBER = "a number"
    LIST = "a list of numbers"
    NUMBER_OR_LIST = "a number or a list of numbers"
    POLYNOMIAL = "a list of coefficients"
    MATRIX = "a matrix of 3 times 3 numbers"
    ROWS = "a list of rows"


@dataclass(frozen=True)
class Range:
    """The least and the largest plausible size, ends included, and why.

    `of` names the part of a value that is checked: "" each number, "size" each number without its sign, "diagonal" the
    diagonal of a matrix, "slope" the slope of a polynomial at zero. With `at`, a polynomial's value there is checked.
    """

    least: float
    largest: float
    reason: str
    of: str = ""
    at: float | None = None


@dataclass(frozen=True)
class Quantity:
    """A quantity under its public key; in a key, `<axis>` stands for any name, and `[...]` is optional.

    `unit` is that of --json and parameters.toml. A polynomial gives a value with the unit `of` from one with the unit
    `over`; its highest power comes first unless `lowest_first` is set. `count` is how many numbers a list has, where
    that is known, and `places` are their names. `columns` are the columns of rows that must be numbers, `measured`
    those that a rejection removes. `section` is the quantity's section of parameters.toml, `given_by` the way to
    measure it. `of_the_run` marks a property of a run, not of the vehicle.
    """

    key: str
    unit: str
    symbol: str
    title: str
    shape: Shape = Shape.NUMBER
    plausible: Range | None = None
    count: int | None = None
    places: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    of: str = ""
    over: str = ""
    lowest_first: bool = False
    of_the_run: bool = False
    section: str = ""
    given_by: str = ""


@dataclass(frozen=True)
class FitKind:
    """A kind of fit: its title, and how to record and fit it where no quantity states that."""

    title: str
    measured_by: str = ""
