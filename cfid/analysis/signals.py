"""Sampled signals, whatever they mean: half-swings, steady stretches, correlated noise."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


class HalfSwing(NamedTuple):
    """Samples first..last (inclusive) on one side of rest; `extreme` is the farthest of them."""

    first: int
    last: int
    extreme: int
    side: int


def half_swings(angle_rad: Array, *, threshold_rad: float) -> list[HalfSwing]:
    """Cut a record (n,) that swings about zero into half-swings that leave +- threshold.

    A side counts once the angle is beyond the threshold there, so that noise about zero makes no swings.
    """
    side = np.where(angle_rad > threshold_rad, 1, np.where(angle_rad < -threshold_rad, -1, 0))
    beyond = np.flatnonzero(side)
    if len(beyond) == 0:
        return []
    changes = np.flatnonzero(np.diff(side[beyond])) + 1
    halves = []
    for stretch in np.split(beyond, changes):
        first, last = int(stretch[0]), int(stretch[-1])
        extreme = first + int(np.argmax(np.abs(angle_rad[first : last + 1])))
        halves.append(HalfSwing(first, last, extreme, int(side[first])))
    return halves


def vertex(time_s: Array, value: Array) -> tuple[float, float]:
    """Return time and value of the extreme of a parabola through samples (n,) around a peak."""
    middle = float(time_s.mean())
    span = float(np.ptp(time_s)) or 1.0
    place = (time_s - middle) / span
    # Least squares of least norm: where stamps repeat so often that no parabola is determined, a flat one serves.
    curve, slope, level = np.linalg.lstsq(np.vander(place, 3), value, rcond=1e-9)[0]
    if curve == 0:
        return middle, float(level)
    at = float(np.clip(-slope / (2 * curve), place[0], place[-1]))
    return middle + span * at, float(level + slope * at + curve * at**2)


def resample(time_s: Array, value: Array, *, step_s: float) -> tuple[Array, Array]:
    """Interpolate linearly onto a uniform grid from the first sample on, as C.1.3 does with 4 ms."""
    count = int(np.floor((time_s[-1] - time_s[0]) / step_s + 1e-9)) + 1
    grid = time_s[0] + step_s * np.arange(count)
    return grid, np.interp(grid, time_s, value)


class Smoothed(NamedTuple):
    """A smoothed signal and its first two derivatives, (n,) each."""

    value: Array
    first: Array
    second: Array


def smooth(value: Array, *, length: int, step_s: float) -> Smoothed:
    """Fit a cubic to every `length` neighbours of a uniform series (n,) and take it at their middle [SG].

    The ends take the first and the last such cubic where they are.
    """
    half = length // 2
    place = step_s * np.arange(-half, half + 1)
    fit = np.linalg.pinv(np.vander(place, 4, increasing=True))
    begin, end = Polynomial(fit @ value[:length]), Polynomial(fit @ value[-length:])
    columns = []
    for order in range(3):
        middle = math.factorial(order) * np.correlate(value, fit[order], mode="valid")
        ends = begin.deriv(order)(place[:half]), end.deriv(order)(place[half + 1 :])
        columns.append(np.concatenate([ends[0], middle, ends[1]]))
    return Smoothed(*columns)


def correlation_inflation(series: Array, *, longest: int) -> float:
    """Return by how much correlation inflates the variance of the sum of a zero-mean series (n,).

    The sum of the autocorrelations in pairs, as long as the pairs are positive [Gey]: 1 for white noise;
    never less, as a claim of negative correlation would have to be proven.
    """
    count = len(series)
    spectrum = np.fft.rfft(series, 2 * count)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: min(longest, count - 1) + 1]
    if correlation[0] <= 0:
        return 1.0
    correlation = correlation / correlation[0]
    pairs = correlation[1:-1:2] + correlation[2::2]
    negative = np.flatnonzero(pairs <= 0)
    stop = negative[0] if len(negative) else len(pairs)
    return float(max(1.0, 1.0 + 2.0 * pairs[:stop].sum()))


def block_means(value: Array, *, length: int) -> Array:
    """Return the means of consecutive blocks of `length` samples, a rest at the end left out."""
    blocks = len(value) // length
    return np.asarray(value[: blocks * length].reshape(blocks, length).mean(axis=1))
