"""The inertia matrix from axis inertias by generalised least squares, its budget, and what swings show of each other.

A body's second moments J = tr(I)/2 * 1 - I are a positive definite matrix: this condition contains the positive
eigenvalues and the triangle inequality, and is sufficient [WKS].
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.special import chdtrc, chdtri
from uncertainties import nominal_value, std_dev

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.linear import gain_of
from cfid.findings import Finding, rejection, warning
from cfid.quantities.values import ENTRIES
from cfid.swing.body import BEYOND_STD, OF_MOUNTS, AxisInertias, budget, effects, numbers, uncertain

Array = npt.NDArray[np.float64]

MATRIX = "inertia.matrix_kg_m2"
UNLIKELY = 1e-3  # chance of a chi-squared as large, below which the swings contradict each other
SCATTER_BY_CHANCE = 0.05  # chance of a chi-squared as large, above which scatter needs no cause
DISTANCES_APART_STD = 3.0

_UNKNOWNS = 6
_INDEPENDENT = 1e-6  # smallest over largest singular value of the axes' rows
_LEAST_THICKNESS = 1e-6  # smallest second moment, relative to the trace, that the refit may reach
_PARALLEL = math.cos(math.radians(2))
_OTHER_DISTANCE = 1.05
_NAMED = 4  # suspects in a sentence


@dataclass(frozen=True, kw_only=True)
class InertiaFit:
    """The inertia matrix about the centre of mass, entries of the matrix itself, in the body frame.

    `residual` (n,) is that of each swing's inertia, relative to its expected standard uncertainty (None for six swings,
    which leave none). `budget` is the contribution (3, 3) of each group of causes to the matrix' standard uncertainty.
    `covariance` (6, 6) is that of the entries xx, yy, zz, xy, xz, yz; `common` is the effect (6,) on them of one
    standard uncertainty of each cause that other fits may share: mass, gravity, the centre of mass in x, y and z.
    `raw_matrix_kg_m2` is the unconstrained solution where that was no possible body, else None, and `suspects` are the
    mounts without which swings that contradict each other agree.
    """

    axes: AxisInertias
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
    suspects: tuple[str, ...]
    findings: tuple[Finding, ...]


def fit_inertia(axes: AxisInertias) -> InertiaFit:
    """Solve eq. 2.2 for the matrix, with weights from all uncertainties.

    Any number of swings about any axes is possible, but the axes must determine all six entries. A body that is hung
    anew takes another place in its mount. Swings that scatter more than their uncertainties allow widen them by the
    Birge ratio.

    Raises FitError when they do not.
    """
    rows = matrix_rows(numbers(axes.direction))
    singular = np.linalg.svd(rows, compute_uv=False)
    independent = int(np.count_nonzero(singular > _INDEPENDENT * singular[0]))
    if independent < _UNKNOWNS:
        raise FitError(
            f"{counted(len(rows), 'swing')} about {counted(independent, 'independent axis', 'independent axes')}: six "
            "are needed for the six entries of the matrix. Swing about another axis; six that lie evenly are "
            "(0, 1, 1.618), (0, 1, -1.618), (1, 1.618, 0), (1, -1.618, 0), (1.618, 0, 1), (-1.618, 0, 1)."
        )
    axes = _hung_anew(axes)
    solved = _solve(axes, np.arange(len(rows)))
    freedom = len(rows) - _UNKNOWNS
    contradictory = _contradictory(solved.chi_squared, freedom)
    widening = 1.0
    findings: list[Finding] = []
    if freedom > 0 and solved.chi_squared > chdtri(freedom, SCATTER_BY_CHANCE):
        widening = math.sqrt(solved.chi_squared / freedom)
        text = (
            f"the swings scatter {widening:.1f} times as far as their uncertainties allow (chi-squared "
            f"{solved.chi_squared:.1f} for {counted(freedom, 'degree', 'degrees')} of freedom)"
        )
        if not contradictory:
            text += ": the standard uncertainties are widened by that."
            findings.append(warning("inertia-swings-scatter", text, "inertia.*"))
    possible = is_consistent(as_matrix(solved.entries))
    entries = solved.entries if possible else nearest_consistent(solved.entries, solved.covariance)
    projection_std = _deviation(entries - solved.entries, solved.covariance)
    if not possible:
        finding = (
            "the six entries belong to no possible body (triangle inequality); the nearest one lies "
            f"{projection_std:.1f} standard uncertainties away"
        )
        if projection_std > BEYOND_STD:
            finding += (
                f" (limit {BEYOND_STD:g}). Two swings may be exchanged, or a mount, a distance or the mass wrong."
            )
            findings.append(rejection("inertia-not-a-body", finding, MATRIX))
        else:
            finding += " and is given; quality.raw_matrix_kg_m2 has the raw entries. Check mounts and distances."
            findings.append(warning("inertia-not-a-body", finding, MATRIX))
    suspects = _suspects(axes) if contradictory or projection_std > BEYOND_STD else ()
    if contradictory:
        text += ": they contradict each other. " + (
            f"Without {_listed(suspects)} the others agree: `cfid runs exclude` leaves a run out, or swing it again; "
            "check its label and mount."
            if suspects
            else "No single one explains it. Check labels, mounts, mass and centre of mass; swing about more axes."
        )
        findings.append(rejection("inertia-swings-contradict", text, "inertia.*"))
    spread = widening * np.sqrt(np.diag(solved.covariance))
    shares = budget(solved.moved, solved.causes)
    if widening > 1:
        shares["scatter between swings"] = math.sqrt(1 - widening**-2) * spread
    moved = dict(zip(solved.causes, solved.moved.T, strict=True))
    return InertiaFit(
        axes=axes,
        matrix_kg_m2=as_matrix(entries),
        std_kg_m2=as_matrix(spread),
        covariance=widening**2 * solved.covariance,
        common={name: moved[cause] for name, cause in axes.shared.items() if cause in moved},
        residual=None if freedom == 0 else solved.residual / solved.residual_std,
        chi_squared=solved.chi_squared,
        degrees_of_freedom=freedom,
        budget={name: as_matrix(share) for name, share in shares.items()},
        raw_matrix_kg_m2=None if possible else as_matrix(solved.entries),
        condition=float(singular[0] / singular[-1]),
        suspects=suspects,
        findings=(*findings, *_small_moment(as_matrix(entries), solved.covariance), *distances_apart(axes)),
    )


def _hung_anew(axes: AxisInertias) -> AxisInertias:
    """Return the inertias with what each hanging of a body leaves uncertain, where swings about a mount are repeated.

    The share of a mount's errors that each hanging has anew is that by which such swings scatter beyond their fits
    [DL], and at most the whole: swings that differ further contradict each other.
    """
    names = [swing.axis for swing in axes.swings]
    repeated = [np.flatnonzero([one == name for one in names]) for name in dict.fromkeys(names)]
    repeated = [places for places in repeated if len(places) > 1]
    rows = matrix_rows(axes.direction)
    entries = np.linalg.lstsq(numbers(rows), numbers(axes.about_centre_kg_m2), rcond=None)[0]
    residual = axes.about_centre_kg_m2 - rows @ entries  # a tilt moves an axis' row, too
    moved, causes = effects(residual)
    fits, mounts = (
        np.linalg.norm(moved[:, [cause.tag in tags for cause in causes]], axis=1)
        for tags in (("swing fits",), OF_MOUNTS)
    )
    excess = expected = 0.0
    for places in repeated:
        if not fits[places].all():
            return axes
        weight, values = fits[places] ** -2.0, numbers(residual[places])
        excess += float(weight @ (values - weight @ values / weight.sum()) ** 2) - (len(places) - 1)
        expected += float((weight - weight**2 / weight.sum()) @ mounts[places] ** 2)
    if excess <= 0 or not expected:
        return axes
    about_centre = axes.about_centre_kg_m2.copy()
    for place in np.concatenate(repeated):
        std = math.sqrt(min(excess / expected, 1.0)) * mounts[place]
        about_centre[place] = about_centre[place] + uncertain(0.0, std, "hangings")
    return axes._replace(about_centre_kg_m2=about_centre)


class _Solved(NamedTuple):
    """Six raw entries with the effect (6, causes) of each cause and their covariance, and the residual (n,)."""

    entries: Array
    moved: Array
    causes: tuple[Any, ...]
    covariance: Array
    residual: Array
    residual_std: Array
    chi_squared: float


def _solve(axes: AxisInertias, kept: npt.NDArray[np.intp]) -> _Solved:
    """Solve for the entries by generalised least squares, from the swings `kept` (k,)."""
    uncertain_rows, measured = matrix_rows(axes.direction[kept]), axes.about_centre_kg_m2[kept]
    rows, inertias = numbers(uncertain_rows), numbers(measured)
    entries = np.linalg.lstsq(rows, inertias, rcond=None)[0].astype(np.float64)
    for _ in range(2):  # a tilt moves an axis' row too, by an amount that depends on the matrix: hence twice
        columns, causes = effects(measured - uncertain_rows @ entries)
        covariance = columns @ columns.T
        # Common causes make this nearly singular when nothing else is uncertain.
        floor = 1e-6 * float(np.trace(covariance)) / len(rows) or 1.0
        gain = gain_of(rows, covariance=covariance + floor * np.eye(len(rows)))
        entries = np.asarray(gain @ inertias)
    residual, moved = inertias - rows @ entries, gain @ columns
    expected = np.linalg.norm(columns - rows @ moved, axis=1)
    least = 1e-9 * float(np.max(np.linalg.norm(columns, axis=1), initial=0.0)) or 1.0
    chi_squared = 0.0
    if len(rows) > _UNKNOWNS and np.any(columns):
        chi_squared = float(residual @ np.linalg.pinv(covariance, hermitian=True) @ residual)
    return _Solved(entries, moved, causes, moved @ moved.T, residual, np.maximum(expected, least), chi_squared)


def _contradictory(chi_squared: float, freedom: int) -> bool:
    """Return whether swings scatter more than their uncertainties would let them, except once in a thousand times."""
    return freedom > 0 and bool(chdtrc(freedom, chi_squared) < UNLIKELY)


def _suspects(axes: AxisInertias) -> tuple[str, ...]:
    """Return the runs, or else mounts, of swings without which the others agree; none where each is such a one."""
    count, names = len(axes.swings), []
    for i, swing in enumerate(axes.swings):
        kept = np.flatnonzero(np.arange(count) != i)
        if np.linalg.matrix_rank(matrix_rows(numbers(axes.direction[kept])), tol=_INDEPENDENT) < _UNKNOWNS:
            continue
        solved = _solve(axes, kept)
        if _contradictory(solved.chi_squared, count - 1 - _UNKNOWNS):
            continue
        nearest = solved.entries
        if not is_consistent(as_matrix(nearest)):
            nearest = nearest_consistent(solved.entries, solved.covariance)
        if _deviation(nearest - solved.entries, solved.covariance) <= BEYOND_STD:
            names.append(swing.name.partition("/")[0] or swing.axis)
    return tuple(dict.fromkeys(names)) if len(names) < count else ()


def distances_apart(axes: AxisInertias) -> tuple[Finding, ...]:
    """Compare the inertias about the centre of mass that swings about parallel axes at different distances give."""
    directions, distances, findings = numbers(axes.direction), numbers(axes.distance_m), []
    for i, j in combinations(range(len(axes.swings)), 2):
        near, far = sorted((distances[i], distances[j]))
        if abs(float(directions[i] @ directions[j])) < _PARALLEL or far < _OTHER_DISTANCE * near:
            continue
        difference = axes.about_centre_kg_m2[i] - axes.about_centre_kg_m2[j]
        if not std_dev(difference) or abs(nominal_value(difference)) <= DISTANCES_APART_STD * std_dev(difference):
            continue
        names = [axes.swings[k].axis for k in (i, j)]
        text = (
            f"{names[0]} and {names[1]} lie along one axis, {1e3 * near:.1f} and {1e3 * far:.1f} mm from the centre of "
            f"mass, and their inertias differ by {abs(nominal_value(difference)) / std_dev(difference):.1f} standard "
            f"uncertainties (limit {DISTANCES_APART_STD:g}). Likely causes: a cable's stiffness, a wrong distance or "
            "centre of mass, a neglected fixture."
        )
        resting = (f"inertia.*_kg_m2.{name}" for name in names)
        findings.append(rejection("inertia-distances-differ", text, MATRIX, *resting))
    return tuple(findings)


def _small_moment(matrix: Array, covariance: Array) -> Iterator[Finding]:
    """Reject a principal moment that is smaller than its standard uncertainty."""
    values, vectors = np.linalg.eigh(matrix)
    rows = matrix_rows(vectors.T)
    std = np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows))
    worst = int(np.argmin(values - std))
    if values[worst] < std[worst]:
        text = (
            f"a principal moment, {values[worst]:.3g} kg m^2, is smaller than its standard uncertainty, "
            f"{std[worst]:.3g}. Swing nearer to the centre of mass; check mass and distances."
        )
        yield rejection("inertia-below-uncertainty", text, MATRIX)


def _listed(names: tuple[str, ...]) -> str:
    shown = names[:_NAMED]
    if len(names) > _NAMED:
        return f"{', '.join(shown)} or {len(names) - _NAMED} more"
    return " or ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))


def matrix_rows(direction: Any) -> Any:
    """Return the rows (n, 6) that take the entries xx, yy, zz, xy, xz, yz to u' I u, for unit vectors (n, 3)."""
    x, y, z = direction.T
    return np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)


