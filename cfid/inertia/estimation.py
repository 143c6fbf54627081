"""The inertia matrix from axis inertias: generalised least squares, budget, consistency, mounting advice."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import chdtrc, chdtri

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.linear import gain_of
from cfid.estimate.propagation import Input, budget
from cfid.findings import Finding, note, rejection, warning
from cfid.inertia.consistency import as_matrix, is_consistent, nearest_consistent
from cfid.inertia.directions import matrix_rows
from cfid.inertia.sensitivities import UNKNOWNS, Moved, moved_by_inputs
from cfid.swing.axis_inertias import AxisInertias
from cfid.swing.plausibility import BEYOND_STD

Array = npt.NDArray[np.float64]

MATRIX = "inertia.matrix_kg_m2"
UNLIKELY = 1e-3  # chance of a chi-squared as large, below which the swings contradict each other
SCATTER_BY_CHANCE = 0.05  # chance of a chi-squared as large, above which scatter needs no cause
_SHARED = ("mass", "gravity", "centre of mass")  # groups of inputs
_INDEPENDENT = 1e-6  # smallest over largest singular value of the axes' rows


@dataclass(frozen=True, kw_only=True)
class MeasuredAxes:
    """What each swing gives (n,), whether or not the swings determine a matrix.

    These are the inertias about the mounting axis and about the parallel axis through the centre of mass, each with its
    standard uncertainty, `sensitivity_kg_m` = dI_G/dr, and `best_distance_m`, where that vanishes. On threads there is
    no distance.
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

    `moved` is the effect of each input on the swings. `residual` (n,) is that of each swing's inertia, relative to its
    expected standard uncertainty (None for six swings, which leave none). `budget` is the contribution (3, 3) of each
    group of inputs to the matrix' standard uncertainty. `covariance` (6, 6) is that of the entries xx, yy, zz, xy, xz,
    yz; `common` is the effect (6,) on them of one standard uncertainty of each input that other fits may share: mass,
    gravity, the centre of mass in x, y and z. `raw_matrix_kg_m2` is the unconstrained solution where that was no
    possible body, else None, and `projection_std` how many standard uncertainties lie between the two.
    """

    axes: MeasuredAxes
    moved: Moved
    matrix_kg_m2: Array
    std_kg_m2: Array
    covariance: Array
    common: dict[str, Array]
    residual: Array | None
    chi_squared: float
    degrees_of_freedom: int
    budget: dict[str, Array]
    raw_matrix_kg_m2: Array | None
    projection_std: float
    condition: float
    findings: tuple[Finding, ...]

    @property
    def contradictory(self) -> bool:
        """Whether the swings contradict each other, or every possible body."""
        return contradictory(self.chi_squared, self.degrees_of_freedom) or self.projection_std > BEYOND_STD


def contradictory(chi_squared: float, degrees_of_freedom: int) -> bool:
    """Return whether swings scatter more than their uncertainties would let them, except once in a thousand times."""
    return degrees_of_freedom > 0 and bool(chdtrc(degrees_of_freedom, chi_squared) < UNLIKELY)


def measure_axes(axis_inertias: AxisInertias) -> MeasuredAxes:
    """Return the inertias about each swing's axis, with the uncertainties that all inputs give them."""
    return _measured(axis_inertias, moved_by_inputs(axis_inertias))


def fit_inertia(axis_inertias: AxisInertias) -> InertiaFit:
    """Solve eq. 2.2 for the matrix, with weights from all uncertainties.

    Any number of swings about any axes is possible, but the axes must determine all six entries.

    Raises FitError when they do not.
    """
    evaluated = axis_inertias.evaluate(axis_inertias.values)
    rows = matrix_rows(evaluated.direction)
    condition = _check_axes(rows)
    moved, hangings, solved, hanging_findings = _solved_with_hangings(axis_inertias, rows)
    gain, columns, covariance = solved.gain, solved.columns, solved.covariance
    degrees_of_freedom = len(rows) - UNKNOWNS
    inflation, findings = _scatter(solved.chi_squared, degrees_of_freedom)
    findings += hanging_findings
    raw, entries = as_matrix(solved.entries), solved.possible()
    projection_std = deviation(entries - solved.entries, covariance)
    findings += (*_projection_finding(raw, projection_std), *_moment_findings(as_matrix(entries), covariance))
    spread = inflation * np.sqrt(np.diag(covariance))
    shares = budget(gain @ columns, (*axis_inertias.inputs, *hangings))
    if inflation > 1:
        shares["scatter between swings"] = math.sqrt(1 - inflation**-2) * spread
    return InertiaFit(
        axes=_measured(axis_inertias, moved),
        moved=moved,
        matrix_kg_m2=as_matrix(entries),
        std_kg_m2=as_matrix(spread),
        covariance=inflation**2 * covariance,
        common=_common(gain @ columns[:, : len(axis_inertias.inputs)], axis_inertias),
        residual=None if degrees_of_freedom == 0 else solved.residual / _residual_std(rows, gain, columns),
        chi_squared=solved.chi_squared,
        degrees_of_freedom=degrees_of_freedom,
        budget={name: as_matrix(share) for name, share in shares.items()},
        raw_matrix_kg_m2=None if is_consistent(raw) else raw,
        projection_std=projection_std,
        condition=condition,
        findings=findings,
    )


