"""Whether an inertia matrix can belong to a body, and the nearest matrix that can.

A body's second moments J = tr(I)/2 * 1 - I are a positive definite matrix: this condition contains the positive
eigenvalues and the triangle inequality, and is sufficient [WKS].
"""

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from cfid.quantities.values import ENTRIES

Array = npt.NDArray[np.float64]

_LEAST_THICKNESS = 1e-6  # smallest second moment, relative to the trace, that the refit may reach


def as_matrix(entries: Array) -> Array:
    """Return the symmetric matrix of the entries xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def entries_of(matrix: Array) -> Array:
    """Return the entries xx, yy, zz, xy, xz, yz of a symmetric matrix (3, 3)."""
    return np.asarray(matrix[tuple(zip(*ENTRIES.values(), strict=True))])


def is_consistent(matrix_kg_m2: Array) -> bool:
    """Return whether a matrix (3, 3) belongs to a possible body."""
    return bool(np.linalg.eigvalsh(_second_moments(matrix_kg_m2))[0] > 0)


def nearest_consistent(entries: Array, covariance: Array) -> Array:
    """Return the entries xx, yy, zz, xy, xz, yz of a possible body nearest to the given ones.

    Nearness is measured with the entries' covariance (6, 6). The second moments are written as a Cholesky
    factor with logarithms on its diagonal [RW], so that every point of the search is a possible body.
    """
    scale = float(np.mean(np.abs(entries[:3])))
    floor = np.diag(np.full(6, (1e-6 * scale) ** 2))
    whiten = np.linalg.cholesky(np.linalg.inv(covariance + floor)).T

    def mismatch(factor: Array) -> Array:
        return whiten @ (_entries(factor, scale) - entries)

    moments = _second_moments(as_matrix(entries)) / scale
    values, vectors = np.linalg.eigh(moments)
    start = np.linalg.cholesky(vectors @ np.diag(np.maximum(values, 0.01 * values.max())) @ vectors.T)
    begin = np.concatenate([np.log(np.diag(start)), start[[1, 2, 2], [0, 0, 1]]])
    lowest = 0.5 * np.log(_LEAST_THICKNESS)
    bounds = ([lowest] * 3 + [-np.inf] * 3, [np.inf] * 6)
    found = least_squares(mismatch, np.maximum(begin, [*bounds[0][:3], *begin[3:]]), bounds=bounds, xtol=1e-12)
    return _entries(found.x, scale)


def _second_moments(matrix: Array) -> Array:
    return np.asarray(np.trace(matrix) / 2 * np.eye(3) - matrix)


def _entries(factor: Array, scale: float) -> Array:
    lower = np.diag(np.exp(factor[:3]))
    lower[[1, 2, 2], [0, 0, 1]] = factor[3:]
    moments = scale * lower @ lower.T
    return entries_of(np.trace(moments) * np.eye(3) - moments)
