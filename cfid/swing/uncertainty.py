"""Weigh what a swing cannot separate by priors, and estimate W's uncertainty: noise, nuisances, scatter of windows.

A cable that pulls as a spring and a disc that stretches the angle change the period's dependence on the angle alike.
How large either is on a rig is unknown, even in its order of magnitude: every size up to that of the worst rig counts,
by how likely the record is with it.
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc, erfcx, log_ndtr

from cfid.estimate.linear import gain_of
from cfid.estimate.signals import correlation_inflation
from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import OutputError, motion_in_readings

Array = npt.NDArray[np.float64]

# Standard deviations on the worst rig that works: a cable's stiffness over gravity's, of which twice is too much, and
# either amplitude of an encoder's error within a turn, for which data sheets state limits of 0.3 to 1.4 degrees.
CABLE_STD, DISC_STD_RAD = 0.015, math.radians(0.6)
_SHARES = np.logspace(-3, 0, 13)  # of the worst rig's, that a rig may have
_RARER = math.log10(5)  # a rig that is ten times worse is five times rarer
# The likelihood's exponent is divided by this: it is linear about one fit, and second-order terms of a disc or a cable
# of 1 % otherwise decide between the two where the record does not.
_TEMPERED = 3.0
_FRICTION_STD = 0.3  # of Coulomb friction: how much dry friction varies at low speed and over the angle
_LEAST_FRICTION_RAD = math.radians(0.02)  # the zero's shift by the least dry friction, for bearings that show none
_PERIODS_A_WINDOW, _MOST_WINDOWS = 4, 8
# The probability that windows scatter at least as far by chance: below it, the model is wrong.
_SCATTERED = 0.05
SPRING, FIRST, SECOND = 5, 9, 10  # places of the cable and of the instrument's errors among a fit's values


@dataclass(frozen=True)
class Priors:
    """Standard deviations (11,) of a fit's values about zero on the worst rig, infinite where nothing is known.

    Those of the values at `of_rig` (r,) are multiplied by a rig's shares (r,).
    """

    worst_std: Array
    of_rig: tuple[int, ...]

    @classmethod
    def usual(cls, swing: FreeSwing, fit: OutputError) -> "Priors":
        """Return the priors of a cable and an encoder, or of a gyro, and of dry friction that varies."""
        frequency, coulomb = fit.coefficients.natural_frequency_squared_s2, fit.coefficients.coulomb_per_s2
        varies = _FRICTION_STD * max(coulomb, _LEAST_FRICTION_RAD * frequency)
        gyro = swing.rate_rad_per_s is not None
        of_instrument = (swing.rate_scale_std, math.inf) if gyro else (DISC_STD_RAD, DISC_STD_RAD)
        of_rig = () if gyro else (SPRING, FIRST)
        return cls(np.array([*[math.inf] * SPRING, CABLE_STD * frequency, *[varies] * 3, *of_instrument]), of_rig)

    def std(self, shares: Array) -> Array:
        """Return the standard deviations (..., 11) for rigs with given shares (..., r)."""
        std = np.tile(self.worst_std, (*shares.shape[:-1], 1))
        std[..., self.of_rig] *= shares
        return std


class Posterior(NamedTuple):
    """What a record and the priors give: changes of a fit's free values, then of its start (p,), and variances (p,).

    `least_variance` is W's on the best rig; `pull_std` is the cable's pull on the worst rig, in standard deviations,
    without the knowledge that a cable does not push.
    """

    change: Array
    variance: Array
    least_variance: float
    pull_std: float


def posterior(fit: OutputError, priors: Priors) -> Posterior:
    """Average over all rigs [HMRV]: the values on each count by how likely the record is with it."""
    size, noise = np.linalg.norm(fit.jacobian, axis=0), noise_variance(fit)
    rows = fit.jacobian / size
    shares = np.array(list(product(_SHARES, repeat=len(priors.of_rig))))
    std = np.append(priors.std(shares)[:, fit.free], np.full((len(shares), 2), math.inf), axis=1) * size
    values, weight = np.append(fit.values[fit.free], [0.0, 0.0]) * size, 1 / std**2
    covariance = np.linalg.inv(rows.T @ rows / noise + weight[:, None] * np.eye(len(size)))
    pulled = rows.T @ fit.residual_rad / noise - weight * values
    change, variance = np.einsum("rij,rj->ri", covariance, pulled), np.einsum("rii->ri", covariance).copy()
    score = np.sum(pulled * change - weight * values**2, axis=1) / _TEMPERED + np.linalg.slogdet(covariance)[1]
    score = score / 2 - (1 + _RARER) * np.log(shares).sum(axis=1)
    pull_std = 0.0
    if fit.free[SPRING]:  # a cable does not push: its stiffness has a normal distribution without its negative part
        spring = int(np.sum(fit.free[:SPRING]))
        spread = np.sqrt(variance[:, spring])
        mean = (values[spring] + change[:, spring]) / spread
        score += log_ndtr(mean)
        higher = math.sqrt(2 / math.pi) / erfcx(-mean / math.sqrt(2))
        moved = covariance[:, spring] / spread[:, None]
        change += higher[:, None] * moved
        variance -= np.minimum(higher * (higher + mean), 1)[:, None] * moved**2
        pull_std = float(mean[-1])
    likely = np.exp(score - score.max())
    likely /= likely.sum()
    together = likely @ change
    return Posterior(
        change=together / size,
        variance=likely @ (variance + (change - together) ** 2) / size**2,
        least_variance=float(variance[0, 0] / size[0] ** 2),
        pull_std=pull_std,
    )


def noise_variance(fit: OutputError) -> float:
    """Return the variance of white noise that would leave as much uncertain as the residual, which is correlated."""
    residual, free = fit.residual_rad, fit.jacobian.shape[1]
    variance = float(residual @ residual) / max(len(residual) - free, 1)
    return float(variance * correlation_inflation(residual, longest=_samples_a_period(fit)))


def _samples_a_period(fit: OutputError) -> int:
    span = (len(fit.trajectory.angle_rad) - 1) * fit.trajectory.step_s
    period = min(2 * math.pi / math.sqrt(max(fit.coefficients.natural_frequency_squared_s2, 1e-9)), span)
    return max(int(len(fit.residual_rad) * period / span), 8)


def drift_of_halves(fit: OutputError, time_s: Array) -> tuple[float, float]:
    """Return the relative change of W from the first half of the window to the second, and its std."""
    values, variances = _windows(fit, time_s, 2)
    frequency = fit.coefficients.natural_frequency_squared_s2
    return float((values[1] - values[0]) / frequency), float(math.sqrt(variances.sum()) / frequency)


def scatter_of_windows(fit: OutputError, time_s: Array, period_s: float) -> float:
    """Return the uncertainty of W by its scatter between windows beyond noise, 0 where noise explains it.

    Friction that the model lacks changes W with the amplitude. The variance between the windows is that of DerSimonian
    and Laird [DL].
    """
    count = min(int((time_s[-1] - time_s[0]) / period_s / _PERIODS_A_WINDOW), _MOST_WINDOWS)
    if count < 3:
        return 0.0
    values, variances = _windows(fit, time_s, count)
    weights = 1 / variances
    mean = weights @ values / weights.sum()
    scatter = float(weights @ (values - mean) ** 2)
    if chdtrc(count - 1, scatter) > _SCATTERED:
        return 0.0
    between = (scatter - (count - 1)) / float(weights.sum() - weights @ weights / weights.sum())
    return math.sqrt(max(between, 0.0))


def _windows(fit: OutputError, time_s: Array, count: int) -> tuple[Array, Array]:
    """Return how far W lies off in windows of equal length, each with a start of its own, and the variances."""
    read, slope = motion_in_readings(fit, time_s)
    edges = np.searchsorted(time_s, np.linspace(time_s[0], time_s[-1], count + 1)[1:-1])
    noise, values, variances = noise_variance(fit), [], []
    for part in np.split(np.arange(len(time_s)), edges):
        later = (time_s[part] - time_s[part].mean()) / (2 * fit.coefficients.natural_frequency_squared_s2)
        rows = np.stack([later * slope[part], slope[part], read[part], np.ones(len(part))], axis=1)
        gain = gain_of(rows)[0]
        values.append(gain @ fit.residual_rad[part])
        variances.append(noise * gain @ gain)
    return np.array(values), np.array(variances)
