"""Axis inertias to the inertia matrix: generalised least squares, budget, consistency, mounting advice."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc, chdtri

from cfid.errors import FitError
from cfid.estimate.linear import gain_of
from cfid.estimate.propagation import budget, contributions
from cfid.findings import Finding, rejection, warning
from cfid.inertia.consistency import as_matrix, is_consistent, nearest_consistent
from cfid.swing.axis_inertias import AxisInertias

Array = npt.NDArray[np.float64]

UNKNOWNS = 6
MATRIX = "inertia.matrix_kg_m2"
UNLIKELY = 1e-3  # chance of a chi-squared as large, below which the swings contradict each other
_SHARED = ("mass", "gravity", "centre of mass")  # groups of inputs
_INDEPENDENT = 1e-6  # smallest over largest singular value of the axes' rows


@dataclass(frozen=True, kw_only=True)
class MeasuredAxes:
    """What each swing gives (n,), whether or not the swings determine a matrix.

    Inertia about the mounting axis and about the parallel axis through the centre of mass, each with its standard
    uncertainty; `sensitivity_kg_m` = dI_G/dr and `best_distance_m`, where it vanishes.
    """

    about_axis_kg_m2: Array
    about_axis_std_kg_m2: Array
    about_centre_kg_m2: Array
    about_centre_std_kg_m2: Array
    distance_m: Array
    sensitivity_kg_m: Array
    best_distance_m: Array


@dataclass(frozen=True, kw_only=True)
class InertiaFit:
    """The inertia matrix about the centre of mass, entries of the matrix itself, in the body frame.

    `residual` (n,) is that of each swing's inertia over its expected standard uncertainty (None for six swings, which
    leave none). `budget` has what each group of inputs contributes to the matrix' standard uncertainty, (3, 3) each.
    `covariance` (6, 6) is that of the entries xx, yy, zz, xy, xz, yz; `common` has what one standard uncertainty of
    each input that other fits may share does to them (6,): mass, gravity, the centre of mass in x, y and z.
    `raw_matrix_kg_m2` is the unconstrained answer where that was no possible body, else None.
    """

    axes: MeasuredAxes
    matrix_kg_m2: Array
    std_kg_m2: Array
    covariance: Array
    common: dict[str, Array]
    residual: Array | None
    chi_squared: float
    degrees_of_freedom: int
    budget: dict[str, Array]
    raw_matrix_kg_m2: Array | None
    condition: float
    findings: tuple[Finding, ...]


def measure_axes(axis_inertias: AxisInertias) -> MeasuredAxes:
    """Return the inertias about each swing's axis, with everything that is uncertain."""
    return _measured(axis_inertias, _moved_by_inputs(axis_inertias))


def fit_inertia(axis_inertias: AxisInertias) -> InertiaFit:
    """Solve eq. 2.2 for the matrix, weighted by everything that is uncertain.

    Any number of swings about any axes; the axes must determine all six entries.

    Raises FitError when they do not.
    """
    evaluated = axis_inertias.evaluate(axis_inertias.values)
    rows = matrix_rows(evaluated.direction)
    condition = _check_axes(rows)
    measured = evaluated.about_centre_kg_m2
    moved = _moved_by_inputs(axis_inertias)
    entries = np.linalg.lstsq(rows, measured, rcond=None)[0].astype(np.float64)
    # A tilt moves an axis' row too, by an amount that depends on the matrix: hence twice.
    for _ in range(2):
        columns = moved.about_centre - np.einsum("nei,e->ni", moved.rows, entries)
        gain, covariance = _gain(rows, columns)
        entries = np.asarray(gain @ measured)
    residual = measured - rows @ entries
    chi_squared, degrees_of_freedom = _chi_squared(residual, columns), len(measured) - UNKNOWNS
    inflation, findings = _scatter(chi_squared, degrees_of_freedom)
    raw = as_matrix(entries)
    consistent = is_consistent(raw)
    if not consistent:
        entries = nearest_consistent(entries, covariance)
        text = (
            "the six entries belong to no possible body (triangle inequality): the nearest possible one within the "
            "uncertainties is given; quality.raw_matrix_kg_m2 has the raw entries. Check mounts and distances."
        )
        findings += (warning("inertia-not-a-body", text, MATRIX),)
    spread = inflation * np.sqrt(np.diag(covariance))
    shares = budget(gain @ columns, axis_inertias.inputs)
    if inflation > 1:
        shares["scatter between swings"] = math.sqrt(1 - inflation**-2) * spread
    return InertiaFit(
        axes=_measured(axis_inertias, moved),
        matrix_kg_m2=as_matrix(entries),
        std_kg_m2=as_matrix(spread),
        covariance=inflation**2 * covariance,
        common=_common(gain @ columns, axis_inertias),
        residual=None if degrees_of_freedom == 0 else residual / _residual_std(rows, gain, columns),
        chi_squared=chi_squared,
        degrees_of_freedom=degrees_of_freedom,
        budget={name: as_matrix(share) for name, share in shares.items()},
        raw_matrix_kg_m2=None if consistent else raw,
        condition=condition,
        findings=findings,
    )


def matrix_rows(direction: Array) -> Array:
    """Return the rows (n, 6) that take the entries xx, yy, zz, xy, xz, yz to u' I u, for unit vectors (n, 3)."""
    x, y, z = direction.T
    return np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)


