"""The models of drag: what force each says that moving air does to turning rotors. All are linear in coefficients."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_LATERAL_AND_VERTICAL = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # x and y share a coefficient, z has its own


@dataclass(frozen=True, eq=False)
class DragModel:
    """f (n, 3) = rows(velocity (n, 3), speed sum (n,)) (n, 3, p) @ coefficients (p,), all SI, body frame.

    `layout` places the coefficients as the thesis prints them.
    """

    name: str
    layout: Indices
    rows: Callable[[Array, Array], Array]

    @property
    def unknowns(self) -> int:
        """How many coefficients there are."""
        return int(self.layout.max()) + 1

    def force_n(self, coefficients: Array, *, velocity_mps: Array, speed_sum_rad_s: Array) -> Array:
        """Return the drag force (n, 3) of coefficients (p,)."""
        return np.asarray(self.rows(velocity_mps, speed_sum_rad_s) @ coefficients)

    def coefficients(self, printed: npt.ArrayLike) -> Array:
        """Return the coefficients (p,) of what is laid out as the thesis prints it."""
        found = np.zeros(self.unknowns)
        found[self.layout] = printed
        return found


def lateral_and_vertical(term: Array) -> Array:
    """Return rows (n, 3, 2) of a term (n, 3) with one coefficient for x and y, and one for z."""
    return np.asarray(term[:, :, np.newaxis] * _LATERAL_AND_VERTICAL)


def _simple(velocity: Array, speed_sum: Array) -> Array:
    return lateral_and_vertical(speed_sum[:, np.newaxis] * velocity)


def _complex(velocity: Array, speed_sum: Array) -> Array:
    ones = np.ones_like(velocity)
    speed = speed_sum[:, np.newaxis] * ones
    terms = (speed * velocity, velocity**2, speed**2, velocity, speed, ones)
    return np.concatenate([lateral_and_vertical(term) for term in terms], axis=2)


def _cross(velocity: Array, speed_sum: Array) -> Array:
    return _coupled(velocity, speed_sum, velocity[:, 0] + velocity[:, 1])


def _cross_mended(velocity: Array, speed_sum: Array) -> Array:
    return _coupled(velocity, speed_sum, np.hypot(velocity[:, 0], velocity[:, 1]))


def _coupled(velocity: Array, speed_sum: Array, sideways: Array) -> Array:
    x, y, z = velocity.T
    none = np.zeros_like(x)
    rows = [[x, y, z, none, none], [y, x, z, none, none], [none, none, none, sideways, z]]
    return np.moveaxis(np.array(rows) * speed_sum, 2, 0)


_CROSS_LAYOUT = np.array([[0, 1, 2], [1, 0, 2], [3, 3, 4]])

# Eq. 4.2: the diagonal of K_aero, kg/rad.
SIMPLE = DragModel("simple", np.array([0, 0, 1]), _simple)
# Eq. 4.5: k1 to k6, for x, y, z each; kg/rad, kg/m, N s^2/rad^2, kg/s, N s/rad, N (the thesis prints kg/rad for all).
COMPLEX = DragModel("complex", np.arange(0, 12, 2)[:, np.newaxis] + np.array([0, 0, 1]), _complex)
# Eq. 4.6 with the symmetries of eq. 4.7: kappa_1 to kappa_5 in the matrix, kg/rad.
CROSS = DragModel("cross", _CROSS_LAYOUT, _cross)
# The same, but for the lift: kappa_4 of eq. 4.7 turns its sign with the direction of flight, which no rotor does
# (section 4.5), so here it multiplies |v_xy|.
CROSS_MENDED = DragModel("cross mended", _CROSS_LAYOUT, _cross_mended)
