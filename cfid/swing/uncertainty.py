"""Estimate a fitted swing's uncertainty: correlated residuals, the grid's step, drift, and scatter between windows."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from cfid.estimate.linear import gain_of, sandwich, sandwich_std, std_of
from cfid.estimate.signals import correlation_inflation
from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import ECCENTRICITY, PROBES, SPRING, TERMS, OutputError, first_guess, fit_output_error, probed

Array = npt.NDArray[np.float64]

_FINER_STEPS = (0.5, 0.7)
_PERIODS_A_WINDOW, _MOST_WINDOWS = 4, 8
# The probability that windows scatter at least as far by chance: below it, the model is wrong.
_SCATTERED = 0.05


def standard_uncertainties(fit: OutputError) -> Array:
    """Return the standard uncertainty of each Jacobian column's estimate, inflated by the residual's correlation."""
    return std_of(sandwich(fit.jacobian, fit.residual_rad, longest=_samples_a_period(fit)))


def inflation(series: Array, fit: OutputError) -> float:
    """Return the factor by which correlation over a period inflates the variance of a sum of the fit's series (n,)."""
    return correlation_inflation(series, longest=_samples_a_period(fit))


def step_error(swing: FreeSwing, fit: OutputError) -> float:
    """Return the effect of the grid's step on W where dry friction jumps: twice the largest change on two finer grids.

    Where a turning point falls between two nodes is a matter of chance, hence two grids. Without dry friction, the
    grid's error is of fourth order and far below every other error.
    """
    if fit.coefficients.coulomb_per_s2 == 0:
        return 0.0
    time, angle = swing.hands_off
    changes = [0.0]
    for share in _FINER_STEPS:
        step = share * fit.trajectory.step_s
        _, trajectory = first_guess(time, angle, start_s=fit.trajectory.start_s, step_s=step)
        finer = fit_output_error(
            time, swing.readings_rad, coefficients=fit.coefficients, trajectory=trajectory, terms=chosen_terms(fit),
            eccentricity=fit.eccentricity, setup=fit.setup,
        )  # fmt: skip
        if finer.converged:
            moved = spring_beside(swing, finer)[2] if fit.setup.spring_per_s2 else 0.0
            changes.append(abs(finer.coefficients[0] + moved - fit.coefficients[0]))
    return 2 * max(changes)


def drift_of_halves(swing: FreeSwing, fit: OutputError) -> tuple[float, float]:
    """Fit both halves of the window with the damping fixed, and compare their W."""
    values, variances = _windows(swing, fit, 2)
    frequency = fit.coefficients.natural_frequency_squared_s2
    return float((values[1] - values[0]) / frequency), float(math.sqrt(variances.sum()) / frequency)


def scatter_of_windows(swing: FreeSwing, fit: OutputError) -> float:
    """Return the scatter of W between windows beyond noise, 0 where noise explains it.

    Friction that the model lacks changes W with the amplitude, and averaging does not remove that. The variance between
    the windows is that of DerSimonian and Laird [DL].
    """
    time = swing.hands_off[0]
    periods = (time[-1] - time[0]) / swing.period_s
    count = min(int(periods / _PERIODS_A_WINDOW), _MOST_WINDOWS)
    if count < 3:
        return 0.0
    values, variances = _windows(swing, fit, count)
    weights = 1 / variances
    mean = weights @ values / weights.sum()
    scatter = float(weights @ (values - mean) ** 2)
    if chdtrc(count - 1, scatter) > _SCATTERED:
        return 0.0
    between = (scatter - (count - 1)) / float(weights.sum() - weights @ weights / weights.sum())
    return math.sqrt(max(between, 0.0))


class FrictionProbe(NamedTuple):
    """A variation of dry friction that the model lacks: its size per inertia, in the units of the model.

    `frequency_change` is the change of W for each 1/s^2 of it.
    """

    varies_with: str
    size_per_s2: float
    std_per_s2: float
    frequency_change: float

    @property
    def shown_std(self) -> float:
        """The size in standard uncertainties."""
        return abs(self.size_per_s2) / self.std_per_s2

    @property
    def moved_s2(self) -> float:
        """The change of W due to this variation."""
        return self.frequency_change * self.size_per_s2

    def expected(self, usual_per_s2: float) -> tuple[float, float]:
        """Return the change of W and its standard uncertainty, with `usual_per_s2` as the usual size of the variation.

        The expected size combines the record's and the usual one by their uncertainties. If the record shows a larger
        size than usual, that size is taken as the usual one.
        """
        variance = max(usual_per_s2**2, self.size_per_s2**2 - self.std_per_s2**2)
        weight = variance / (variance + self.std_per_s2**2)
        return weight * self.moved_s2, math.sqrt(weight) * abs(self.frequency_change) * self.std_per_s2


def friction_probes(swing: FreeSwing, fit: OutputError) -> tuple[FrictionProbe, ...]:
    """Estimate each of PROBES in addition to all coefficients, linearly about the fit."""
    own, probes, _ = probed(fit, swing.hands_off[0])
    found = []
    for name, probe in zip(PROBES, probes.T, strict=True):
        change, std = _beside(fit, own, probe)
        found.append(FrictionProbe(name, float(change[-1]), std, float(change[0] / change[-1])))
    return tuple(found)


