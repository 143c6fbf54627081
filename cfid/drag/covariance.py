"""Describe the errors of drag forces, and those that forces share: noise, references, and the wind of a setting.

The covariance of all forces is V = tau^2 N + C C'. N is the noise of each force and of the reference subtracted from
it, which all forces at one command share; tau is the ratio of the observed to the stated scatter, one for x and y
together and one for z. A column of C is the effect of one standard uncertainty of a setting's wind speed on all forces
there: the true wind lies anywhere between its lowest and highest reading, so an experiment deviates from the prediction
for the middle (Berkson's errors in variables [Ber]), and least squares with this V stays unbiased.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from cfid.drag.experiments import DragExperiments
from cfid.errors import FitError

Array = npt.NDArray[np.float64]

_VERTICAL = np.array([False, False, True])
_LEAST_NOISE = 1e-6  # of the root mean square of the forces: less is rounding


@dataclass(frozen=True, kw_only=True)
class ForceErrors:
    """Errors of forces, experiment by experiment: independent standard uncertainties `own` (3n,) and `shared` columns.

    A column of `shared` (3n, k) is the effect of one standard uncertainty of an error that forces have in common.
    """

    own: Array
    shared: Array

    def whitened(self, values: Array) -> Array:
        """Return values (3n, ...) in coordinates whose errors are independent and have standard uncertainty 1."""
        white = (values.T / self.own).T
        direction, std, _ = np.linalg.svd((self.shared.T / self.own).T, full_matrices=False)
        return np.asarray(white + (direction * (1 / np.sqrt(1 + std**2) - 1)) @ (direction.T @ white))

    def covariance_of(self, gain: Array) -> Array:
        """Return the covariance (q, q) of an estimate that is gain (q, 3n) times the forces."""
        spread = np.hstack([gain * self.own, gain @ self.shared])
        return np.asarray(spread @ spread.T)


def stated_noise(experiments: DragExperiments) -> ForceErrors:
    """Return the errors in N: own noise, and one column per command and axis for the reference."""
    same = experiments.command[:, np.newaxis] == np.unique(experiments.command)
    reference = np.kron(same, np.eye(3)) * experiments.reference_std_n.reshape(-1, 1)
    return ForceErrors(own=experiments.force_std_n.reshape(-1), shared=reference)


def wind_columns(experiments: DragExperiments, sensitivity: Array) -> Array:
    """Return C (3n, settings), from changes of forces (3n,) per relative change of the wind speed."""
    moved = np.repeat(experiments.wind_relative_std, 3) * sensitivity
    same = np.repeat(experiments.setting, 3)[:, np.newaxis] == np.arange(experiments.settings)
    return np.asarray(moved[:, np.newaxis] * same)


def force_errors(noise: ForceErrors, *, scale: tuple[float, float], wind: Array) -> ForceErrors:
    """Return the errors with covariance V: stated noise, scaled by tau in x and y and in z, and C."""
    each = np.tile(np.repeat(scale, [2, 1]), len(wind) // 3)
    return ForceErrors(own=noise.own * each, shared=np.hstack([(noise.shared.T * each).T, wind]))


def noise_scale(
    experiments: DragExperiments, noise: ForceErrors, *, residual: Array, wind: Array, rows: Array
) -> tuple[float, float]:
    """Return tau in x and y, and in z, from residuals (3n,) of a fit of rows (3n, q); `wind` is C.

    Stated noise may be too small, never too large. Raises FitError when the noise is unknown and no residual is left to
    estimate it from.
    """
    white, shared = noise.whitened(residual), noise.whitened(wind)
    vertical = np.tile(_VERTICAL, len(residual) // 3)
    least, known = _least_scale(experiments), experiments.noise_known
    lateral_scale, vertical_scale = (
        _scale(white[axes], shared[axes], unknowns=int(rows[axes].any(axis=0).sum()), least=least, known=known)
        for axes in (~vertical, vertical)
    )
    return lateral_scale, vertical_scale


def _least_scale(experiments: DragExperiments) -> float:
    if experiments.noise_known:
        return 1.0
    force, std = (float(np.sqrt(np.mean(values**2))) for values in (experiments.force_n, experiments.force_std_n))
    return _LEAST_NOISE * force / std


def _scale(residual: Array, shared: Array, *, unknowns: int, least: float, known: bool) -> float:
    """Return the tau for which residuals (m,) have the expected chi-squared [MP].

    Residuals and shared columns (m, k) are in units of the stated noise.
    """
    degrees_of_freedom = len(residual) - unknowns
    if degrees_of_freedom < 1 and not known:
        raise FitError(
            f"{len(residual)} forces and {unknowns} unknowns leave no degree of freedom to estimate the noise from: "
            "record more."
        )
    direction, std, _ = np.linalg.svd(shared, full_matrices=False)
    along = (direction.T @ residual) ** 2
    across = max(float(residual @ residual - along.sum()), 0.0)

    def excess(log_variance: float) -> float:
        variance = math.exp(log_variance)
        return float(across / variance + np.sum(along / (variance + std**2))) - degrees_of_freedom

    most = 2 * float(residual @ residual) / max(degrees_of_freedom, 1)
    if degrees_of_freedom < 1 or most <= least**2 or excess(math.log(least**2)) <= 0:
        return least
    return math.exp(brentq(excess, math.log(least**2), math.log(most), xtol=1e-6) / 2)
