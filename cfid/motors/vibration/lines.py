"""The frequencies of lines in a vibration, by least squares. Like `spectrum`, independent of rotors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import mul
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d

from cfid.motors.vibration.spectrum import ROUNDING, TINY, Comb, spectrum

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

_NOISE_BINS, _LOST_BINS = 20, 1.5  # to either side of a line, for its noise; those that a line's fit uses up
_NEAR = 0.02  # of its frequency, within which a line is looked for again
_MAX_STEPS, _CONVERGED = 40, 1e-6  # the latter the squared length of a step in standard uncertainties


class Family(NamedTuple):
    """Lines at multiples of one angular frequency."""

    rad_per_s: float
    harmonics: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class LineFit:
    """Families of lines with their fitted frequencies at time zero, and their common drift relative to the frequency.

    `covariance` (p + 1, p + 1) belongs to the p angular frequencies and the drift. `amplitude` holds the complex
    amplitudes (h, c) of each family at time zero, `residual` (n, c) what the fit leaves, and `weight` (c,) the inverse
    of the noise's power per sample near the first family's lines.
    """

    families: tuple[Family, ...]
    drift_per_s: float
    covariance: Array
    amplitude: tuple[Complex, ...]
    residual: Array
    weight: Array


def fit_lines(
    *,
    time_s: Array,
    signal: Array,
    families: Sequence[Family],
    drift_per_s: float = 0.0,
    drifting: bool = True,
    first_s: float = math.inf,
) -> LineFit:
    """Fit the frequencies of all families to channels (n, c) at times (n,) about zero, by least squares.

    The model is a straight line per channel and, for each spectral line, a phase and an amplitude per channel. These
    are linear, so each step of the search solves for them (Golub, Pereyra 1973). All families run on the time t + drift
    t^2 / 2. The start must lie within half a resolution (1 / length) of the truth at the highest harmonic; a record
    longer than `first_s` starts with its middle half. The covariance is that of least squares in the noise found around
    the lines, whatever its colour; in white noise it is the Cramer-Rao bound.
    """
    if time_s[-1] - time_s[0] > first_s:
        middle = np.abs(time_s) < time_s[-1] / 2
        time, part = time_s[middle], signal[middle]
        rough = fit_lines(time_s=time, signal=part, families=families, drifting=drifting, first_s=first_s)
        families, drift_per_s = rough.families, rough.drift_per_s
    search = _Search(time_s, signal, tuple(families), drifting)
    point = search.at(np.array([family.rad_per_s for family in families] + [drift_per_s]))
    point = search.descend(point, 1 / (np.mean(point.residual**2, axis=1) + search.rounding))
    point = search.descend(point, search.noise(point)[1])
    covariance, weight = search.noise(point)
    *found, drift = point.parameters.tolist()
    return LineFit(
        families=tuple(family._replace(rad_per_s=value) for family, value in zip(families, found, strict=True)),
        drift_per_s=drift,
        covariance=covariance,
        amplitude=point.amplitude,
        residual=point.residual.T,
        weight=weight,
    )


def fit_parts(*, time_s: Array, signal: Array, fit: LineFit, parts: int) -> tuple[Array, Array, Array]:
    """Return how far the frequency departs from a fit in each part of the record, its uncertainty and the evidence."""
    first, found = fit.families[0], []
    comb = Comb(first.harmonics, first.harmonics)
    for part in np.array_split(np.arange(len(time_s)), parts):
        middle_s = (time_s[part[0]] + time_s[part[-1]]) / 2
        here = first.rad_per_s * (1 + fit.drift_per_s * middle_s)
        seen = spectrum(signal=signal[part], interval_s=float(np.median(np.diff(time_s[part]))))
        grid = comb.candidates(seen, (here * (1 - _NEAR), here * (1 + _NEAR)))
        score = comb.score(comb.lines(seen, grid))
        start = first._replace(rad_per_s=float(grid[np.argmax(score)]))
        own = fit_lines(time_s=time_s[part] - middle_s, signal=signal[part], families=[start], drifting=False)
        found.append((own.families[0].rad_per_s - here, math.sqrt(own.covariance[0, 0]), score.max()))
    departure, std, evidence = np.array(found).T
    return departure, std, evidence


class _Point(NamedTuple):
    """A point of the search: what the best amplitudes leave, and how that changes with the parameters."""

    parameters: Array
    amplitude: tuple[Complex, ...]
    residual: Array  # (c, n)
    tangent: Array  # (p + 1, c, n), the part that amplitudes cannot make up for


class _Search:
    """Least squares over channels (c, n), the samples of each contiguous in memory: several times as fast."""

    def __init__(self, time_s: Array, signal: Array, families: tuple[Family, ...], drifting: bool) -> None:
        self._time, self._signal, self._families = time_s, np.ascontiguousarray(signal.T), families
        self._free = np.arange(len(families) + drifting)
        self.rounding = ROUNDING * np.mean(self._signal**2, axis=1) + TINY

    def at(self, parameters: Array) -> _Point:
        time, channels = self._time, len(self._signal)
        clock = time + parameters[-1] / 2 * time**2
        rows = [np.ones(len(time)), time]
        for family, speed in zip(self._families, parameters, strict=False):
            waves = _waves(speed * clock, family.harmonics)
            rows += [*waves.real, *waves.imag]
        design = np.array(rows)
        inverse = _inverse(design @ design.T)
        solved = (self._signal @ design.T) @ inverse
        amplitude, tangent, begin = [], np.zeros((len(parameters), *self._signal.shape)), 2
        for k, family in enumerate(self._families):
            lines = len(family.harmonics)
            place = slice(begin, begin + 2 * lines)
            cos, sin = solved[:, place][:, :lines], solved[:, place][:, lines:]
            times = np.array(family.harmonics)
            by_angle = np.hstack([times * sin, -times * cos]) @ design[place]
            tangent[k] = clock * by_angle
            tangent[-1] += parameters[k] / 2 * time**2 * by_angle
            amplitude.append((cos - 1j * sin).T)
            begin = place.stop
        flat = tangent.reshape(-1, len(time))
        flat -= (flat @ design.T) @ inverse @ design
        return _Point(
            parameters, tuple(amplitude), self._signal - solved @ design, flat.reshape(-1, channels, len(time))
        )

    def descend(self, point: _Point, weight: Array) -> _Point:
        """Descend to the least weighted residual by Levenberg-Marquardt steps."""
        root = np.sqrt(weight)[:, np.newaxis]
        damping, loss = 0.0, weight @ np.sum(point.residual**2, axis=1)
        for _ in range(_MAX_STEPS):
            tangent = (point.tangent[self._free] * root).reshape(len(self._free), -1)
            scale = np.sqrt(np.sum(tangent**2, axis=1)) + TINY
            tangent /= scale[:, np.newaxis]
            normal, slope = tangent @ tangent.T, tangent @ (point.residual * root).ravel()
            step = np.linalg.lstsq(normal + damping * np.eye(len(scale)), slope, rcond=1e-12)[0]
            parameters = point.parameters.copy()
            parameters[self._free] += step / scale
            trial = self.at(parameters)
            trial_loss = weight @ np.sum(trial.residual**2, axis=1)
            if trial_loss <= loss:
                point, loss, damping = trial, trial_loss, damping / 10 if damping > 1e-3 else 0.0
            else:
                damping = max(10 * damping, 1e-3)
            if step @ normal @ step < _CONVERGED:
                break
        return point

    def noise(self, point: _Point) -> tuple[Array, Array]:
        """Return the parameters' covariance and the weights (c,), from the residual's spectrum around the lines."""
        count, tangent = len(self._time), point.tangent[self._free]
        size = next_fast_len(count, real=True)
        power = np.abs(np.fft.rfft(point.residual, size)) ** 2 / count + self.rounding[:, np.newaxis]
        width = 2 * min(_NOISE_BINS, size // 16) + 1
        lost = _LOST_BINS * len(self._families)
        power = uniform_filter1d(power, width, mode="reflect") * width / max(width - lost, 1.0)
        waves = np.fft.rfft(tangent, size)
        information = np.einsum("pcn,qcn->cpq", tangent, tangent)
        spread = 2 / size * np.einsum("pcf,qcf,cf->cpq", waves.conj(), waves, power).real
        weight = information[:, 0, 0] / (spread[:, 0, 0] + TINY)
        inverse = np.linalg.pinv(np.einsum("c,cpq->pq", weight, information), hermitian=True)
        covariance = np.zeros((len(point.parameters),) * 2)
        covariance[np.ix_(self._free, self._free)] = inverse @ np.einsum("c,cpq->pq", weight**2, spread) @ inverse
        return covariance, weight


def _inverse(gram: Array) -> Array:
    """Return the pseudo-inverse of a positive semidefinite matrix, in a third of the time of `pinv`."""
    values, vectors = np.linalg.eigh(gram)
    kept = values > 1e-13 * values[-1]
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def _waves(angle_rad: Array, harmonics: Sequence[int]) -> Complex:
    """Return exp(i h angle) (h, n) as powers of the first, so that one sine and cosine serve all harmonics."""
    first = np.cos(angle_rad) + 1j * np.sin(angle_rad)
    powers = list(accumulate([first] * max(harmonics), mul))
    return np.array([powers[h - 1] for h in harmonics])
