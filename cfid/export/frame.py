"""The body frame of a campaign turned to that of the targets: x forward, y left, z up, origin in the centre of mass.

Body axes are signed axes of each other, so turning exchanges entries and signs, and rounds nothing.
"""

from collections.abc import Sequence

from cfid.records.mounts import BodyAxis, BodyFrame

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]


def turned(vector: Sequence[float], frame: BodyFrame) -> Vector:
    """Return a vector (3,) of the body frame with its parts forward, left and up."""
    x, y, z = (sign * vector[place] + 0.0 for place, sign in _axes(frame))
    return x, y, z


def turned_matrix(matrix: Sequence[Sequence[float]], frame: BodyFrame) -> Matrix:
    """Return a tensor (3, 3) of the body frame in the axes forward, left and up: R M R^T."""
    rows = [turned(row, frame) for row in matrix]
    a, b, c = ([sign * part + 0.0 for part in rows[place]] for place, sign in _axes(frame))
    return _vector(a), _vector(b), _vector(c)


def turned_spread(matrix: Sequence[Sequence[float]], frame: BodyFrame) -> Matrix:
    """Return the standard uncertainties (3, 3) of a tensor's entries, turned with their entries; they have no sign."""
    a, b, c = (_vector([abs(part) for part in row]) for row in turned_matrix(matrix, frame))
    return a, b, c


def is_turned(frame: BodyFrame) -> bool:
    """Return whether a body frame differs from x forward, y left, z up."""
    return (frame.forward, frame.left, frame.up) != ("x", "y", "z")


def _axes(frame: BodyFrame) -> list[tuple[int, int]]:
    return [_axis(axis) for axis in (frame.forward, frame.left, frame.up)]


def _axis(axis: BodyAxis) -> tuple[int, int]:
    return "xyz".index(axis[-1]), -1 if axis.startswith("-") else 1


def _vector(parts: Sequence[float]) -> Vector:
    x, y, z = parts
    return x, y, z
