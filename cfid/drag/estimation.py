"""Fit one model of drag to experiments: generalised least squares, or any other estimate that is linear in the forces.

The covariance of all forces is V = tau^2 N + C C'. N is the noise of each force and of the reference subtracted from
it, which all forces at one command share; tau is the ratio of the observed to the stated scatter, one for x and y
together and one for z. A column of C is the effect of one standard uncertainty of a setting's wind speed on all forces
there: the true wind lies anywhere between its lowest and highest reading, so an experiment deviates from the prediction
for the middle (Berkson's errors in variables [Ber]), and least squares with this V stays unbiased.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.optimize import brentq

from cfid.counted import counted
from cfid.drag.model import BODY, DragExperiments, DragModel, rows_of
from cfid.errors import FitError
from cfid.estimate.linear import gain_of, std_of

Array = npt.NDArray[np.float64]

_DEPENDENT = 1e-9  # ratio of the smallest to the largest singular value, below which columns count as dependent
_DECIMALS = 12  # of a velocity in m/s: the cosine of 90 degrees is not quite 0
_LEAST_NOISE = 1e-6  # of the root mean square of the forces: less is rounding
_ROUNDS, _SETTLED = 20, 1e-7


@dataclass(frozen=True, kw_only=True)
class DragFit:
    """A fitted model: values (q,) with covariance (q, q), SI units, and residuals (n, 3).

    The model's coefficients come first; with `parasitic`, k in k |v| v follows, drag of the body, for x and y and for
    z; with `intercepts`, a constant force in each wind setting, as a drifting tare causes. `gain` (q, 3n) maps forces
    to values. `noise_scale` is the ratio of observed to stated scatter of the forces in x and y, and in z (in newtons
    where no noise was stated). `condition` is that of the regressors scaled to equal length. `bic` is the Bayesian
    information criterion of the generalised least-squares fit [Sch].
    """

    model: DragModel
    parasitic: bool
    intercepts: bool
    values: Array
    covariance: Array
    gain: Array
    residual_n: Array
    noise_scale: tuple[float, float]
    condition: float
    bic: float

    @property
    def value(self) -> Array:
        """The coefficients as the thesis prints them, by the model's layout."""
        return np.asarray(self.values[self.model.layout])

    @property
    def std(self) -> Array:
        """The standard uncertainties of `value`."""
        return np.asarray(std_of(self.covariance)[self.model.layout])

    @property
    def value_covariance(self) -> Array:
        """The covariance (m, m) of the m numbers in `value`, row by row."""
        places = self.model.layout.ravel()
        return np.asarray(self.covariance[np.ix_(places, places)])

    @property
    def parasitic_kg_per_m(self) -> tuple[Array, Array]:
        """The body's k (3,) for x, y, z, and its standard uncertainties."""
        places = len(self.model.terms) + np.array([0, 0, 1])
        return self.values[places], std_of(self.covariance)[places]

    @property
    def intercepts_n(self) -> Array:
        """The constant force in each wind setting (settings, 3)."""
        return self.values[len(self.model.terms) + (len(BODY) if self.parasitic else 0) :].reshape(-1, 3)

    @property
    def degrees_of_freedom(self) -> int:
        """The number of forces less that of the values."""
        return self.residual_n.size - len(self.values)

    @property
    def sse_n2(self) -> float:
        """The sum of the squared errors over all experiments and axes, as C.3.1 defines it."""
        return float(np.sum(self.residual_n**2))

    def moved_to(self, experiments: DragExperiments) -> "DragFit":
        """Return the fit to experiments that differ a little from those of this fit, to first order."""
        rows, _ = regressors(experiments, self.model, parasitic=self.parasitic, intercepts=self.intercepts)
        residual = experiments.force_n.reshape(-1) - rows @ self.values
        return replace(self, values=self.values + self.gain @ (residual - self.residual_n.reshape(-1)))


