"""Look up a campaign's parameters, and turn matrices to the axes forward, left and up."""

from collections.abc import Mapping
from dataclasses import dataclass

from cfid.records.parameters import Section
from cfid.records.rig_file import BodyFrame, Rig
from cfid.records.values import FoundParameter, find_parameter


@dataclass(frozen=True)
class Known:
    """A campaign's parameters by key, and its rig."""

    rig: Rig
    sections: Mapping[str, Section]

    def find(self, key: str) -> FoundParameter | None:
        """Return a parameter that counts, by `find_parameter`."""
        return find_parameter(self.sections, key)

    def numbers(self, key: str) -> list[float | None] | None:
        """Return the numbers of a parameter in order, one for a scalar, None for a missing parameter."""
        found = self.find(key)
        return None if found is None else [number.value for number in found.parameter.numbers(key)]


def axis_of(name: str) -> tuple[int, int]:
    """Return the index of a body axis in x, y, z, and its sign."""
    return "xyz".index(name[-1]), -1 if name.startswith("-") else 1


def turned(matrix: list[list[float]], frame: BodyFrame) -> dict[str, float]:
    """Return the entries of a symmetric matrix (3, 3) of a body frame, turned to the axes forward, left and up.

    Roll is about forward, pitch about left, yaw about up. Products of inertia remain entries of the matrix, with its
    sign convention.
    """
    axes = {"roll": axis_of(frame.forward), "pitch": axis_of(frame.left), "yaw": axis_of(frame.up)}
    names = [("roll", "roll"), ("pitch", "pitch"), ("yaw", "yaw"), ("roll", "pitch"), ("roll", "yaw"), ("pitch", "yaw")]
    result = {}
    for first, second in names:
        (i, sign_i), (j, sign_j) = axes[first], axes[second]
        result[first if first == second else f"{first}-{second}"] = sign_i * sign_j * matrix[i][j]
    return result