def as_matrix(entries: Array) -> Array:
    """Return the symmetric matrix of the entries xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


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

    def possible(factor: Array) -> Array:
        lower = np.diag(np.exp(factor[:3]))
        lower[[1, 2, 2], [0, 0, 1]] = factor[3:]
        moments = scale * lower @ lower.T
        matrix = np.trace(moments) * np.eye(3) - moments
        return np.asarray(matrix[tuple(zip(*ENTRIES.values(), strict=True))])

    moments = _second_moments(as_matrix(entries)) / scale
    values, vectors = np.linalg.eigh(moments)
    start = np.linalg.cholesky(vectors @ np.diag(np.maximum(values, 0.01 * values.max())) @ vectors.T)
    lowest = 0.5 * math.log(_LEAST_THICKNESS)
    begin = np.concatenate([np.maximum(np.log(np.diag(start)), lowest), start[[1, 2, 2], [0, 0, 1]]])
    bounds = ([lowest] * 3 + [-np.inf] * 3, [np.inf] * 6)
    found = least_squares(lambda factor: whiten @ (possible(factor) - entries), begin, bounds=bounds, xtol=1e-12)
    return possible(found.x)


def _second_moments(matrix: Array) -> Array:
    return np.asarray(np.trace(matrix) / 2 * np.eye(3) - matrix)


def _deviation(difference: Array, covariance: Array) -> float:
    """Return how many standard uncertainties a difference (6,) between entries is."""
    if not difference.any():
        return 0.0
    floor = (1e-6 * float(np.trace(covariance)) or 1.0) * np.eye(len(difference))
    return float(np.sqrt(difference @ np.linalg.solve(covariance + floor, difference)))
