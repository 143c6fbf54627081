"""What a campaign knows of its vehicle: the last of each fit, and what rig.toml states."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from cfid.records.campaign import BodyFrame, Rig
from cfid.records.parameters import Parameter, Section


class Found(NamedTuple):
    """A parameter, the section of parameters.toml that it stands in, and whether its fit rejected it."""

    name: str
    section: Section
    parameter: Parameter
    rejected: bool


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
        return None if found is None else [number.value for number in found.parameter.numbers(key)]


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
