"""What a campaign knows of its vehicle: the last of each fit, and what rig.toml states."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from cfid.records.campaign import BodyFrame, Rig
from cfid.records.parameters import Parameter, Section, part, plain

_SYMMETRIC = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_ALL = {f"{row}{column}": (i, j) for i, row in enumerate("xyz") for j, column in enumerate("xyz")}


class Found(NamedTuple):
    """A parameter, the section of parameters.toml that it stands in, and whether its fit rejected it."""

    name: str
    section: Section
    parameter: Parameter
    rejected: bool


class Entry(NamedTuple):
    """One number of a parameter: which of its numbers it is ("" of a scalar), its value and deviation."""

    place: str
    value: float | None
    std: float | None


@dataclass(frozen=True)
class Known:
    """Parameters by their keys of the contract, and the rig."""

    rig: Rig
    sections: Mapping[str, Section]

    def find(self, key: str) -> Found | None:
        """Return a parameter; of several sections that have it, the latest."""
        found = [
            Found(name, section, section.parameters[key], key in section.rejected)
            for name, section in self.sections.items()
            if key in section.parameters
        ]
        return max(found, key=lambda one: one.section.found, default=None)

    def numbers(self, key: str) -> list[float | None] | None:
        """Return the numbers of a parameter in their order, a scalar as one, None where there is none."""
        found = self.find(key)
        return None if found is None else [entry.value for entry in entries(found.parameter)]


def entries(parameter: Parameter) -> Iterator[Entry]:
    """Yield the numbers of a parameter one by one; of a symmetric matrix (3, 3) each once, of rows none."""
    value, std = plain(parameter.value), plain(parameter.std)
    if not is_rows(value):
        yield from _numbers("", value, std)


def _numbers(place: str, value: Any, std: Any) -> Iterator[Entry]:
    if not isinstance(value, list):
        if _may_be_number(value):
            yield Entry(place, value, std if _may_be_number(std) else None)
    elif len(value) == 3 and all(isinstance(row, list) and len(row) == 3 for row in value):
        for name, (i, j) in (_SYMMETRIC if _is_symmetric(value) else _ALL).items():
            yield from _numbers(f"{place} {name}".strip(), value[i][j], part(part(std, i), j))
    else:
        for i, item in enumerate(value):
            yield from _numbers(f"{place} {i}".strip(), item, part(std, i))


def _may_be_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def is_rows(value: Any) -> bool:
    """Return whether a value is a list of rows with named cells."""
    return isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], Mapping)


def axis_of(name: str) -> tuple[int, int]:
    """Return a body axis as its place among x, y, z and its sign."""
    return "xyz".index(name[-1]), -1 if name.startswith("-") else 1


def turned(matrix: list[list[float]], frame: BodyFrame) -> dict[str, float]:
    """Return a symmetric matrix (3, 3) of a body frame by its entries along forward, left and up.

    Roll is about forward, pitch about left, yaw about up. The products keep their meaning as entries of the matrix.
    """
    axes = {"roll": axis_of(frame.forward), "pitch": axis_of(frame.left), "yaw": axis_of(frame.up)}
    names = [("roll", "roll"), ("pitch", "pitch"), ("yaw", "yaw"), ("roll", "pitch"), ("roll", "yaw"), ("pitch", "yaw")]
    result = {}
    for first, second in names:
        (i, sign_i), (j, sign_j) = axes[first], axes[second]
        result[first if first == second else f"{first}-{second}"] = sign_i * sign_j * matrix[i][j]
    return result


def _is_symmetric(value: list[list[float]]) -> bool:
    return all(value[i][j] == value[j][i] for i, j in _SYMMETRIC.values())
