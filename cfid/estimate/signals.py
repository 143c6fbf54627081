"""Process sampled signals of any kind: blocks, means among lines and spikes, spectra, correlated noise."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import Polynomial
from scipy.special import fdtri

from cfid.errors import DataError
from cfid.estimate.propagation import widening
from cfid.large import stored
from cfid.lazy import later

_next_fast_len = later("scipy.fft", "next_fast_len")  # imported only where a fit computes a spectrum
_prev_fast_len = later("scipy.fft", "prev_fast_len")

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

GRID_S = 0.004  # the thesis' sampling time, eq. 2.15
SMOOTHED_S = 0.05  # leaves frequencies up to 20 Hz

_SMOOTH_HZ = 100.0
_LINES_FROM_HZ = 20.0  # with a margin: small rotors idle above 50 Hz
_ORDINATES = 24
# The degrees of freedom of an ordinate with Hann's window, which shares these parts with its neighbours.
_FREEDOM = 2 / (1 + 2 * (4 / 9 + 1 / 36))
_LEAST_RATE_HZ = 2.0  # far below the rate of any angle that can be fitted
_TAPER, _TAPER_S = 0.2, 0.05
_DRAWN = 64
_WILD = 6 / 1.645


def block_means(value: Array, *, length: int) -> Array:
    """Return the means of consecutive blocks of `length` samples along the last axis, without an incomplete one.

    This thins a record without aliasing fast changes.
    """
    blocks = value.shape[-1] // length
    cut = value[..., : blocks * length].reshape(*value.shape[:-1], blocks, length)
    return np.asarray(cut @ np.full(length, 1 / length))


def check_dense(time_s: Array) -> None:
    """Raise DataError where a record (n,) has too few samples for its time, as after a jump of the clock."""
    span_s = float(time_s[-1] - time_s[0])
    if len(time_s) < _LEAST_RATE_HZ * span_s:
        longest = int(np.argmax(np.diff(time_s)))
        raise DataError(
            f"{len(time_s)} samples in {span_s:.3g} s (expected {_LEAST_RATE_HZ:g} a second or more), and the longest "
            f"gap, of {time_s[longest + 1] - time_s[longest]:.3g} s, follows the first "
            f"{time_s[longest] - time_s[0]:.3g} s. Was the clock set? Fit a file of one part."
        )


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
    """Fit a cubic to every `length` neighbours of a uniform series (n,) and evaluate it at their middle [SG].

    The ends are evaluated from the first and the last of these cubics.
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
    """Return the factor by which correlation inflates the variance of the sum of a zero-mean series (n,).

    It is computed from the sum of the autocorrelations in pairs, as long as the pairs are positive [Gey]: 1 for white
    noise; never less, because a negative correlation would have to be proven.
    """
    lags = min(longest, len(series) - 1) + 1
    padded = _next_fast_len(len(series) + lags, real=True)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(series, padded)) ** 2, padded)[:lags]
    if correlation[0] <= 0:
        return 1.0
    correlation = correlation / correlation[0]
    pairs = correlation[1:-1:2] + correlation[2::2]
    negative = np.flatnonzero(pairs <= 0)
    stop = negative[0] if len(negative) else len(pairs)
    return float(max(1.0, 1.0 + 2.0 * pairs[:stop].sum()))


def cosine_taper(count: int, *, share: float) -> Array:
    """Return weights (count,) of sum 1 that rise and fall as a cosine over `share` of them [Har]; 1 is Hann's."""
    length = math.ceil(share * count / 2)
    weights = np.ones(count)
    weights[:length] = np.sin(np.pi / (share * count) * (np.arange(length) + 0.5)) ** 2
    weights[count - length :] = weights[length - 1 :: -1]
    return np.asarray(weights / weights.sum())


