"""Directions of axes: the equations they give for the matrix, and the directions that determine it best."""

import math
from itertools import product

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def matrix_rows(direction: Array) -> Array:
    """Return the rows (n, 6) that take the entries xx, yy, zz, xy, xz, yz to u' I u, for unit vectors (n, 3)."""
    x, y, z = direction.T
    return np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)


def icosahedron_axes() -> Array:
    """Return the six diagonals of an icosahedron as unit vectors (6, 3).

    They are spread evenly, so six swings determine all six entries equally well.
    """
    golden = (1 + math.sqrt(5)) / 2
    corners = [
        (0, 1, golden),
        (0, 1, -golden),
        (1, golden, 0),
        (1, -golden, 0),
        (golden, 0, 1),
        (-golden, 0, 1),
    ]
    return np.array(corners) / math.hypot(1, golden)


def off_diagonal_gain(direction: Array) -> float:
    """Return how much smaller the icosahedron's off-diagonal standard uncertainties are than those of axes (n, 3).

    The comparison is for swings of equal quality and number; 0.35 means 35 % smaller.
    """
    count = len(direction)
    present, even = (
        np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))[3:].mean() * len(rows) / count)
        for rows in (matrix_rows(direction), matrix_rows(icosahedron_axes()))
    )
    return float(1 - even / present)


def checking_axis(direction: Array) -> Array:
    """Return the direction (3,), in small whole numbers, of a further swing that checks those about six axes (6, 3).

    The inertia about it follows from the six others. If each of them contributes to it, it reveals a wrong one; if each
    contributes another amount, it reveals any two that were exchanged: (1, 1, 1) does not distinguish x from y.
    """
    whole = np.array([one for one in product(range(3), range(-2, 3), range(-2, 3)) if any(one)], dtype=float)
    unit = whole / np.linalg.norm(whole, axis=1, keepdims=True)
    parts = np.linalg.lstsq(matrix_rows(direction).T, matrix_rows(unit).T, rcond=None)[0]
    apart = np.abs(parts[:, None] - parts[None, :])[np.triu_indices(len(parts), k=1)]
    return np.asarray(whole[np.argmax(np.minimum(np.abs(parts).min(axis=0), apart.min(axis=0)))])
