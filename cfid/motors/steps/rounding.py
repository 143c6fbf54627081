"""The effect of rounding on a rotor's speeds: those that a controller counts come in increments.

All speeds of a rotor that has settled are rounded alike, which no scatter shows, while each of the few speeds on the
way there has its own error.
"""

import numpy as np
import numpy.typing as npt

from cfid.estimate.signals import block_means

Array = npt.NDArray[np.float64]

_ALIKE = 0.7  # of the largest of some values: values above that are rounded alike; speeds from counted times come in
# steps that grow with their square
_SAME = 1e-9  # of the largest: what conversions may change
_NOISES = np.linspace(0, 1, 201)  # relative to a step: with more noise, errors of rounding are noise as well
_WAVES = np.arange(1, 100)[:, np.newaxis]
# Over the value, the error of rounding is a sawtooth; noise dampens its waves, the shorter ones more. For each noise,
# these are the variance of the error that rounded values of one speed share, and that of their scatter, relative to the
# step.
_SHARED = np.sum(np.exp(-((2 * np.pi * _WAVES * _NOISES) ** 2)) / (2 * (np.pi * _WAVES) ** 2), axis=0)
_SCATTER = _NOISES**2 + _SHARED[0] - _SHARED


def rounding_step(value: Array, *, sizes: Array) -> float:
    """Return the step to which values (n,) are rounded: the smallest difference between values as large in a record.

    `sizes` (m,) has the record's values without signs, in ascending order. The step is almost 0 where they are not
    rounded.
    """
    largest = float(np.abs(value).max())
    gaps = np.diff(sizes[np.searchsorted(sizes, _ALIKE * largest) :])
    return float(min(gaps[gaps > _SAME * largest], default=0.0))


def rounding_covariance(shown: Array, *, step: float, scatter: float, length: int) -> Array:
    """Return the covariance (m, m) that rounding to a step gives the means of `length` neighbours of values (n,).

    Values less than a step apart are rounded alike, the more so the nearer they are. `scatter`, the standard deviation
    of a fit's residuals, shows how much noise there was before the rounding; noise makes the error differ from value to
    value.
    """
    if step == 0:
        return np.zeros((len(shown) // length,) * 2)
    places = block_means(shown / step, length=length)
    passed = np.ptp((shown / step)[: len(places) * length].reshape(-1, length), axis=1)
    share = 1 / np.sqrt(np.clip(passed, 1, length))  # of a mean over several steps, with a new error in each
    near = np.maximum(1 - np.abs(np.subtract.outer(places, places)), 0.0)
    shared = float(np.interp((scatter / step) ** 2, _SCATTER, _SHARED))
    own = (1 / 12 - shared) / length
    return np.asarray(step**2 * (shared * near * np.outer(share, share) + own * np.eye(len(places))))