class Solved(NamedTuple):
    """Six raw entries, the matrices that led to them, and the residual (n,)."""

    entries: Array
    gain: Array
    columns: Array
    covariance: Array
    residual: Array
    chi_squared: float

    def possible(self) -> Array:
        """Return the entries (6,) of the nearest possible body, which take longer to find than the raw ones."""
        consistent = is_consistent(as_matrix(self.entries))
        return self.entries if consistent else nearest_consistent(self.entries, self.covariance)


def _solved_with_hangings(
    axis_inertias: AxisInertias, rows: Array
) -> tuple[Moved, Sequence[Input], Solved, tuple[Finding, ...]]:
    """Solve; where swings about one mount differ by more than their fits allow, give each its own hanging.

    A body that is hung anew takes another place in its mount, within the mount's uncertainty. The share of that
    uncertainty in each hanging is the one with which the swings scatter as expected, up to the whole; swings that
    contradict each other even then are solved without hangings. Returns by how much inputs and hangings move the
    swings, the hangings as inputs, the solution, and findings.
    """
    inertias, inputs = axis_inertias.evaluate(axis_inertias.values).about_centre_kg_m2, axis_inertias.inputs
    moved = moved_by_inputs(axis_inertias)
    solved = solve(rows, inertias, moved)
    mounts = [swing.axis for swing in axis_inertias.swings]
    repeated = [mount for mount in dict.fromkeys(mounts) if mounts.count(mount) > 1]
    freedom = len(rows) - UNKNOWNS
    if not repeated or solved.chi_squared <= chdtri(freedom, SCATTER_BY_CHANCE):
        return moved, (), solved, ()

    def excess(share: float) -> float:
        return solve(rows, inertias, moved.hung_anew(inputs, share)).chi_squared - freedom

    most = excess(1.0)
    if contradictory(most + freedom, freedom):
        return moved, (), solved, ()
    share = 1.0 if most > 0 else brentq(excess, 0.0, 1.0, xtol=1e-4)
    moved = moved.hung_anew(inputs, share)
    hanging = Input(name="hanging", group="hangings", value=0.0, std=share)
    hangings = [hanging] * (moved.about_centre.shape[1] - len(inputs))
    text = (
        f"swings about {' and '.join(repeated)} differ by more than their fits allow, as bodies do that are hung anew: "
        f"each hanging counts with {100 * share:.0f} % of its mount's standard uncertainties."
    )
    return moved, hangings, solve(rows, inertias, moved), (note("inertia-hangings-differ", text, MATRIX),)


def solve(rows: Array, about_centre_kg_m2: Array, moved: Moved) -> Solved:
    """Solve for the entries by generalised least squares, with rows (n, 6) and inertias (n,)."""
    entries = np.linalg.lstsq(rows, about_centre_kg_m2, rcond=None)[0].astype(np.float64)
    # A tilt moves an axis' row too, by an amount that depends on the matrix: hence twice.
    for _ in range(2):
        columns = moved.about_centre - np.einsum("nei,e->ni", moved.rows, entries)
        gain, covariance = _gain(rows, columns)
        entries = np.asarray(gain @ about_centre_kg_m2)
    residual = about_centre_kg_m2 - rows @ entries
    return Solved(entries, gain, columns, covariance, residual, _chi_squared(residual, columns))


def deviation(difference: Array, covariance: Array) -> float:
    """Return how many standard uncertainties a difference (6,) between entries is."""
    if not difference.any():
        return 0.0
    floor = (1e-6 * float(np.trace(covariance)) or 1.0) * np.eye(len(difference))
    return float(np.sqrt(difference @ np.linalg.solve(covariance + floor, difference)))


def _check_axes(rows: Array) -> float:
    singular = np.linalg.svd(rows, compute_uv=False)
    independent = int(np.count_nonzero(singular > _INDEPENDENT * singular[0]))
    if independent < UNKNOWNS:
        raise FitError(
            f"{counted(len(rows), 'swing')} about "
            f"{counted(independent, 'independent axis', 'independent axes')}: six are needed for the six entries "
            "of the "
            "matrix. Swing about another axis; six that lie evenly are (0, 1, 1.618), (0, 1, -1.618), (1, 1.618, 0), "
            "(1, -1.618, 0), (1.618, 0, 1), (-1.618, 0, 1)."
        )
    return float(singular[0] / singular[-1])


