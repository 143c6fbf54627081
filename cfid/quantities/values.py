"""Name the numbers of a quantity's value, and check the shape of a value from a file.

Values are numbers, nested lists of them, or lists of rows (mappings); an unknown number is None or nan.
"""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeGuard

from cfid.quantities.registry import Quantity, Shape, find, registered

ENTRIES = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}  # of a symmetric matrix
PRODUCTS = (ENTRIES["xy"], ENTRIES["xz"], ENTRIES["yz"])  # places off the diagonal of a symmetric matrix, each once
ALL_ENTRIES = {f"{row}{column}": (i, j) for i, row in enumerate("xyz") for j, column in enumerate("xyz")}

_NUMBER = 0  # stands for any number in a form: a value's nested lists


class Number(NamedTuple):
    """One number of a quantity: its place ("" for a single one, "xy", "0"), its value and standard uncertainty."""

    key: str
    place: str
    value: float | None
    std: float | None

    @property
    def name(self) -> str:
        """The key with the place: `motor.thrust_poly [0]`, `inertia.matrix_kg_m2 xy`."""
        return " ".join([self.key, *(f"[{word}]" if word.isdecimal() else word for word in self.place.split())])


def numbers(key: str, value: Any, std: Any) -> Iterator[Number]:
    """Yield the numbers of a value one by one: of a symmetric matrix (3, 3) each entry once, and nothing for rows.

    Where `std` has another shape than the value, as after editing by hand, a missing standard uncertainty is None.
    """
    if not is_rows(value):
        yield from _numbers(key, "", value, std)


def leaves(value: Any) -> Iterator[float]:
    """Yield the known numbers of nested lists."""
    if isinstance(value, list):
        for part in value:
            yield from leaves(part)
    elif isinstance(value, int | float) and not math.isnan(value):
        yield value


def is_rows(value: Any) -> TypeGuard[Sequence[Mapping[str, Any]]]:
    """Return whether a value is a list of rows with named cells."""
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(row, Mapping) for row in value)


def is_number(value: Any) -> TypeGuard[float]:
    """Return whether a value is a number that a float can hold."""
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) <= sys.float_info.max
    return whole or isinstance(value, float)


def is_matrix(value: Any) -> bool:
    """Return whether a value is a list of three lists of three."""
    return isinstance(value, list) and len(value) == 3 and all(isinstance(row, list) and len(row) == 3 for row in value)


def evaluate(key: str, value: Sequence[float], x: float) -> float:
    """Return the value at x of a polynomial with coefficients (n,) in the order of its key."""
    lowest_first = value if _polynomial(key).lowest_first else value[::-1]
    return float(sum(c * x**i for i, c in enumerate(lowest_first)))


def coefficient_units(key: str, count: int) -> list[str]:
    """Return the units of a polynomial's coefficients (count,) in the order of its key."""
    found = _polynomial(key)
    units = [_over(found.of, found.over, power) for power in range(count)]
    return units if found.lowest_first else units[::-1]


def units_of(key: str, unit: str, count: int) -> list[str]:
    """Return the unit of each of a quantity's numbers (count,), which for a polynomial differ from the quantity's."""
    quantity = find(key)
    if quantity is not None and quantity.shape is Shape.POLYNOMIAL and unit == quantity.unit:
        return coefficient_units(key, count)
    units = unit.split(", ")
    return units if len(units) == count else [unit] * count


def shape_error(key: str, value: Any, std: Any) -> str:
    """Return what is wrong with the shape of a value from a file, "" where nothing is; `std` may be None.

    Keys outside the registry may have any shape.
    """
    found = find(key)
    if found is None:
        return ""
    if is_rows(value):
        return _rows_error(found, value)
    try:
        form, spread = _form(value), None if std is None else _form(std)
    except TypeError:
        return "should be made of numbers"
    if not _matches(form, found):
        many = found.shape in (Shape.LIST, Shape.POLYNOMIAL) and found.count
        return f"should be a list of {found.count} numbers" if many else f"should be {found.shape}"
    return "" if spread in (None, form) else "and its std should have the same shape"


def _numbers(key: str, place: str, value: Any, std: Any) -> Iterator[Number]:
    if not isinstance(value, list):
        if _may_be_number(value):
            yield Number(key, place, value, std if _may_be_number(std) else None)
    elif is_matrix(value):
        entries = ENTRIES if all(value[j][i] == value[i][j] for i, j in ENTRIES.values()) else ALL_ENTRIES
        for name, (i, j) in entries.items():
            yield from _numbers(key, f"{place} {name}".strip(), value[i][j], _part(_part(std, i), j))
    else:
        found = find(key)
        places = found.places if found is not None and len(found.places) == len(value) else ()
        for i, item in enumerate(value):
            yield from _numbers(key, f"{place} {places[i] if places else i}".strip(), item, _part(std, i))


def _part(std: Any, place: int) -> Any:
    return std[place] if isinstance(std, list) and place < len(std) else None


def _polynomial(key: str) -> Quantity:
    found = registered(key)
    if found.shape is not Shape.POLYNOMIAL:
        raise KeyError(f"{key} is not a polynomial")
    return found


def _over(of: str, over: str, power: int) -> str:
    if of == "N m" and over == "N":
        return ("N m", "m", "m/N")[power] if power < 3 else f"N m/N^{power}"
    if power == 0 or over == "z^-1":  # z has no unit
        return of
    over = f"({over})" if "/" in over else over
    return f"{of}/{over}" if power == 1 else f"{of}/{over}^{power}"


def _matches(form: Any, found: Quantity) -> bool:
    if found.shape is Shape.NUMBER:
        return bool(form == _NUMBER)
    if found.shape is Shape.MATRIX:
        return bool(form == [[_NUMBER] * 3] * 3)
    if not isinstance(form, list):
        return found.shape is Shape.NUMBER_OR_LIST
    if found.shape is Shape.ROWS:
        return not form and not found.columns
    return form == [_NUMBER] * (found.count or len(form)) and (bool(form) or found.shape is not Shape.POLYNOMIAL)


def _rows_error(found: Quantity, rows: Sequence[Any]) -> str:
    if found.shape is not Shape.ROWS or not all(isinstance(row, Mapping) for row in rows):
        return "should be made of numbers"
    lacking = [name for name in found.columns if not all(_may_be_number(row.get(name, "")) for row in rows)]
    return f"should have a number {lacking[0]} in each row" if lacking else ""


def _form(value: Any) -> Any:
    if isinstance(value, list):
        return [_form(item) for item in value]
    if not _may_be_number(value):
        raise TypeError
    return _NUMBER


def _may_be_number(value: Any) -> bool:
    return value is None or is_number(value)