def scale_error(swing: FreeSwing, fit: OutputError, taken: float) -> tuple[float, float]:
    """Return the relative error of a gyro's scale and its standard uncertainty, from the record and the usual error.

    `taken` is the correction already applied to the rates, and `rate_scale_std` is the usual error. The period of a
    pendulum depends on its amplitude, which changes with the scale: large swings show this, small ones do not.
    """
    change, std = _beside(fit, fit.jacobian, _without_bias(swing, fit))
    weight = swing.rate_scale_std**2 / (swing.rate_scale_std**2 + std**2)
    return float(weight * (taken + change[-1])), math.sqrt(weight) * std


def moved_by_scale(swing: FreeSwing, fit: OutputError) -> Array:
    """Return the change of each Jacobian column's estimate due to the standard uncertainty of a gyro's scale."""
    if swing.rate_rad_per_s is None:
        return np.zeros(fit.jacobian.shape[1])
    return _moved(fit, _without_bias(swing, fit), swing.rate_scale_std)


def spring_beside(swing: FreeSwing, fit: OutputError) -> tuple[float, float, float]:
    """Return the size per inertia of a spring in addition to a fit, its std, and the change of W with it.

    Gravity's pull grows with the sine of the angle, a spring's with the angle, so that large swings distinguish them.
    """
    change, std = _beside(fit, fit.jacobian, probed(fit, swing.hands_off[0])[2])
    return float(change[-1]), std, float(change[0])


def shows_despite_friction(swing: FreeSwing, fit: OutputError, *, least_std: float) -> bool:
    """Return whether a fit's spring exceeds `least_std` uncertainties also with each probe of dry friction added.

    Dry friction that is larger at low speed also shortens the period of small swings.
    """
    own, probes, spring = fit.jacobian, *probed(fit, swing.hands_off[0])[1:]
    for probe in probes.T:
        change, std = _beside(fit, np.column_stack([own, probe]), spring)
        if fit.setup.spring_per_s2 + change[-1] < least_std * std:
            return False
    return True


def moved_by_spring(swing: FreeSwing, fit: OutputError) -> Array:
    """Return the change of each Jacobian column's estimate due to the standard uncertainty of a fitted spring."""
    if not fit.setup.spring_per_s2:
        return np.zeros(fit.jacobian.shape[1])
    return _moved(fit, probed(fit, swing.hands_off[0])[2], spring_beside(swing, fit)[1])


def _moved(fit: OutputError, column: Array, std: float) -> Array:
    size = np.linalg.norm(fit.jacobian, axis=0)
    return np.asarray(np.abs(np.linalg.lstsq(fit.jacobian / size, column, rcond=1e-10)[0] / size) * std)


def _without_bias(swing: FreeSwing, fit: OutputError) -> Array:
    return np.asarray(swing.readings_rad - fit.residual_rad - fit.bias_rad)


def _beside(fit: OutputError, own: Array, probe: Array) -> tuple[Array, float]:
    """Return the changes of estimates (p,) and of a probe's size when the probe is fitted too, and that size's std."""
    jacobian = np.column_stack([own, probe])
    size = np.linalg.norm(jacobian, axis=0)
    gain = np.linalg.pinv(jacobian / size, rcond=1e-10) / size[:, np.newaxis]
    change = gain @ fit.residual_rad
    return change, sandwich_std(gain, fit.residual_rad - jacobian @ change, -1, longest=_samples_a_period(fit))


def _windows(swing: FreeSwing, fit: OutputError, count: int) -> tuple[Array, Array]:
    """Return W and its variance for windows of equal length, with damping and eccentricity fixed."""
    time, reading = swing.hands_off[0], swing.readings_rad
    edges = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1))
    edges[-1] = len(time)
    values, variances = [], []
    for first, last in pairwise(edges):
        part, step = slice(first, last), fit.trajectory.step_s
        # The motion of the whole fit is the best available start.
        nodes = fit.trajectory.start_s + step * np.arange(len(fit.trajectory.angle_rad))
        begin = max(int(np.searchsorted(nodes, time[first], side="right")) - 1, 0)
        end = min(int(np.searchsorted(nodes, time[last - 1])) + 1, len(nodes))
        own = fit.trajectory._replace(
            start_s=float(nodes[begin]),
            angle_rad=fit.trajectory.angle_rad[begin:end],
            speed_rad_per_s=fit.trajectory.speed_rad_per_s[begin:end],
        )
        one = fit_output_error(
            time[part], reading[part], coefficients=fit.coefficients, trajectory=own, terms=(),
            eccentricity=fit.eccentricity, setup=fit.setup,
        )  # fmt: skip
        values.append(one.coefficients.natural_frequency_squared_s2)
        gain = gain_of(one.jacobian)
        variances.append(sandwich_std(gain, one.residual_rad, 0, longest=_samples_a_period(one)) ** 2)
    return np.array(values), np.array(variances)


def chosen_terms(fit: OutputError) -> tuple[str, ...]:
    """Return the terms that were free in a fit."""
    damping = tuple(term for term, free in zip(TERMS, fit.free[1:4], strict=True) if free)
    return (*damping, *[ECCENTRICITY] * fit.eccentric, *[SPRING] * bool(fit.setup.spring_per_s2))


def _samples_a_period(fit: OutputError) -> int:
    frequency = fit.coefficients.natural_frequency_squared_s2
    span = (len(fit.trajectory.angle_rad) - 1) * fit.trajectory.step_s
    # A window of a record without a swing may oscillate about the upper position, or not at all.
    period = min(2 * math.pi / math.sqrt(frequency), span) if frequency > 0 else span
    return max(int(len(fit.residual_rad) * period / span), 8)
