"""What a row of the registry says of a quantity."""

from dataclasses import dataclass
from enum import StrEnum


class Shape(StrEnum):
    """What a value is made of, in the words of a message."""

    NUMBER = "a number"
    LIST = "a list of numbers"
    NUMBER_OR_LIST = "a number or a list of numbers"
    POLYNOMIAL = "a list of coefficients"
    MATRIX = "a matrix of 3 times 3 numbers"
    ROWS = "a list of rows"


@dataclass(frozen=True)
class Range:
    """The least and the largest plausible size, ends included, and why.

    `of` says what of a value is judged: each of its numbers, the diagonal of a matrix, or of a polynomial its slope at
    zero or its value at `at`.
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
    where it is not `lowest_first`. `count` is how many numbers a list has, where that is known; `columns` are those of
    rows that have to be numbers. `section` of parameters.toml is where a fit puts it, `given_by` what a person does
    to get it. What a run had and the vehicle has not is `of_the_run`.
    """

    key: str
    unit: str
    symbol: str
    title: str
    shape: Shape = Shape.NUMBER
    plausible: Range | None = None
    count: int | None = None
    columns: tuple[str, ...] = ()
    of: str = ""
    over: str = ""
    lowest_first: bool = False
    of_the_run: bool = False
    section: str = ""
    given_by: str = ""


@dataclass(frozen=True)
class Experiment:
    """A kind of fit: what it is called, and where nothing else says so how its recordings are made and fitted."""

    title: str
    measured_by: str = ""
