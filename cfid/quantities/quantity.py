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

    `of` names the checked part of a value: each of its numbers, its size without the sign, the diagonal of a matrix,
    or of a polynomial its slope at zero or its value at `at`.
    """

    least: float
    largest: float
    reason: str
    of: str = ""
    at: float | None = None


@dataclass(frozen=True)
class Quantity:
    """A quantity under its key of the contract; `<axis>` and `[...]` in a key stand for any name, or for none.

    `unit` is that of --json and parameters.toml. A polynomial gives `of` (a unit) over `over`, its highest power first
    where it is not `lowest_first`. `count` is how many numbers a list has, where that is known, `places` what they are
    called; `columns` are those of rows that must be numbers, `measured` those that a rejection takes away. `section` is
    its section of parameters.toml, `given_by` the way to measure it. A property of a run, not of the vehicle, is
    `of_the_run`.
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
    """A kind of fit: its title, and where no quantity states it, how to record and fit it."""

    title: str
    measured_by: str = ""
