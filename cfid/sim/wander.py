"""Simulates quantities that wander: stationary noise with a correlation time, as a function of time."""

import math

import numpy as np
import numpy.typing as npt

from cfid.sim.stepping import Array

_WAVES = 32
_FASTEST = 30.0  # in 1/correlation time: 2 % of the power would be faster


class Wander:
    """k independent quantities of standard deviation `std` (k,) and autocorrelation exp(-|t| / correlation_s).

    Each is a sum of cosines whose frequencies are drawn from the spectrum of that autocorrelation.
    """

    def __init__(self, std: npt.ArrayLike, *, correlation_s: float, rng: np.random.Generator) -> None:
        """Draw the waves."""
        self._size = np.atleast_1d(np.asarray(std, np.float64)) * math.sqrt(2 / _WAVES)
        waves = (_WAVES, len(self._size))
        self._rate = np.clip(np.abs(rng.standard_cauchy(waves)), 1e-3, _FASTEST) / correlation_s
        self._phase = rng.uniform(0, 2 * math.pi, waves)

    def at(self, time_s: npt.ArrayLike) -> Array:
        """Return the values (n, k) at times (n,)."""
        return np.asarray(self._size * np.cos(self._angle(time_s)).sum(axis=1))

    def integral(self, time_s: npt.ArrayLike) -> Array:
        """Return an antiderivative (n, k) of the values at times (n,)."""
        return np.asarray(self._size * (np.sin(self._angle(time_s)) / self._rate).sum(axis=1))

    def _angle(self, time_s: npt.ArrayLike) -> Array:
        """Return the phase (n, waves, k) of each wave."""
        times_s = np.atleast_1d(np.asarray(time_s, np.float64))
        return np.asarray(times_s[:, np.newaxis, np.newaxis] * self._rate + self._phase)
