"""Covariances of parameters, as parameters.toml stores them.

A covariance matrix covers the numbers of some parameters of one fit, in order. A cause that several fits share (a
mass, a tachometer's scale, an arm) is stored as its effects: the change of each parameter per standard uncertainty of
the cause. The covariance between two fits with the same cause is the product of their effects.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cfid.quantities.values import ENTRIES

_SYMMETRIC = ("inertia.matrix_kg_m2",)
_ROUNDING = 1e-6  # relative to the geometric mean of two variances


@dataclass(frozen=True)
class Covariance:
    """The matrix (n, n) of the n numbers of the parameters `of`, in that order; see `numbers_of`."""

    of: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


def numbers_of(key: str, value: Any) -> list[float]:
    """Return a parameter's independent numbers as a flat list.

    A list stays in order, a matrix goes row by row, the inertia matrix as xx, yy, zz, xy, xz, yz.
    """
    if key in _SYMMETRIC:
        return [value[i][j] for i, j in ENTRIES.values()]
    if isinstance(value, list):
        return [number for part in value for number in numbers_of("", part)]
    return [value]


def names_of(key: str, value: Any) -> list[str]:
    """Return a name for each of a parameter's independent numbers."""
    if key in _SYMMETRIC:
        return [f"{key} {entry}" for entry in ENTRIES]
    if not isinstance(value, list):
        return [key]
    return [name for place, part in enumerate(value) for name in names_of(f"{key} [{place}]", part)]


def shaped_as(key: str, numbers: Sequence[float], value: Any) -> Any:
    """Return numbers in the shape of a parameter's value, the inverse of `numbers_of`."""
    if key in _SYMMETRIC:
        (xx, yy, zz, xy, xz, yz) = numbers
        return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    if not isinstance(value, list):
        return numbers[0]
    shaped, begin = [], 0
    for part in value:
        count = len(numbers_of("", part))
        shaped.append(shaped_as("", numbers[begin : begin + count], part))
        begin += count
    return shaped


def covariance_between(values: Mapping[str, Any], matrix: Any) -> tuple[Covariance, ...]:
    """Return the covariance of parameters as parameters.toml stores it; empty where it is unknown.

    `matrix` (n, n) covers the numbers of `values` in order.
    """
    rows = tuple(tuple(float(number) for number in row) for row in matrix)
    known = all(math.isfinite(number) for row in rows for number in row) and any(any(row) for row in rows)
    return (Covariance(tuple(values), rows),) if known else ()


def covariance_fault(found: Covariance, values: Mapping[str, Any]) -> str:
    """Return what is wrong with a covariance that was read, "" where nothing is."""
    missing = [key for key in found.of if key not in values]
    if missing:
        return f"of: there is no {missing[0]}"
    size = sum(len(numbers_of(key, values[key])) for key in found.of)
    if len(found.matrix) != size or any(len(row) != size for row in found.matrix):
        return f"matrix: should have {size} rows of {size} numbers"
    for i, row in enumerate(found.matrix):
        if not all(math.isfinite(number) for number in row) or row[i] < 0:
            return f"matrix: row {i + 1} should have finite numbers, the diagonal none below zero"
        for j, number in enumerate(row):
            limit = math.sqrt(row[i] * found.matrix[j][j])
            if abs(number - found.matrix[j][i]) > _ROUNDING * limit or abs(number) > (1 + _ROUNDING) * limit:
                return f"matrix: row {i + 1}, column {j + 1} is impossible in a covariance matrix"
    return ""


def common_fault(effects: Mapping[str, Any], values: Mapping[str, Any]) -> str:
    """Return what is wrong with the effects of a common cause, "" where nothing is."""
    for key, effect in effects.items():
        if key not in values:
            return f"there is no {key}"
        if len(numbers_of("", effect)) != len(numbers_of(key, values[key])):
            return f"{key} should have as many numbers as its value has"
    return ""
