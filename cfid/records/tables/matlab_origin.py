"""Read the columns' own names, units and series from the struct that cfid writes into a MATLAB file."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

Tree = Any

ORIGIN = "cfid_origin"

_LISTS = ("variable", "name", "unit")
_TIME = "t"  # begins every series


class Variable(NamedTuple):
    """A variable of the file: its series, "" where there is only one, and the column's own name and unit."""

    variable: str
    series: str
    name: str
    unit: str


def variables_of(tree: Mapping[str, Tree]) -> list[Variable]:
    """Return the variables that `cfid_origin` describes, none for a file that cfid did not write."""
    origin = tree.get(ORIGIN)
    if not isinstance(origin, Mapping):
        return []
    variables, names, units = (_texts(origin.get(key)) for key in _LISTS)
    if not len(variables) == len(names) == len(units):
        return []
    several, series = names.count(_TIME) > 1, ""
    found = []
    for variable, name, unit in zip(variables, names, units, strict=True):
        if several and name == _TIME:
            series = variable.removesuffix(f"_{_TIME}")
        found.append(Variable(variable, series, name, unit))
    return found


def with_own_names(tree: Mapping[str, Tree], variables: list[Variable]) -> dict[str, Tree]:
    """Return a file's variables by the columns' own names, in a struct for each series where there are several.

    A variable that was added to the file keeps its name.
    """
    own: dict[str, Tree] = {}
    for one in variables:
        if one.variable in tree:
            place = own.setdefault(one.series, {}) if one.series else own
            place[one.variable if one.name in place else one.name] = tree[one.variable]
    known = {ORIGIN, *(one.variable for one in variables)}
    return own | {name: value for name, value in tree.items() if name not in known and name not in own}


def texts_of(tree: Mapping[str, Tree]) -> dict[str, str]:
    """Return the texts of `cfid_origin`, which describe the recording."""
    return {key: text for key, text in tree[ORIGIN].items() if isinstance(text, str)}


def _texts(values: Tree) -> list[str]:
    """Return the texts of a cell array, in which an empty text is an array without elements."""
    every = values.tolist() if isinstance(values, np.ndarray) else values if isinstance(values, list) else []
    return [one if isinstance(one, str) else "" for one in every]
