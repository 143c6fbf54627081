"""What drag forces are uncertain by, and how that is shared: noise, references, and the wind of a setting.

The covariance of all forces is tau^2 N + C C'. N is the noise of each force and of the reference subtracted from
it, which all forces at one command share; tau says how many times as far as stated they scatter, for x and y
together and for z. A column of C is what one deviation of a setting's wind speed does to all forces there: truth
lies anywhere between the wind's lowest and highest reading, so an experiment deviates from what the middle
predicts (Berkson's errors in variables [Ber]), and least squares stays unbiased where it is told so.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from cfid.drag.experiments import DragExperiments
from cfid.drag.model import DragModel
from cfid.errors import FitError

Array = npt.NDArray[np.float64]

_VERTICAL = np.array([False, False, True])
_STEP = 1e-3  # of a wind speed; models are no more than square in it, so that central differences are exact
_LEAST_NOISE = 1e-6  # of the root mean square of the forces: what is smaller is rounding


class Shared(NamedTuple):
    """Orthonormal directions (m, k) of what is shared, and one deviation (k,) along each, beside noise of 1."""

    direction: Array
    std: Array

    @classmethod
    def spanned_by(cls, columns: Array) -> "Shared":
        """Return what columns (m, k) span."""
        direction, std, _ = np.linalg.svd(columns, full_matrices=False)
        return cls(direction, std)

    def standardised(self, values: Array) -> Array:
        """Return values (m, ...) so that noise and shared errors together have deviation 1 and are independent."""
        shrunk = self.direction * (1 / np.sqrt(1 + self.std**2) - 1)
        return np.asarray(values + shrunk @ (self.direction.T @ values))


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The stated noise of forces, flattened (3n,): own deviations, what references share, the least scale believed.

    Where it is not `known`, both are weights, and the scale comes from the residuals alone.
    """

    own: Array
    reference: Array  # (3n, k)
    known: bool
    least: float

    def standardised(self, values: Array) -> Array:
        """Return values (3n, ...) in units of the stated noise, references included."""
        columns = self.reference / self.own[:, np.newaxis]  # no two have a force in common
        std = np.linalg.norm(columns, axis=0)
        return Shared(columns / std, std).standardised((values.T / self.own).T)


@dataclass(frozen=True, kw_only=True)
class Errors:
    """All that forces are uncertain by: noise, its scale in x and y and in z, and the wind beside it (3n, k)."""

    noise: Noise
    scale: tuple[float, float]
    wind: Array
    beside_noise: Shared

    @property
    def columns(self) -> Array:
        """Independent errors of one deviation each, (3n, m): the covariance is the product with its transpose."""
        noise = np.concatenate([np.diag(self.noise.own), self.noise.reference], axis=1)
        return np.concatenate([(noise.T * _each(self.scale, len(noise))).T, self.wind], axis=1)

    def standardised(self, values: Array) -> Array:
        """Return values (3n, ...) so that their errors are independent and have deviation 1."""
        white = self.noise.standardised(values)
        return self.beside_noise.standardised((white.T / _each(self.scale, len(white))).T)


def noise_of(experiments: DragExperiments) -> Noise:
    """Return the noise of the experiments' forces; stated deviations may be too small, never too large."""
    same = experiments.command[:, np.newaxis] == np.unique(experiments.command)
    rms = float(np.sqrt(np.mean(experiments.force_n**2)))
    rounding = _LEAST_NOISE * rms / float(np.sqrt(np.mean(experiments.force_std_n**2)))
    return Noise(
        own=experiments.force_std_n.reshape(-1),
        reference=np.kron(same, np.eye(3)) * experiments.reference_std_n.reshape(-1, 1),
        known=experiments.noise_known,
        least=1.0 if experiments.noise_known else rounding,
    )


def wind_columns(experiments: DragExperiments, model: DragModel, coefficients: Array) -> Array:
    """Return by how much one deviation of each setting's wind speed moves the forces, (3n, settings)."""
    higher, lower = (
        model.force_n(
            coefficients,
            velocity_mps=(1 + step) * experiments.velocity_mps,
            speed_sum_rad_s=experiments.speed_sum_rad_s,
        )
        for step in (_STEP, -_STEP)
    )
    moved = experiments.wind_relative_std[:, np.newaxis] * (higher - lower) / (2 * _STEP)
    belongs = experiments.setting[:, np.newaxis] == np.arange(experiments.settings)
    return np.asarray((moved[:, :, np.newaxis] * belongs[:, np.newaxis]).reshape(moved.size, -1))


def errors_of(noise: Noise, residual: Array, wind: Array, rows: Array) -> Errors:
    """Return the errors of forces with residuals (3n,), columns of the wind (3n, k), fitted by rows (3n, q).

    Raises FitError when nobody stated the noise, and no residual is left to tell it by.
    """
    left, share, taken = (noise.standardised(values) for values in (residual, wind, rows))
    vertical = np.tile(_VERTICAL, len(left) // 3)
    lateral_scale, vertical_scale = (
        _noise_scale(left[axes], share[axes], unknowns=int(np.any(taken[axes], axis=0).sum()), noise=noise)
        for axes in (~vertical, vertical)
    )
    scale = lateral_scale, vertical_scale
    beside_noise = Shared.spanned_by((share.T / _each(scale, len(share))).T)
    return Errors(noise=noise, scale=scale, wind=wind, beside_noise=beside_noise)


def _noise_scale(residual: Array, columns: Array, *, unknowns: int, noise: Noise) -> float:
    """Return tau with which residuals (m,) have the chi-squared that they should [MP].

    Residuals and shared columns (m, k) are in units of the stated noise; so many unknowns were fitted to them.
    """
    freedom, least = len(residual) - unknowns, noise.least
    if freedom < 1 and not noise.known:
        raise FitError(
            f"{len(residual)} forces leave none over beside {unknowns} unknowns to tell their noise by: record more."
        )
    shared = Shared.spanned_by(columns)
    along = (shared.direction.T @ residual) ** 2
    beside = max(float(residual @ residual - along.sum()), 0.0)

    def excess(log_variance: float) -> float:
        variance = math.exp(log_variance)
        return float(beside / variance + np.sum(along / (variance + shared.std**2))) - freedom

    most = 2 * float(residual @ residual) / max(freedom, 1)
    if freedom < 1 or most <= least**2 or excess(math.log(least**2)) <= 0:
        return least
    return math.exp(brentq(excess, math.log(least**2), math.log(most), xtol=1e-6) / 2)


def _each(scale: tuple[float, float], forces: int) -> Array:
    """Return the scale of each force (3n,)."""
    return np.tile(np.repeat(scale, [2, 1]), forces // 3)
