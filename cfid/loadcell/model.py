"""The load that a hanging weight applies to the load cell, and how the cell shows it."""

import numpy as np
import numpy.typing as npt

from cfid.records.run import Pull

Array = npt.NDArray[np.float64]


def applied_wrench(*, weight_n: float, pull: Pull, at_m: Array) -> Array:
    """Return the load (6,) of a weight: Fx, Fy, Fz in N and Tx, Ty, Tz in N m, in the cell's frame.

    `pull` is the axis of the cell along which gravity points, `at_m` (3,) where the weight hangs, from the origin.
    """
    force = np.zeros(3)
    force["xyz".index(pull[-1])] = -weight_n if pull.startswith("-") else weight_n
    return np.concatenate([force, np.cross(at_m, force)])


def place_error(*, load: Array, std_m: float) -> Array:
    """Return the standard uncertainties (6,) of a load (6,) whose place is uncertain by `std_m` along each axis."""
    squares = load[:3] ** 2
    return np.concatenate([np.zeros(3), std_m * np.sqrt(squares.sum() - squares)])


def own_nonlinearity(load: Array) -> Array:
    """Return the regressor (n,) of an axis whose gain changes by 1 from no load to the largest of its loads (n,)."""
    largest = float(np.abs(load).max(initial=0.0))
    return np.asarray(load * np.abs(load) / largest) if largest > 0 else np.zeros(len(load))