def icosahedron_axes() -> Array:
    """Return the six diagonals of an icosahedron as unit vectors (6, 3).

    They lie evenly, so that six swings determine all six entries equally well.
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

    For swings of equal quality and the same number of them; 0.35 means 35 % smaller.
    """
    count = len(direction)
    present, even = (
        np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))[3:].mean() * len(rows) / count)
        for rows in (matrix_rows(direction), matrix_rows(icosahedron_axes()))
    )
    return float(1 - even / present)


def _check_axes(rows: Array) -> float:
    singular = np.linalg.svd(rows, compute_uv=False)
    independent = int(np.count_nonzero(singular > _INDEPENDENT * singular[0]))
    if independent < UNKNOWNS:
        raise FitError(
            f"{len(rows)} swings about {independent} independent axes: six are needed for the six entries of the "
            "matrix. Swing about another axis; six that lie evenly are (0, 1, 1.618), (0, 1, -1.618), (1, 1.618, 0), "
            "(1, -1.618, 0), (1.618, 0, 1), (-1.618, 0, 1)."
        )
    return float(singular[0] / singular[-1])


class _Moved(NamedTuple):
    """By how much each input's standard uncertainty moves what is measured: (n, i), (n, i) and (n, 6, i)."""

    about_axis: Array
    about_centre: Array
    rows: Array


def _moved_by_inputs(axis_inertias: AxisInertias) -> _Moved:
    def outputs(values: Array) -> Array:
        found = axis_inertias.evaluate(values)
        rows = matrix_rows(found.direction)
        return np.concatenate([found.about_axis_kg_m2, found.about_centre_kg_m2, rows.ravel()])

    count = len(axis_inertias.swings)
    columns = contributions(outputs, axis_inertias.inputs)
    return _Moved(columns[:count], columns[count : 2 * count], columns[2 * count :].reshape(count, UNKNOWNS, -1))


def _measured(axis_inertias: AxisInertias, moved: _Moved) -> MeasuredAxes:
    found, mass = axis_inertias.evaluate(axis_inertias.values), axis_inertias.body.mass_kg
    return MeasuredAxes(
        about_axis_kg_m2=found.about_axis_kg_m2,
        about_axis_std_kg_m2=_norms(moved.about_axis),
        about_centre_kg_m2=found.about_centre_kg_m2,
        about_centre_std_kg_m2=_norms(moved.about_centre),
        distance_m=found.distance_m,
        sensitivity_kg_m=found.about_axis_kg_m2 / found.distance_m - 2 * mass * found.distance_m,
        best_distance_m=np.sqrt(np.maximum(found.about_centre_kg_m2, 0.0) / mass),
    )


def _common(columns: Array, axis_inertias: AxisInertias) -> dict[str, Array]:
    """Return the columns (6,) of the inputs that other fits may share, those that are uncertain."""
    named = zip(axis_inertias.inputs, columns.T, strict=True)
    return {given.name: column for given, column in named if given.group in _SHARED and given.std > 0}


def _norms(columns: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(columns**2, axis=1)))


def _gain(rows: Array, columns: Array) -> tuple[Array, Array]:
    """Return the weighted least-squares gain (6, n) and the entries' covariance.

    Common inputs (mass, gravity) make the swings' covariance nearly singular when nothing else is
    uncertain; a floor of a millionth of its size keeps the weights finite without being felt.
    """
    covariance = columns @ columns.T
    size = float(np.trace(covariance)) / len(rows)
    gain = gain_of(rows, covariance=covariance + (1e-6 * size or 1.0) * np.eye(len(rows)))
    return gain, gain @ covariance @ gain.T


def _residual_std(rows: Array, gain: Array, columns: Array) -> Array:
    """Return the expected standard uncertainties (n,) of the residuals: what swings share, the fit takes out."""
    left = columns - rows @ (gain @ columns)
    floor = 1e-9 * float(np.max(_norms(columns), initial=0.0)) or 1.0
    return np.maximum(_norms(left), floor)


def _chi_squared(residual: Array, columns: Array) -> float:
    if len(residual) == UNKNOWNS or not np.any(columns):
        return 0.0
    return float(residual @ np.linalg.pinv(columns @ columns.T, hermitian=True) @ residual)


def _scatter(chi_squared: float, degrees_of_freedom: int) -> tuple[float, tuple[Finding, ...]]:
    """Return the factor by which repeated swings scatter beyond their uncertainties, and what that means."""
    if degrees_of_freedom == 0 or chi_squared <= chdtri(degrees_of_freedom, 0.05):
        return 1.0, ()
    inflation = math.sqrt(chi_squared / degrees_of_freedom)
    text = (
        f"the swings scatter {inflation:.1f} times as far as their uncertainties allow "
        f"(chi-squared {chi_squared:.1f} for {degrees_of_freedom} degrees of freedom): "
    )
    if chdtrc(degrees_of_freedom, chi_squared) < UNLIKELY:
        text += "they contradict each other. Repeat the swing with the largest residual."
        return inflation, (rejection("inertia-swings-contradict", text, "inertia.*"),)
    text += "the standard uncertainties are widened by that."
    return inflation, (warning("inertia-swings-scatter", text, "inertia.*"),)
