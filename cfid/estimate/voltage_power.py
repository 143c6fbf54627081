"""Estimate the power of the battery's voltage that steady speeds are proportional to, from one recording's speeds.

Some controllers chop the voltage, so that speeds are proportional to it, and others hold the speed of a command. A
curved map of the command looks like a voltage that falls with the speed. Smooth maps are therefore weighted by their
evidence, the likelihood under their priors: where speeds do not separate the two, the result is uncertain over the
whole range from 0 to 1.
"""

from itertools import product

import numpy as np
import numpy.typing as npt
from numpy.polynomial import legendre

Array = npt.NDArray[np.float64]

_POWERS = np.linspace(0.0, 1.0, 101)
_PRIOR = np.diff(np.arcsin(np.sqrt(np.linspace(0.0, 1.0, len(_POWERS) + 1))))  # most controllers are near either end
_DEGREE = 5  # of the maps, as Legendre polynomials
_BENDS = (0.001, 0.01, 0.1)  # of the largest speed: the deviations of maps from a line
_HIGHER = (0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)  # and from a parabola, half as much with each further degree
_ERRORS = (0.0003, 0.001, 0.003, 0.01)  # of each speed in addition to its noise: what no smooth map explains


def voltage_power(*, command: Array, volts: Array, speed: Array, std: Array) -> tuple[float, float]:
    """Return the power, 0 to 1, of the voltage that a command's speed is proportional to, and its standard uncertainty.

    The speeds (n,) are steady and above 0, with their standard uncertainties (n,), at commands (n,) and volts (n,).
    """
    shown = speed / speed.max()
    terms = legendre.legvander(2 * command / command.max() - 1, _DEGREE)
    rows = (volts / volts.mean())[:, np.newaxis] ** _POWERS[:, np.newaxis, np.newaxis] * terms
    evidence = []
    for bend, higher, error in product(_BENDS, _HIGHER, _ERRORS):
        prior = np.array([1.0, 1.0, bend, *(higher * 0.5 ** np.arange(_DEGREE - 2))])
        evidence.append(_evidence(rows * prior, shown, np.hypot(std / speed.max(), error * shown)))
    weight = _PRIOR * np.exp(np.array(evidence) - np.max(evidence)).sum(axis=0)
    weight /= weight.sum()
    mean = float(weight @ _POWERS)
    return mean, float(np.sqrt(weight @ (_POWERS - mean) ** 2 + _POWERS[1] ** 2 / 12))


def _evidence(rows: Array, value: Array, noise: Array) -> Array:
    """Return the log-likelihoods (m,) of values (n,) with noise (n,), for rows (m, n, p) whose factors have std 1."""
    white, data = rows / noise[:, np.newaxis], value / noise
    turned = white.swapaxes(1, 2)
    normal = np.eye(rows.shape[2]) + turned @ white
    factors = np.linalg.solve(normal, (turned @ data)[..., np.newaxis])
    left = data - (white @ factors)[..., 0]
    cost = np.sum(left**2, axis=1) + np.sum(factors**2, axis=(1, 2))
    return np.asarray(-0.5 * (cost + np.linalg.slogdet(normal)[1]) - np.log(noise).sum())
