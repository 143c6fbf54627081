"""Turn from a campaign's body frame to that of the targets: x forward, y left, z up, origin in the centre of mass.

Each axis of one frame is an axis of the other, up to its sign. So turning only permutes entries and changes signs, and
rounds nothing.
"""

from collections.abc import Sequence

from cfid.records.rig_file import BodyFrame

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]


def turned_matrix(matrix: Sequence[Sequence[float]], frame: BodyFrame) -> Matrix:
    """Return a tensor (3, 3) of the body frame in the axes forward, left and up, which is R M R^T."""
    columns = zip(*(frame.turned(row) for row in matrix), strict=True)
    a, b, c = zip(*map(frame.turned, columns), strict=True)
    return a, b, c


def turned_spread(matrix: Sequence[Sequence[float]], frame: BodyFrame) -> Matrix:
    """Return the standard uncertainties (3, 3) of a tensor's entries, moved with the entries but without signs."""
    a, b, c = (_vector([abs(part) for part in row]) for row in turned_matrix(matrix, frame))
    return a, b, c


def is_turned(frame: BodyFrame) -> bool:
    """Return whether a body frame differs from x forward, y left, z up."""
    return (frame.forward, frame.left, frame.up) != ("x", "y", "z")


def _vector(parts: Sequence[float]) -> Vector:
    x, y, z = parts
    return x, y, z
