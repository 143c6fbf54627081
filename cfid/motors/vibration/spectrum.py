"""The spectrum of a vibration, and the evidence for combs of lines in it.

Independent of rotors: `estimation` knows what turns at these frequencies and which lines it makes.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len
from scipy.ndimage import maximum_filter1d, median_filter

from cfid.errors import FitError

Array = npt.NDArray[np.float64]

ROUNDING, TINY = 1e-24, np.finfo(float).tiny  # of a power

_PADDING = 4  # bins per resolution: a line between two of them looks 0.1 dB weaker
_FLOOR_BINS = 41  # each as wide as the resolution, over which the noise is taken as flat
_HIGHEST, _LOBE = 0.45, 2.0  # share of the sampling rate up to which lines are sought; resolutions on each side of one
_CANDIDATES = 8  # per resolution of the lowest line
_LIKELY, _MAYBE = 0.999, 0.5  # probability that an expected line shows, and that another does
_QUARTER = 1 / 16  # in power
_PLENTY = 30.0  # evidence beyond which more of it counts less: no line is as pure as its model
_IRREGULAR = 0.05  # of the sampling interval


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
