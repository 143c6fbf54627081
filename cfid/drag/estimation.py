"""One model of drag fitted to experiments: plain least squares as the thesis, or weighted by all that is uncertain."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.drag.covariance import Errors, errors_of, noise_of, wind_columns
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import DragModel, lateral_and_vertical
from cfid.errors import FitError

Array = npt.NDArray[np.float64]

BELIEVED_UNEXPLAINED = 0.5  # sum of squared errors over sum of squared forces

_DRIVEN = 0.2  # cosine between all forces and all velocities
_ACROSS = 0.5  # the same across velocities: 30 degrees, where there is no noise
_DEPENDENT = 1e-9  # smallest over largest singular value of columns that no longer differ
_ROUNDS, _SETTLED = 20, 1e-7


@dataclass(frozen=True, kw_only=True)
class DragFit:
    """A fitted model: coefficients (p,) with covariance (p, p), SI units, and what is left (n, 3).

    `parasitic_kg_per_m` (3,) is k in k |v| v, drag of the body beside the rotors', `intercepts_n` (settings, 3) a
    force that stays the same within a wind setting, tare drift, each with its deviation; None where not asked
    for. `noise_scale` (2,) is how many times as far as stated the forces scatter in x and y, and in z (where no
    noise was stated: in newtons). `condition` is that of the rows with columns of equal length. `doubts` say why the
    forces are no drag, or none of this model.
    """

    model: DragModel
    coefficients: Array
    covariance: Array
    parasitic_kg_per_m: Array | None
    parasitic_std_kg_per_m: Array | None
    intercepts_n: Array | None
    intercepts_std_n: Array | None
    residual_n: Array
    noise_scale: tuple[float, float]
    freedom: int
    condition: float
    doubts: tuple[str, ...]

    @property
    def value(self) -> Array:
        """The coefficients as the thesis prints them, by the model's layout."""
        return np.asarray(self.coefficients[self.model.layout])

    @property
    def std(self) -> Array:
        """One standard deviation of each of `value`."""
        return np.asarray(np.sqrt(np.diag(self.covariance))[self.model.layout])

    @property
    def value_covariance(self) -> Array:
        """The covariance (m, m) of the m numbers of `value`, row by row."""
        places = self.model.layout.ravel()
        return np.asarray(self.covariance[np.ix_(places, places)])

    @property
    def sse_n2(self) -> float:
        """Sum of the squared errors over all experiments and axes, as C.3.1 defines it."""
        return float(np.sum(self.residual_n**2))


class Solution(NamedTuple):
    """Solution (q,) of linear equations with its covariance (q, q), and the errors that it came of."""

    values: Array
    covariance: Array
    errors: Errors


def fit_drag(
    experiments: DragExperiments,
    model: DragModel,
    *,
    weighted: bool = True,
    intercepts: bool = False,
    parasitic: bool = False,
) -> DragFit:
    """Fit a model to experiments by generalised least squares; `weighted=False` takes all forces alike (C.3.1).

    Deviations are those of noise, references and wind in both cases.

    Raises FitError when the experiments cannot tell the unknowns apart: an intercept is the same throughout a
    setting, and so are v, v^2 and 1 of the complex model.
    """
    rows = _rows(experiments, model, intercepts=intercepts, parasitic=parasitic)
    condition = _check(rows, experiments, model)
    found = solve(experiments, model, rows) if weighted else _solve_plain(experiments, model, rows)
    std = np.sqrt(np.diag(found.covariance))
    p, body = model.unknowns, slice(model.unknowns, model.unknowns + 2 * parasitic)
    lateral_vertical, settings = np.array([0, 0, 1]), slice(body.stop, None)
    residual = experiments.force_n - (rows @ found.values).reshape(-1, 3)
    return DragFit(
        model=model,
        coefficients=found.values[:p],
        covariance=found.covariance[:p, :p],
        parasitic_kg_per_m=found.values[body][lateral_vertical] if parasitic else None,
        parasitic_std_kg_per_m=std[body][lateral_vertical] if parasitic else None,
        intercepts_n=found.values[settings].reshape(-1, 3) if intercepts else None,
        intercepts_std_n=std[settings].reshape(-1, 3) if intercepts else None,
        residual_n=residual,
        noise_scale=found.errors.scale,
        freedom=rows.shape[0] - rows.shape[1],
        condition=condition,
        doubts=(*_driving(experiments), *_turned(experiments), *_unexplained(experiments.force_n, residual)),
    )


def solve(experiments: DragExperiments, model: DragModel, rows: Array) -> Solution:
    """Solve rows (3n, q) for the forces; the first coefficients are the model's.

    What the wind's error does depends on the coefficients, so they are found in a few rounds.
    """
    noise, force = noise_of(experiments), experiments.force_n.reshape(-1)
    values, covariance = _least_squares(noise.standardised(rows), noise.standardised(force))
    for _ in range(_ROUNDS):
        before = values
        wind = wind_columns(experiments, model, values[: model.unknowns])
        errors = errors_of(noise, force - rows @ values, wind, rows)
        values, covariance = _least_squares(errors.standardised(rows), errors.standardised(force))
        if np.all(np.abs(values - before) <= _SETTLED * np.sqrt(np.diag(covariance))):
            break
    return Solution(values, covariance, errors)


