"""Model drag: the force of moving air on turning rotors. Each model is a table of regressors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_LATERAL, _VERTICAL = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


class Term(NamedTuple):
    """One coefficient's part of the force.

    `regressor` maps velocities (n, 3) in m/s and speed sums (n, 1) in rad/s to (n, 3) or (n, 1), one value per axis;
    `axes` (3,) is 1 for the axes that share the coefficient and 0 for the others.
    """

    regressor: Callable[[Array, Array], Array]
    axes: Array


@dataclass(frozen=True, eq=False)
class DragModel:
    """f (n, 3) = rows(velocity (n, 3), speed sum (n,)) (n, 3, p) @ coefficients (p,), all SI, body frame.

    `layout` places the coefficients as the thesis prints them.
    """

    name: str
    layout: Indices
    terms: tuple[Term, ...]

    @property
    def unknowns(self) -> int:
        """The number of coefficients."""
        return len(self.terms)

    def rows(self, velocity_mps: Array, speed_sum_rad_s: Array) -> Array:
        """Return the regressors (n, 3, p) of velocities (n, 3) and speed sums (n,)."""
        return rows_of(self.terms, velocity_mps, speed_sum_rad_s)

    def force_n(self, coefficients: Array, *, velocity_mps: Array, speed_sum_rad_s: Array) -> Array:
        """Return the drag force (n, 3) for coefficients (p,)."""
        return np.asarray(self.rows(velocity_mps, speed_sum_rad_s) @ coefficients)

    def coefficients(self, printed: npt.ArrayLike) -> Array:
        """Return the coefficients (p,) of a table in the layout of the thesis."""
        found = np.zeros(self.unknowns)
        found[self.layout] = printed
        return found


def rows_of(terms: tuple[Term, ...], velocity_mps: Array, speed_sum_rad_s: Array) -> Array:
    """Return the regressors (n, 3, p) of p terms."""
    speed_sum = speed_sum_rad_s[:, np.newaxis]
    return np.stack([term.regressor(velocity_mps, speed_sum) * term.axes for term in terms], axis=2)


def _lateral_and_vertical(*regressors: Callable[[Array, Array], Array]) -> tuple[Term, ...]:
    """Return two terms per regressor: x and y share a coefficient, z has its own."""
    return tuple(Term(regressor, axes) for regressor in regressors for axes in (_LATERAL, _VERTICAL))


def _coupled(name: str, sideways: Callable[[Array], Array]) -> DragModel:
    """Return eq. 4.6 with the symmetries of eq. 4.7; kappa_4 multiplies `sideways` of the velocity, (n, 1)."""
    return DragModel(
        name,
        np.array([[0, 1, 2], [1, 0, 2], [3, 3, 4]]),
        (
            Term(lambda v, s: s * v, _LATERAL),
            Term(lambda v, s: s * v[:, [1, 0, 2]], _LATERAL),
            Term(lambda v, s: s * v[:, 2:], _LATERAL),
            Term(lambda v, s: s * sideways(v), _VERTICAL),
            Term(lambda v, s: s * v, _VERTICAL),
        ),
    )


# Eq. 4.2: the diagonal of K_aero, kg/rad.
SIMPLE = DragModel("simple", np.array([0, 0, 1]), _lateral_and_vertical(lambda v, s: s * v))
# Eq. 4.5: k1 to k6, each for x, y, z; kg/rad, kg/m, N s^2/rad^2, kg/s, N s/rad, N (the thesis prints kg/rad for all).
COMPLEX = DragModel(
    "complex",
    np.arange(0, 12, 2)[:, np.newaxis] + np.array([0, 0, 1]),
    _lateral_and_vertical(
        lambda v, s: s * v,
        lambda v, s: v**2,
        lambda v, s: s**2,
        lambda v, s: v,
        lambda v, s: s,
        lambda v, s: np.ones_like(s),
    ),
)
# Kappa_1 to kappa_5 in the matrix, kg/rad.
CROSS = _coupled("cross", lambda v: v[:, :1] + v[:, 1:2])
# Kappa_4 of eq. 4.7 changes its sign with the direction of flight, which no rotor does (section 4.5): here it
# multiplies |v_xy|.
CROSS_MENDED = _coupled("cross mended", lambda v: np.hypot(v[:, :1], v[:, 1:2]))

# Drag of the body in addition to the rotors', k |v| v: one coefficient for x and y, one for z, kg/m.
BODY = _lateral_and_vertical(lambda v, s: np.linalg.norm(v, axis=1, keepdims=True) * v)