def regressors(
    experiments: DragExperiments, model: DragModel, *, parasitic: bool = False, intercepts: bool = False
) -> tuple[Array, Array]:
    """Return the rows (3n, q) of a model's linear equations, and their slopes (3n, q) over relative wind speed."""
    terms = (*model.terms, *(BODY if parasitic else ()))
    velocity = experiments.velocity_mps.round(_DECIMALS)
    still, rows, twice = (
        rows_of(terms, times * velocity, experiments.speed_sum_rad_s).reshape(-1, len(terms)) for times in (0, 1, 2)
    )
    slopes = (twice - still) / 2  # exact, because regressors are at most quadratic in the velocity
    if intercepts:
        same = experiments.setting[:, np.newaxis] == np.arange(experiments.settings)
        constant = np.kron(same, np.eye(3))
        rows, slopes = np.hstack([rows, constant]), np.hstack([slopes, np.zeros_like(constant)])
    return rows, slopes


def fit_drag(
    experiments: DragExperiments,
    model: DragModel,
    *,
    weighted: bool = True,
    gain: Array | None = None,
    intercepts: bool = False,
    parasitic: bool = False,
) -> DragFit:
    """Fit a model to experiments by generalised least squares.

    `weighted=False` weights all forces equally (C.3.1); a `gain` (p, 3n) is any other estimate that is linear in the
    forces. Standard uncertainties contain noise, references and wind in all cases.

    Raises FitError when the experiments do not determine the unknowns: an intercept is constant throughout a wind
    setting, and so are v, v^2 and 1 of the complex model.
    """
    rows, slopes = regressors(experiments, model, parasitic=parasitic, intercepts=intercepts)
    condition = _condition(experiments, model, rows)
    force = experiments.force_n.reshape(-1)
    best, errors, scale, bic = _generalised(experiments, rows, slopes)
    if gain is None:
        gain = best if weighted else gain_of(rows)
    values = _solved(gain, rows, force)
    return DragFit(
        model=model,
        parasitic=parasitic,
        intercepts=intercepts,
        values=values,
        covariance=gain @ errors @ gain.T,
        gain=gain,
        residual_n=(force - rows @ values).reshape(-1, 3),
        noise_scale=scale,
        condition=condition,
        bic=bic,
    )


def _condition(experiments: DragExperiments, model: DragModel, rows: Array) -> float:
    """Return the condition number of the regressors scaled to equal length; refuse dependent ones."""
    if not np.any(experiments.force_n):
        raise FitError("all forces are zero, there is nothing to fit: check the windows of the recordings.")
    length = np.linalg.norm(rows, axis=0)
    singular = np.linalg.svd(rows / np.where(length > 0, length, 1.0), compute_uv=False)
    rank, unknowns = int(np.count_nonzero(singular > _DEPENDENT * singular[0])), rows.shape[1]
    if rank < unknowns:
        more = " with intercepts or a parasitic term" if unknowns > len(model.terms) else ""
        raise FitError(
            f"{counted(len(rows) // 3, 'experiment')} in {counted(experiments.settings, 'wind setting')} determine "
            f"{rank} of {unknowns} unknowns of the {model.name} model{more}: record more wind settings and commands, "
            "or leave out what is constant throughout a wind setting."
        )
    return float(singular[0] / singular[-1])


def _solved(gain: Array, rows: Array, force: Array) -> Array:
    values = gain @ force
    return np.asarray(values + gain @ (force - rows @ values))  # corrects for rounding


