"""The spectrum of a vibration, the evidence for combs of lines in it, and their frequencies by least squares.

Independent of rotors: `estimation` knows what turns at these frequencies and which lines it makes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import mul
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from cfid.errors import FitError

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

ROUNDING, TINY = 1e-24, np.finfo(float).tiny  # of a power

_PADDING = 4  # bins per resolution: a line between two of them looks 0.1 dB weaker
_FLOOR_BINS = 41  # each as wide as the resolution, over which the noise is taken as flat
_HIGHEST, _LOBE = 0.45, 2.0  # share of the sampling rate up to which lines are sought; resolutions on each side of one
_CANDIDATES = 8  # per resolution of the lowest line
_LIKELY, _MAYBE = 0.999, 0.5  # probability that an expected line shows, and that another does
_QUARTER = 1 / 16  # in power
_PLENTY = 30.0  # evidence beyond which more of it counts less: no line is as pure as its model
_IRREGULAR = 0.05  # of the sampling interval
_NOISE_BINS, _LOST_BINS = 20, 1.5  # to either side of a line, for its noise; those that a line's fit uses up
_NEAR = 0.02  # of its frequency, within which a line is looked for again
_MAX_STEPS, _CONVERGED = 40, 1e-6  # the latter the squared length of a step in standard uncertainties


def even_times(time_s: Array) -> tuple[Array, float, float]:
    """Return times (n,) about zero that are exact enough for phases, their interval, and the jitter of the given times.

    Time stamps of a clock that counts samples are kept, gaps included. Stamps of arrivals jitter far more than the
    sampling does; the samples are then taken as evenly spaced.
    """
    time, intervals = time_s - (time_s[0] + time_s[-1]) / 2, np.diff(time_s)
    place = np.linspace(-0.5, 0.5, len(time)) * (len(time) - 1)
    interval_s = float(np.median(intervals))
    if np.median(np.abs(intervals - interval_s)) < _IRREGULAR * interval_s:
        return time, interval_s, 0.0
    interval_s = float(place @ time) / float(place @ place)
    return np.asarray(interval_s * place), interval_s, float(np.std(time - interval_s * place))


class Spectrum(NamedTuple):
    """Amplitudes of lines (m, c) in the signal's unit at frequencies (m,), and the noise floor (m, c) beneath.

    Both are root mean squares over as many windows as fit into the record side by side, each `length_s` long.
    """

    frequency_hz: Array
    amplitude: Array
    floor: Array
    windows: float
    length_s: float

    @property
    def strength(self) -> Array:
        """Power (m,) relative to the noise, summed over the c channels: c where no line stands."""
        return np.asarray(np.sum((self.amplitude / self.floor) ** 2, axis=1))

    def lines_hz(self, *, evidence: float) -> Array:
        """Return the frequencies of lines with more than this evidence, each the highest within a lobe."""
        strength, channels = self.strength, self.amplitude.shape[1]
        power = np.maximum(strength / channels, 1.0)
        clear = max(self.windows, 1.0) * channels * (power - 1 - np.log(power)) > evidence
        highest = strength == maximum_filter1d(strength, round(2 * _LOBE * _PADDING) + 1)
        return np.asarray(self.frequency_hz[clear & highest])


def spectrum(*, signal: Array, interval_s: float, length_s: float = 1.0) -> Spectrum:
    """Return the spectrum of channels (n, c) in Hann windows of `length_s` that overlap by half (figure 3.4).

    A line of amplitude A shows as A. Mean and slope are removed from each window; a record shorter than a window is one
    window. The floor is a running median over frequency, which lines hardly raise.
    """
    length = round(min(length_s / interval_s, len(signal)))
    size = next_fast_len(_PADDING * length, real=True)
    starts = range(0, len(signal) - length + 1, max(length // 2, 1))
    power = np.mean([_power(signal[start : start + length], size) for start in starts], axis=0)
    windows = len(signal) / length
    rows = np.ascontiguousarray(power[::_PADDING].T)  # in one dimension the filter is six times as fast
    median = np.transpose([median_filter(row, size=_FLOOR_BINS, mode="reflect") for row in rows])
    mean = median / (1 - 1 / (9 * windows)) ** 3  # Wilson and Hilferty's median of a gamma distribution
    floor = np.maximum(np.repeat(mean, _PADDING, axis=0)[: len(power)], ROUNDING * power.max(axis=0) + TINY)
    frequency = np.arange(len(power)) / (size * interval_s)
    return Spectrum(frequency, np.sqrt(power), np.sqrt(floor), windows, length * interval_s)


def _power(frame: Array, size: int) -> Array:
    place = np.linspace(-1, 1, len(frame))[:, np.newaxis]
    level = frame - frame.mean(axis=0)
    window = np.hanning(len(frame) + 2)[1:-1, np.newaxis]
    flat = level - place * (place * level).sum(axis=0) / (place**2).sum()
    return np.asarray(np.abs(2 / window.sum() * np.fft.rfft(window * flat, size, axis=0)) ** 2)


class Comb(NamedTuple):
    """Lines at multiples of one frequency, and the evidence for them.

    In noise alone, the strength of c channels is a sum of c exponential variables; a line makes it larger by an unknown
    factor. Evidence is the logarithm of the likelihood of that line over that of noise. An `expected` line is likely to
    be at least a quarter as high as the highest; its absence is unlikely, but not impossible.
    """

    harmonics: tuple[int, ...]
    expected: tuple[int, ...]

    def candidates(self, seen: Spectrum, between_rad_per_s: tuple[float, float]) -> Array:
        """Return angular frequencies (g,) that sampling can distinguish, dense enough to miss no line in a spectrum."""
        low, high = between_rad_per_s
        highest = 4 * math.pi * _HIGHEST * seen.frequency_hz[-1]
        if low >= min(high, highest):
            raise FitError(
                f"no speed from {low:.0f} to {high:.0f} rad/s can be found: at this sampling rate the largest is "
                f"{highest:.0f} rad/s. Record faster, or state a lower range."
            )
        return np.arange(low, min(high, highest), 2 * math.pi / (_CANDIDATES * seen.length_s))

    def lines(self, seen: Spectrum, rad_per_s: Array) -> Array:
        """Return the evidence (h, g) for each line of each candidate."""
        channels, highest_hz = seen.amplitude.shape[1], 2 * _HIGHEST * seen.frequency_hz[-1]
        line_hz = np.outer(self.harmonics, rad_per_s) / (2 * math.pi)
        resolved = line_hz <= highest_hz
        place = np.rint(np.minimum(line_hz, highest_hz) / seen.frequency_hz[1]).astype(int)
        power = seen.strength[place] / channels
        size = np.where(resolved, np.maximum(power - 1, 0.0), 0.0)
        size = np.maximum(size, np.where(self._expected, _QUARTER * size.max(axis=0), 0.0))
        evidence = max(seen.windows, 1.0) * channels * (power * size / (1 + size) - np.log1p(size))
        return np.where(resolved, evidence, 0.0)

    def score(self, lines: Array) -> Array:
        """Return the evidence (g,) for each candidate in its lines (h, g), at most half of it in unexpected lines."""
        likely = np.where(self._expected, _LIKELY, _MAYBE)
        gained = np.logaddexp(np.log1p(-likely), np.log(likely) + lines)
        gained = np.where(gained > 0, _PLENTY * np.log1p(gained / _PLENTY), gained)
        expected = np.sum(gained, axis=0, where=self._expected)
        return np.asarray(expected + np.clip(gained.sum(axis=0) - expected, None, np.maximum(expected, 0.0)))

    @property
    def _expected(self) -> npt.NDArray[np.bool_]:
        return np.isin(self.harmonics, self.expected)[:, np.newaxis]


# Lines by least squares


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