def density_near_zero(value: Array, *, rate_hz: float) -> tuple[Array, Indices]:
    """Return the two-sided density per Hz (...) near frequency zero of a series (..., n) without trend.

    Its degrees of freedom (...) are returned with it. The density is the mean of the lowest ordinates of the
    periodogram, after [HW], up to 20 Hz: 24, or fewer where their lower half is higher than the upper (F, 10 %). A Hann
    window excludes the lines of rotors, from 50 Hz on; its ordinates share 4/9 and 1/36 of their scatter with the next.
    White noise of variance s^2 has s^2 / rate. A remainder that would make the transform slow is left out. A series
    that is too short gives NaN with freedom 0.
    """
    count = _prev_fast_len(value.shape[-1], real=True)
    highest = min(_ORDINATES + 1, math.floor(_LINES_FROM_HZ * count / rate_hz), (count - 1) // 2)
    if highest < 2:
        return np.full(value.shape[:-1], np.nan), np.zeros(value.shape[:-1], np.intp)
    weights = cosine_taper(count, share=1.0)
    lines = np.fft.rfft(weights * value[..., :count])[..., 2 : highest + 1]
    power = np.abs(lines) ** 2 / (rate_hz * (weights @ weights))
    kept = np.full(power.shape[:-1], wide := power.shape[-1])
    while wide >= _ORDINATES // 2:
        half = wide // 2
        upper = power[..., half:wide].mean(axis=-1) * fdtri(_FREEDOM * half, _FREEDOM * (wide - half), 0.9)
        kept[(kept == wide) & (power[..., :half].mean(axis=-1) > upper)] = half
        wide = half
    low = np.arange(power.shape[-1]) < kept[..., np.newaxis]
    return np.asarray(power.sum(axis=-1, where=low) / kept), np.maximum(np.rint(_FREEDOM * kept), 2).astype(np.intp)


def detrended(value: Array) -> tuple[Array, Array]:
    """Return a series (..., n) minus its least-squares line, and the line's slope per sample (...)."""
    place = np.arange(value.shape[-1]) - (value.shape[-1] - 1) / 2
    slope = np.asarray(value @ place / max(place @ place, 1.0))
    return value - value.mean(axis=-1, keepdims=True) - slope[..., np.newaxis] * place, slope


class Mean(NamedTuple):
    """The mean of a window (...), its slope a second, and the number of independent samples with this uncertainty.

    `scatter_std` is estimated from the window with a number of degrees of freedom; 1.96 times `std` cover 95 %.
    """

    value: Array
    scatter_std: Array
    freedom: Array
    slope: Array
    effective_samples: Array

    @property
    def std(self) -> Array:
        """The standard uncertainty of the mean, increased for its few degrees of freedom."""
        return np.asarray(widening(self.freedom) * self.scatter_std)


def quiet_mean(value: Array, *, rate_hz: float) -> Mean:
    """Average a window (..., n) whose vibration may be larger than its mean.

    A cosine taper over a tenth of the window at each end, 50 ms at least, suppresses lines that contribute amplitude /
    (pi frequency length) to a plain mean. The standard uncertainty comes from the noise near frequency zero; in a
    window too short to show that, its two or more samples count as independent.
    """
    count = value.shape[-1]
    weights = cosine_taper(count, share=min(max(_TAPER, 2 * _TAPER_S * rate_hz / count), 1.0))
    left, slope = detrended(value)
    density, freedom = density_near_zero(left, rate_hz=rate_hz)
    if not freedom.all():
        freedom = np.full_like(freedom, count - 1)
        density = value.var(axis=-1, ddof=1) / rate_hz
    variance = density * rate_hz * (weights @ weights)
    with np.errstate(divide="ignore", invalid="ignore"):
        samples = np.fmin(value.var(axis=-1) / variance, count)
    return Mean(value @ weights, np.sqrt(variance), freedom.astype(np.float64), slope * rate_hz, samples)


class Runs(NamedTuple):
    """Runs of neighbours in a series: first, size, slope of a line and its standard uncertainty, rest about the line.

    `wave` is the size of slow changes about the line; `alike` is von Neumann's ratio there [vN], in standard deviations
    of white noise.
    """

    first: Indices
    size: Indices
    slope: Array
    slope_std: Array
    wave: Array
    alike: Array

    @classmethod
    def of(cls, series: Array, *, fewest: int) -> "Runs":
        """Fit a line to each run of at least `fewest` values of a series (n,)."""
        first, end = np.triu_indices(len(series) + 1, k=fewest)
        value, place, size = series - series.mean(), np.arange(len(series)), end - first
        sums = (value, place * value, value**2, np.diff(value) ** 2)
        total, moment, squares, steps = (np.concatenate([[0.0], np.cumsum(part)]) for part in sums)
        lever, mass = size * (size**2 - 1) / 12, total[end] - total[first]
        slope = (moment[end] - moment[first] - (first + end - 1) / 2 * mass) / lever
        left = np.maximum(squares[end] - squares[first] - mass**2 / size - slope**2 * lever, 0)
        noise = np.maximum((steps[end - 1] - steps[first]) / (size - 1) - slope**2, 0) / 2
        wave = np.sqrt(np.maximum(left / (size - 2) - noise, 0))
        ratio = np.divide(noise * size, left, out=np.ones_like(left), where=left > 0)
        return cls(first, size, slope, np.sqrt(noise / lever), wave, (1 - ratio) / np.sqrt((size - 2) / (size**2 - 1)))


class Slow(NamedTuple):
    """A series (n,) at times (n,), without changes faster than about 20 Hz."""

    time_s: Array
    value: Array

    def between(self, from_s: float, to_s: float) -> "Slow":
        """Return the part between two times."""
        first, last = np.searchsorted(self.time_s, (from_s, to_s))
        return Slow(self.time_s[first:last], self.value[first:last])


def slowed(time_s: Array, value: Array, *, rate_hz: float) -> Slow:
    """Smooth a series (n,) without spikes with a Hann window of 50 ms, onto about 100 samples a second."""
    half = max(round(SMOOTHED_S * rate_hz / 2), 0)
    weights = cosine_taper(2 * half + 1, share=1.0)
    every = max(round(rate_hz / _SMOOTH_HZ), 1)
    around = sliding_window_view(np.pad(value, half, mode="edge"), len(weights))[::every]
    return Slow(time_s[::every], stored(around @ weights))


def find_spikes(value: Array, *, length: int) -> tuple[Indices, Indices, Array]:
    """Return row and place of spikes in series (k, n), of one or two samples, and the mean of the samples next to them.

    Spikes are too far from the median of their block of `length`, as Hampel identifies them [Ham], and half as far from
    the valid samples on both sides, unlike a step.
    """
    rows, places, limits = _too_far(value, length=min(length, value.shape[-1]))
    inside = (places > 1) & (places < value.shape[-1] - 2)
    rows, places, limits = rows[inside], places[inside], limits[inside]
    wild = np.zeros(value.shape, bool)
    wild[rows, places] = True
    before, after = places - 1 - wild[rows, places - 1], places + 1 + wild[rows, places + 1]
    ends = np.stack([value[rows, before], value[rows, after]])
    rise = value[rows, places] - ends
    out = (rise[0] * rise[1] > 0) & (np.abs(rise).min(axis=0) > limits / 2) & ~wild[rows, before] & ~wild[rows, after]
    return rows[out], places[out], ends.mean(axis=0)[out]


def without_spikes(value: Array, *, length: int) -> Array:
    """Return series (k, n) with each spike replaced by the mean of the samples next to it: see `find_spikes`."""
    row, place, instead = find_spikes(value, length=length)
    clean = value.copy()
    clean[row, place] = instead
    return clean


def _too_far(value: Array, *, length: int) -> tuple[Indices, Indices, Array]:
    """Return row, place and limit of samples beyond 6 standard deviations from the median of their block.

    The standard deviation is estimated from the range that contains nine of ten samples: that of five in ten may vanish
    where a line is sampled at a simple fraction of its period. The widest of a block and its neighbours counts. Median
    and range are those of a random sample of the block.
    """
    blocks = value.shape[-1] // length
    cut = value[:, : blocks * length].reshape(len(value), blocks, length)
    drawn = np.sort(cut[..., np.random.default_rng(0).permutation(length)[:_DRAWN]], axis=-1)
    low, middle, high = (round(part * (drawn.shape[-1] - 1)) for part in (0.05, 0.5, 0.95))
    centre = drawn[..., middle]
    width = np.pad((drawn[..., high] - drawn[..., low]) / 2, ((0, 0), (1, 1)), mode="edge")
    limit = _WILD * np.maximum(np.maximum(width[:, :-2], width[:, 2:]), width[:, 1:-1])
    row, block = np.nonzero((cut.max(axis=-1) > centre + limit) | (cut.min(axis=-1) < centre - limit))
    which, at = np.nonzero(np.abs(cut[row, block] - centre[row, block, np.newaxis]) > limit[row, block, np.newaxis])
    last, over = np.nonzero(np.abs(value[:, blocks * length :] - centre[:, -1:]) > limit[:, -1:])
    places = np.append(block[which] * length + at, blocks * length + over)
    return np.append(row[which], last), places, np.append(limit[row, block][which], limit[last, -1])