def _generalised(
    experiments: DragExperiments, rows: Array, slopes: Array
) -> tuple[Array, Array, tuple[float, float], float]:
    """Return the gain of generalised least squares, the covariance V (3n, 3n) of the forces, tau, and the BIC.

    The effect of the wind's error depends on the values, so they are found in a few rounds, in coordinates whose stated
    noise is white. N has no covariance between axes, so tau multiplies rows there too.
    """
    force, setting = experiments.force_n.reshape(-1), np.repeat(experiments.setting, 3)
    of_setting = setting[:, np.newaxis] == np.arange(experiments.settings)
    wind_std = np.repeat(experiments.wind_relative_std, 3)
    noise = stated_noise(experiments)
    root = np.linalg.cholesky(noise)
    white_rows, white_force = (solve_triangular(root, columns, lower=True) for columns in (rows, force))
    values = _solved(gain_of(white_rows), white_rows, white_force)
    for _ in range(_ROUNDS):
        wind = (wind_std * (slopes @ values))[:, np.newaxis] * of_setting
        white_wind = solve_triangular(root, wind, lower=True)
        scale = _noise_scale(experiments, rows, residual=white_force - white_rows @ values, wind=white_wind)
        times = np.tile(np.repeat(scale, [2, 1]), len(experiments.command))
        white_root = np.linalg.cholesky(np.diag(times**2) + white_wind @ white_wind.T)
        final_rows, final_force = (
            solve_triangular(white_root, columns, lower=True) for columns in (white_rows, white_force)
        )
        white_gain, before = gain_of(final_rows), values
        values = _solved(white_gain, final_rows, final_force)
        if np.all(np.abs(values - before) <= _SETTLED * std_of(white_gain @ white_gain.T)):
            break
    gain = solve_triangular(
        root, solve_triangular(white_root, white_gain.T, lower=True, trans="T"), lower=True, trans="T"
    ).T
    errors = noise * np.outer(times, times) + wind @ wind.T
    residual = final_force - final_rows @ values
    log_determinant = 2 * float(np.log(np.diag(root)).sum() + np.log(np.diag(white_root)).sum())
    deviance = float(residual @ residual) + log_determinant + len(force) * math.log(math.tau)
    return gain, errors, scale, deviance + rows.shape[1] * math.log(len(force))


def stated_noise(experiments: DragExperiments) -> Array:
    """Return N (3n, 3n): the noise of each force, and of the reference that all forces at its command share."""
    same = np.kron(experiments.command[:, np.newaxis] == experiments.command, np.eye(3))
    reference = experiments.reference_std_n.reshape(-1)
    return np.diag(experiments.force_std_n.reshape(-1) ** 2) + same * np.outer(reference, reference)


def _noise_scale(experiments: DragExperiments, rows: Array, *, residual: Array, wind: Array) -> tuple[float, float]:
    """Return tau in x and y, and in z, for which residuals (3n,) have the expected chi-squared [MP].

    Residuals and the wind's columns are in units of the stated noise, which may be too small, never too large. Raises
    FitError when the noise is unknown and no residual is left to estimate it from.
    """
    vertical = np.tile([False, False, True], len(residual) // 3)
    least = 1.0
    if not experiments.noise_known:
        force, std = (np.sqrt(np.mean(values**2)) for values in (experiments.force_n, experiments.force_std_n))
        least = float(_LEAST_NOISE * force / std)
    scales = []
    for axes in (~vertical, vertical):
        unknowns = int(rows[axes].any(axis=0).sum())
        forces = int(np.count_nonzero(axes))
        if forces <= unknowns and not experiments.noise_known:
            raise FitError(
                f"{forces} forces and {unknowns} unknowns leave no degree of freedom to estimate the noise from: "
                "record more."
            )
        scales.append(_scale(residual[axes], wind[axes], degrees_of_freedom=forces - unknowns, least=least))
    return scales[0], scales[1]


def _scale(residual: Array, wind: Array, *, degrees_of_freedom: int, least: float) -> float:
    """Return tau for residuals (m,) and the wind's columns (m, k) in units of the stated noise."""
    direction, std, _ = np.linalg.svd(wind, full_matrices=False)
    along = (direction.T @ residual) ** 2
    total = float(residual @ residual)
    across = max(total - float(along.sum()), 0.0)

    def excess(log_variance: float) -> float:
        variance = math.exp(log_variance)
        return float(across / variance + np.sum(along / (variance + std**2))) - degrees_of_freedom

    most = 2 * total / max(degrees_of_freedom, 1)
    if degrees_of_freedom < 1 or most <= least**2 or excess(math.log(least**2)) <= 0:
        return least
    return math.exp(brentq(excess, math.log(least**2), math.log(most), xtol=1e-6) / 2)
