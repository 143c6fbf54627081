"""Fit one model of drag to experiments: generalised least squares, plain least squares, or any other linear gain."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.drag.covariance import ForceErrors, force_errors, noise_scale, stated_noise, wind_columns
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import BODY, DragModel, rows_of
from cfid.errors import FitError
from cfid.estimate.linear import Estimate, fit_linear, gain_of, std_of

Array = npt.NDArray[np.float64]

_DEPENDENT = 1e-9  # ratio of the smallest to the largest singular value, below which columns count as dependent
_ROUNDS, _SETTLED = 20, 1e-7


class Uncertain(NamedTuple):
    """Values with their standard uncertainties, of equal shape."""

    value: Array
    std: Array


@dataclass(frozen=True, kw_only=True)
class DragFit:
    """A fitted model: coefficients (p,) with covariance (p, p), SI units, and residuals (n, 3).

    `parasitic_kg_per_m` (3,) is k in k |v| v, drag of the body; `intercepts_n` (settings, 3) is a constant force in
    each wind setting, as a drifting tare causes; each is None where it is not part of the fit. `noise_scale` (2,) is
    the ratio of observed to stated scatter of the forces in x and y, and in z (in newtons where no noise was stated).
    `condition` is that of the regressors scaled to equal length.
    """

    model: DragModel
    coefficients: Array
    covariance: Array
    parasitic_kg_per_m: Uncertain | None
    intercepts_n: Uncertain | None
    residual_n: Array
    noise_scale: tuple[float, float]
    degrees_of_freedom: int
    condition: float

    @property
    def value(self) -> Array:
        """The coefficients as the thesis prints them, by the model's layout."""
        return np.asarray(self.coefficients[self.model.layout])

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
    def sse_n2(self) -> float:
        """The sum of the squared errors over all experiments and axes, as C.3.1 defines it."""
        return float(np.sum(self.residual_n**2))


@dataclass(frozen=True, kw_only=True)
class Design:
    """The regressors (3n, q) of experiments, and their derivatives (3n, q) with respect to relative wind speeds.

    The model's p columns come first, then two for the body's drag, then three intercepts per wind setting.
    """

    experiments: DragExperiments
    model: DragModel
    rows: Array
    slopes: Array

    @property
    def force_n(self) -> Array:
        """The forces (3n,), experiment by experiment."""
        return self.experiments.force_n.reshape(-1)


class Solution(NamedTuple):
    """Solution (q,) of linear equations with its covariance (q, q), the errors of the forces and their tau."""

    values: Array
    covariance: Array
    errors: ForceErrors
    noise_scale: tuple[float, float]


def design(
    experiments: DragExperiments, model: DragModel, *, parasitic: bool = False, intercepts: bool = False
) -> Design:
    """Return the equations of a model, with the body's drag and a constant force in each wind setting if wanted."""
    terms = (*model.terms, *(BODY if parasitic else ()))
    speed_sum = experiments.speed_sum_rad_s
    still, rows, twice = (
        rows_of(terms, times * experiments.velocity_mps, speed_sum).reshape(-1, len(terms)) for times in (0, 1, 2)
    )
    slopes = (twice - still) / 2  # exact, because regressors are at most quadratic in the velocity
    if intercepts:
        same = experiments.setting[:, np.newaxis] == np.arange(experiments.settings)
        constant = np.kron(same, np.eye(3))
        rows, slopes = np.hstack([rows, constant]), np.hstack([slopes, np.zeros_like(constant)])
    return Design(experiments=experiments, model=model, rows=rows, slopes=slopes)


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
    equations = design(experiments, model, parasitic=parasitic, intercepts=intercepts)
    condition = _condition(equations)
    if gain is None and not weighted:
        gain = gain_of(equations.rows)
    found = solve(equations) if gain is None else _estimated(equations, gain)
    rows, std, p = equations.rows, std_of(found.covariance), model.unknowns
    body, settings = [p, p, p + 1], slice(p + (2 if parasitic else 0), None)
    return DragFit(
        model=model,
        coefficients=found.values[:p],
        covariance=found.covariance[:p, :p],
        parasitic_kg_per_m=Uncertain(found.values[body], std[body]) if parasitic else None,
        intercepts_n=_by_setting(found.values[settings], std[settings]) if intercepts else None,
        residual_n=experiments.force_n - (rows @ found.values).reshape(-1, 3),
        noise_scale=found.noise_scale,
        degrees_of_freedom=rows.shape[0] - rows.shape[1],
        condition=condition,
    )


def _by_setting(values: Array, std: Array) -> Uncertain:
    return Uncertain(values.reshape(-1, 3), std.reshape(-1, 3))


def solve(equations: Design) -> Solution:
    """Solve for the unknowns by generalised least squares.

    The effect of the wind's error depends on the coefficients, so they are found in a few rounds.
    """
    experiments, rows, force = equations.experiments, equations.rows, equations.force_n
    noise, both = stated_noise(experiments), np.column_stack([rows, force])
    found = _fitted(noise.whitened(both))
    for _ in range(_ROUNDS):
        before = found.values
        wind = wind_columns(experiments, equations.slopes @ before)
        scale = noise_scale(experiments, noise, residual=force - rows @ before, wind=wind, rows=rows)
        errors = force_errors(noise, scale=scale, wind=wind)
        found = _fitted(errors.whitened(both))
        if np.all(np.abs(found.values - before) <= _SETTLED * found.std):
            break
    return Solution(found.values, found.covariance, errors, scale)


def _estimated(equations: Design, gain: Array) -> Solution:
    """Return the estimate that is a gain (q, 3n) times the forces.

    The errors are those of the best solution: the misfit of a worse estimate is not noise.
    """
    best = solve(equations)
    return best._replace(values=gain @ equations.force_n, covariance=best.errors.covariance_of(gain))


def _condition(equations: Design) -> float:
    """Return the condition number of the regressors scaled to equal length; refuse dependent ones."""
    rows, experiments, model = equations.rows, equations.experiments, equations.model
    if not np.any(experiments.force_n):
        raise FitError("all forces are zero, there is nothing to fit: check the windows of the recordings.")
    length = np.linalg.norm(rows, axis=0)
    singular = np.linalg.svd(rows / np.where(length > 0, length, 1.0), compute_uv=False)
    rank, unknowns = int(np.count_nonzero(singular > _DEPENDENT * singular[0])), rows.shape[1]
    if rank < unknowns:
        more = " with intercepts or a parasitic term" if unknowns > model.unknowns else ""
        raise FitError(
            f"{len(rows) // 3} experiments in {experiments.settings} wind settings determine {rank} of {unknowns} "
            f"unknowns of the {model.name} model{more}: record more wind settings and commands, or leave out what is "
            "constant throughout a wind setting."
        )
    return float(singular[0] / singular[-1])


def _fitted(white: Array) -> Estimate:
    """Fit whitened rows to their right side, both in one array (m, q + 1)."""
    return fit_linear(white[:, :-1], white[:, -1], noise_known=True)
