"""Gain, cross-talk and linearity of each axis from readings under known loads, by weighted least squares.

For axis i, reading = zero of the orientation + sum over axes j of c_ij load_j + q_i load_i |load_i| / max |load_i|. The
gain g_i is c_ii, its slope without load; the cross-talk is c_ij; the linearity q_i / g_i is the change of the gain up
to the largest load. The zero of each orientation contains the weight of the mount. The uncertainty of a load's place
counts as noise of the torques.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.linear import fit_linear
from cfid.records.run import Pull

Array = npt.NDArray[np.float64]

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
_DEPENDENT = 1e-6  # part of a column that the others do not give: a column with less depends on them
_FEWEST_LOADS = 3  # fewest loads, no load included, that distinguish a bend from a slope


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Loads:
    """Mean readings (n, 6) under loads (n, 6), N and N m, in orientations (n,), with standard uncertainties (n, 6).

    `of_weights` (n, n) is the relative covariance of the loads by their weights, of which one may hang in several runs.
    """

    load: Array
    reading: Array
    std: Array
    of_weights: Array
    orientation: npt.NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisFit:
    """What one axis shows: gain, linearity (nan where loads are too few), and cross-talk of the axes in `acting`.

    `covariance` covers all of these in this order, without the linearity where that is nan. `misfit` is the root of
    chi-squared over its degrees of freedom.
    """

    axis: str
    gain: float
    linearity: float
    acting: tuple[str, ...]
    cross_talk: Array
    covariance: Array
    misfit: float
    degrees_of_freedom: int

    @property
    def values(self) -> Array:
        """Gain, linearity where it is known, and cross-talk, in the order of the covariance."""
        bend = [] if np.isnan(self.linearity) else [self.linearity]
        return np.array([self.gain, *bend, *self.cross_talk])


def fit_axes(loads: Loads) -> dict[str, AxisFit]:
    """Return the fit of each axis whose gain the loads determine, with its cross-talk from all other axes.

    Raises FitError where the loads determine no gain.
    """
    found = {axis: _fit_axis(loads, place) for place, axis in enumerate(AXES) if np.any(loads.load[:, place])}
    determined = {axis: one for axis, one in found.items() if one is not None}
    if not determined:
        raise FitError(
            f"{counted(len(loads.load), 'load determines', 'loads determine')} no gain: record the cell "
            "without a weight and with at least two "
            "different ones, in the same orientation."
        )
    return determined


def _fit_axis(loads: Loads, place: int) -> AxisFit | None:
    """Return the fit of one axis, None where it was not measured, or its gain or the noise is not determined."""
    if not np.isfinite(loads.reading[:, place]).all():
        return None
    columns = {axis: loads.load[:, at] for at, axis in enumerate(AXES) if np.any(loads.load[:, at])}
    zeros = np.asarray(loads.orientation[:, np.newaxis] == np.unique(loads.orientation), dtype=np.float64)
    own = columns.pop(AXES[place])
    # A gain that changes by 1 from no load to the largest.
    bend = [own * np.abs(own) / np.abs(own).max()] if _bends(own, loads.orientation) else []
    rows = np.column_stack([own, *bend, *columns.values(), zeros])
    if bend and len(rows) <= np.linalg.matrix_rank(rows):  # with nothing to spare, the gain counts more than its bend
        bend, rows = [], np.delete(rows, 1, axis=1)
    free = [at for at in range(rows.shape[1]) if _independent_part(rows, at) > _DEPENDENT]
    if 0 not in free or len(rows) <= rows.shape[1]:
        return None
    of_weights = loads.of_weights * np.outer(loads.load[:, place], loads.load[:, place])
    std = np.sqrt(loads.std[:, place] ** 2 + np.diag(of_weights))
    fit = fit_linear(rows / std[:, np.newaxis], loads.reading[:, place] / std, noise_known=True)
    misfit = float(np.sqrt(fit.residual @ fit.residual / fit.degrees_of_freedom))
    talks = [at for at in free if 1 + len(bend) <= at < rows.shape[1] - zeros.shape[1]]
    bent = bool(bend) and 1 in free
    kept = [0, *([1] if bent else []), *talks]
    gain = float(fit.values[0])
    outward = np.eye(len(fit.values))[kept]
    if bent:
        outward[1] = np.eye(len(fit.values))[1] / gain
        outward[1, 0] = -fit.values[1] / gain**2
    data = of_weights + np.diag(loads.std[:, place] ** 2)
    gain_of_readings = outward @ fit.gain / std
    return AxisFit(
        axis=AXES[place],
        gain=gain,
        linearity=float(fit.values[1]) / gain if bent else float("nan"),
        acting=tuple(list(columns)[at - 1 - len(bend)] for at in talks),
        cross_talk=fit.values[talks],
        covariance=gain_of_readings @ data @ gain_of_readings.T * max(misfit, 1.0) ** 2,
        misfit=misfit,
        degrees_of_freedom=fit.degrees_of_freedom,
    )


def _bends(own: Array, orientation: npt.NDArray[np.intp]) -> bool:
    """Return whether an orientation has enough different sizes of this load to show a bend."""
    sizes = [len(np.unique(np.round(np.abs(own[orientation == one]), 9))) for one in np.unique(orientation)]
    return max(sizes) >= _FEWEST_LOADS


def _independent_part(rows: Array, at: int) -> float:
    """Return the part of a column (n,) that no combination of the others gives."""
    others = np.delete(rows, at, axis=1)
    scaled = others / np.where(np.linalg.norm(others, axis=0) > 0, np.linalg.norm(others, axis=0), 1.0)
    column = rows[:, at] / np.linalg.norm(rows[:, at])
    return float(np.linalg.norm(column - scaled @ np.linalg.lstsq(scaled, column, rcond=_DEPENDENT)[0]))