def _measured(axis_inertias: AxisInertias, moved: Moved) -> MeasuredAxes:
    found, mass = axis_inertias.evaluate(axis_inertias.values), axis_inertias.body.mass_kg
    return MeasuredAxes(
        about_axis_kg_m2=found.about_axis_kg_m2,
        about_axis_std_kg_m2=_norms(moved.about_axis),
        about_centre_kg_m2=found.about_centre_kg_m2,
        about_centre_std_kg_m2=_norms(moved.about_centre),
        distance_m=found.distance_m,
        sensitivity_kg_m=np.divide(
            found.about_axis_kg_m2, found.distance_m, out=np.zeros(len(found.distance_m)), where=found.distance_m > 0
        )
        - 2 * mass * found.distance_m,
        best_distance_m=np.sqrt(np.maximum(found.about_centre_kg_m2, 0.0) / mass),
    )


def _common(columns: Array, axis_inertias: AxisInertias) -> dict[str, Array]:
    """Return the columns (6,) of those uncertain inputs that other fits may share."""
    named = zip(axis_inertias.inputs, columns.T, strict=True)
    return {given.name: column for given, column in named if given.group in _SHARED and given.std > 0}


def _norms(columns: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(columns**2, axis=1)))


def _gain(rows: Array, columns: Array) -> tuple[Array, Array]:
    """Return the weighted least-squares gain (6, n) and the entries' covariance.

    Common inputs (mass, gravity) make the swings' covariance nearly singular when nothing else is uncertain; a floor of
    a millionth of its size keeps the weights finite without a noticeable effect.
    """
    covariance = columns @ columns.T
    size = float(np.trace(covariance)) / len(rows)
    gain = gain_of(rows, covariance=covariance + (1e-6 * size or 1.0) * np.eye(len(rows)))
    return gain, gain @ covariance @ gain.T


def _residual_std(rows: Array, gain: Array, columns: Array) -> Array:
    """Return the expected standard uncertainties (n,) of the residuals, from which the fit takes what swings share."""
    left = columns - rows @ (gain @ columns)
    floor = 1e-9 * float(np.max(_norms(columns), initial=0.0)) or 1.0
    return np.maximum(_norms(left), floor)


def _chi_squared(residual: Array, columns: Array) -> float:
    if len(residual) == UNKNOWNS or not np.any(columns):
        return 0.0
    return float(residual @ np.linalg.pinv(columns @ columns.T, hermitian=True) @ residual)


def _projection_finding(raw: Array, projection_std: float) -> tuple[Finding, ...]:
    """Return a finding where the raw entries belong to no body, on how far away the nearest possible body lies."""
    if is_consistent(raw):
        return ()
    text = (
        "the six entries belong to no possible body (triangle inequality); the nearest one lies "
        f"{projection_std:.1f} standard uncertainties away"
    )
    if projection_std > BEYOND_STD:
        text += f" (limit {BEYOND_STD:g}). Two swings may be exchanged, or a mount, a distance or the mass is wrong."
        return (rejection("inertia-not-a-body", text, MATRIX),)
    text += " and is given; quality.raw_matrix_kg_m2 has the raw entries. Check mounts and distances."
    return (warning("inertia-not-a-body", text, MATRIX),)


def _moment_findings(matrix: Array, covariance: Array) -> tuple[Finding, ...]:
    """Reject a principal moment that is smaller than its standard uncertainty."""
    values, vectors = np.linalg.eigh(matrix)
    rows = matrix_rows(vectors.T)
    std = np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows))
    if np.all(values >= std):
        return ()
    worst = int(np.argmin(values - std))
    text = (
        f"a principal moment, {values[worst]:.3g} kg m^2, is smaller than its standard uncertainty, {std[worst]:.3g}. "
        "Swing nearer to the centre of mass; check mass and distances."
    )
    return (rejection("inertia-below-uncertainty", text, MATRIX),)


def _scatter(chi_squared: float, degrees_of_freedom: int) -> tuple[float, tuple[Finding, ...]]:
    """Return the factor by which repeated swings scatter beyond their uncertainties, and a finding about that."""
    if degrees_of_freedom == 0 or chi_squared <= chdtri(degrees_of_freedom, SCATTER_BY_CHANCE):
        return 1.0, ()
    inflation = math.sqrt(chi_squared / degrees_of_freedom)
    text = (
        f"the swings scatter {inflation:.1f} times as far as their uncertainties allow "
        f"(chi-squared {chi_squared:.1f} for {degrees_of_freedom} degrees of freedom): "
    )
    if contradictory(chi_squared, degrees_of_freedom):
        text += "they contradict each other."
        return inflation, (rejection("inertia-swings-contradict", text, "inertia.*"),)
    text += "the standard uncertainties are widened by that."
    return inflation, (warning("inertia-swings-scatter", text, "inertia.*"),)
