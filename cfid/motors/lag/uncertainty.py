"""Slow drifts and correlated noise that a log shows in addition to its lag, and how uncertain they make the lag."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult

from cfid.estimate.linear import gain_of, sandwich
from cfid.motors.lag.model import LogSegment

Array = npt.NDArray[np.float64]

_SURE_STD = 2.0  # combined uncertainties of both fits: up to there, noise explains a change
_HELD = 1e-3  # of its uncertainty: how far a parameter that is not fitted may move
_MOST_CORRELATED = 0.99  # with the sample before: nearer to 1, levels are lost


class Expected(NamedTuple):
    """The expected values of a fit's last parameters (m,), with their uncertainties; `fitted` where a log shows them.

    Where they are not `fitted`, they are held to the expected values.
    """

    value: Array
    std: Array
    fitted: bool

    @property
    def scale(self) -> Array:
        """How far (m,) the parameters may move."""
        return self.std if self.fitted else _HELD * self.std

    def residual(self, found: Array, *, noise: float) -> Array:
        """Return the residuals (m,) that join those of a log whose samples have this noise."""
        return np.asarray(noise * (found[len(found) - len(self.value) :] - self.value) / self.scale)

    def effects(self, fit: OptimizeResult) -> Array:
        """Return how far (p, m) each parameter of a fit moves where one is off its expected value by its std."""
        first = len(fit.fun) - len(self.value)
        weights = np.diag(fit.jac[first:, fit.jac.shape[1] - len(self.value) :])
        return np.asarray(gain_of(fit.jac)[:, first:] * (weights * self.std))


def covariances(
    fit: OptimizeResult, other: OptimizeResult, expected: Expected, *, drifted: bool, longest: int
) -> tuple[Array, Array]:
    """Return the parameters' covariance (p, p), and how far (p, m) they move with deviations from what is expected.

    The covariance contains the latter, and the change from the other fit, which allows a drift where this fit does not,
    or neither whitens nor allows one. The change counts where neither noise nor a drift explains it: the model then
    misses something that the two fits weigh differently.
    """
    effects = expected.effects(fit)
    found = _of(fit, expected, longest=longest)
    if drifted:
        return found, effects
    change, its = fit.x - other.x, _of(other, expected, longest=longest)
    unexplained = np.abs(change[3:6]) > _SURE_STD * np.sqrt(np.diag(found)[3:6] + np.diag(its)[3:6])
    return (found + np.outer(change, change) if unexplained.any() else found), effects


def _of(fit: OptimizeResult, expected: Expected, *, longest: int) -> Array:
    effects = expected.effects(fit)
    measured = np.append(fit.fun[: len(fit.fun) - len(expected.value)], np.zeros(len(expected.value)))
    return sandwich(fit.jac, measured, longest=longest) + effects @ effects.T


def drifts_of(pieces: Sequence[LogSegment], shown: Array) -> Array:
    """Return what changes slowly (n, 3): level, its rate, and slope, as with a battery or a motor that warms up."""
    time_s = np.concatenate([piece.measured.time_s for piece in pieces])
    late = time_s - np.mean(time_s)
    return np.column_stack([late, late**2 - np.mean(late**2), late * (shown - np.mean(shown))])


def beside(residual: Array, columns: Array) -> Array:
    """Return residuals (n,) without the part that columns (n, m) explain."""
    basis, _ = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    return np.asarray(residual - basis @ (basis.T @ residual))


def correlation_of(residual: Array, lengths: Sequence[int]) -> float:
    """Return the correlation of residuals (n,) of segments with the residual before, 0 at least."""
    parts = np.split(residual, np.cumsum(lengths)[:-1])
    both = sum(float(part[1:] @ part[:-1]) for part in parts)
    return float(np.clip(both / max(float(residual @ residual), 1e-300), 0.0, _MOST_CORRELATED))


def whitened(residual: Array, *, lengths: Sequence[int], correlation: float) -> Array:
    """Return residuals (n,) of segments without what each shares with the one before, all of the same variance."""
    left = residual.copy()
    left[1:] -= correlation * residual[:-1]
    first = np.cumsum([0, *lengths[:-1]])
    left[first] = math.sqrt(1 - correlation**2) * residual[first]
    return left