def gained(experiments: DragExperiments, model: DragModel, rows: Array, gain: Array) -> Solution:
    """Return what a gain (q, 3n) makes of the forces, as another solution of rows (3n, q), with its deviations.

    The errors are those that the best solution leaves: a worse one's own error is no noise.
    """
    errors = solve(experiments, model, rows).errors
    spread = gain @ errors.columns
    return Solution(gain @ experiments.force_n.reshape(-1), spread @ spread.T, errors)


def _solve_plain(experiments: DragExperiments, model: DragModel, rows: Array) -> Solution:
    length = np.linalg.norm(rows, axis=0)
    return gained(experiments, model, rows, np.linalg.pinv(rows / length) / length[:, np.newaxis])


def flat_rows(experiments: DragExperiments, model: DragModel) -> Array:
    """Return the model's rows (3n, p), experiment by experiment."""
    return model.rows(experiments.velocity_mps, experiments.speed_sum_rad_s).reshape(-1, model.unknowns)


def _rows(experiments: DragExperiments, model: DragModel, *, intercepts: bool, parasitic: bool) -> Array:
    parts = [flat_rows(experiments, model)]
    if parasitic:
        body = lateral_and_vertical(experiments.wind_mps[:, np.newaxis] * experiments.velocity_mps)
        parts.append(body.reshape(-1, 2))
    if intercepts:
        belongs = experiments.setting[:, np.newaxis] == np.arange(experiments.settings)
        parts.append(np.kron(belongs, np.eye(3)))
    return np.concatenate(parts, axis=1)


def _check(rows: Array, experiments: DragExperiments, model: DragModel) -> float:
    """Return the condition number of rows (3n, q) with columns of equal length; refuse what cannot be told."""
    if not np.any(experiments.force_n):
        raise FitError("all forces are zero: there is nothing to fit. Look at the recordings' windows.")
    length = np.linalg.norm(rows, axis=0)
    singular = np.linalg.svd(rows / np.where(length > 0, length, 1.0), compute_uv=False)
    rank, unknowns = int(np.count_nonzero(singular > _DEPENDENT * singular[0])), rows.shape[1]
    if rank < unknowns:
        more = " beside intercepts or a parasitic term" if unknowns > model.unknowns else ""
        raise FitError(
            f"{len(rows) // 3} experiments in {experiments.settings} winds tell {rank} of {unknowns} unknowns of the "
            f"{model.name} model apart{more}: record more winds and commands, or leave out what is the same "
            "throughout a wind."
        )
    return float(singular[0] / singular[-1])


def _driving(experiments: DragExperiments) -> list[str]:
    doubts = []
    for axes, part in (("x and y", slice(0, 2)), ("z", slice(2, 3))):
        force, velocity = experiments.force_n[:, part], experiments.velocity_mps[:, part]
        if np.sum(force * velocity) > _DRIVEN * np.linalg.norm(force) * np.linalg.norm(velocity):
            doubts.append(
                f"along {axes} the forces go with the vehicle's motion relative to the air, which would drive it: look "
                "at yaw, azimuth, angle and the signs of force and velocity."
            )
    return doubts


def _turned(experiments: DragExperiments) -> list[str]:
    """Return a doubt where forces in x and y stand across the wind, as after a wrong yaw."""
    force, against = experiments.force_n[:, :2], -experiments.velocity_mps[:, :2]
    along = float(np.sum(force * against))
    leftward = float(np.sum(against[:, 0] * force[:, 1] - against[:, 1] * force[:, 0]))
    if abs(leftward) <= _ACROSS * np.linalg.norm(force) * np.linalg.norm(against):
        return []
    degrees = math.degrees(math.atan2(leftward, along))
    return [
        f"in x and y the forces point {abs(degrees):.0f} degrees {'left' if degrees > 0 else 'right'} of the wind that "
        "should make them: look at yaw and azimuth."
    ]


def _unexplained(force: Array, residual: Array) -> list[str]:
    part = float(np.sum(residual**2) / np.sum(force**2))
    if part <= BELIEVED_UNEXPLAINED:
        return []
    return [
        f"the model leaves {100 * part:.0f} % of the forces' sum of squares unexplained (believed up to "
        f"{100 * BELIEVED_UNEXPLAINED:.0f} %)."
    ]


def _least_squares(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Return solution and covariance, the errors on the right having deviation 1, by a QR of equal columns."""
    length = np.linalg.norm(matrix, axis=0)
    q, r = np.linalg.qr(matrix / length)
    inverse = np.linalg.inv(r) / length[:, np.newaxis]
    return inverse @ (q.T @ right), inverse @ inverse.T
