"""Measure noise, drift and lines of a signal under constant load, before it is used. Needs no SciPy."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.blocks import block_means

Array = npt.NDArray[np.float64]

MAINS_HZ = (50.0, 60.0)

_BLOCKS = 20  # their scatter about a line gives the uncertainty of the drift
_LOWEST_HZ = 5.0  # of a line: slower changes are drift
_WIDTH_HZ, _WIDTH_BINS = 0.5, 2  # the tolerance of mains frequency; half the width of a line in the spectrum
_CLEAR = 5.0  # times the spectrum's median: noise alone stays below that


class SignalQuality(NamedTuple):
    """A signal under constant load, in its unit: a sample's noise, the change over the record, and amplitudes of lines.

    `noise_std` is about a straight line. `mains` is the largest amplitude at 50 or 60 Hz, `line` the largest of all
    other lines above 5 Hz; a frequency is NaN where no line stands out from the noise.
    """

    noise_std: float
    drift: float
    drift_std: float
    mains_hz: float
    mains: float
    line_hz: float
    line: float


def signal_quality(signal: Array, *, rate_hz: float) -> SignalQuality:
    """Judge a signal (n,) of a constant load at `rate_hz`; needs a second or more, and at least 64 samples."""
    place = np.linspace(-0.5, 0.5, len(signal))
    means = block_means(signal, length=len(signal) // _BLOCKS)
    at = np.linspace(-0.5, 0.5, len(means))
    drift, middle = np.polyfit(at, means, 1)
    off = means - np.polyval((drift, middle), at)
    drift_std = float(np.sqrt(off @ off / (len(means) - 2) / (at @ at)))
    residual = signal - np.polyval((drift, middle), place)
    window = np.hanning(len(residual))
    amplitude = 2 * np.abs(np.fft.rfft(residual * window)) / window.sum()
    frequency_hz = np.asarray(np.fft.rfftfreq(len(residual), 1 / rate_hz), np.float64)
    width_hz = max(_WIDTH_HZ, _WIDTH_BINS * rate_hz / len(residual))
    hum = np.min(np.abs(frequency_hz[:, np.newaxis] - np.array(MAINS_HZ)), axis=1) <= width_hz
    mains = _largest(frequency_hz, amplitude, hum)
    others = _largest(frequency_hz, amplitude, ~hum & (frequency_hz >= _LOWEST_HZ))
    return SignalQuality(float(residual.std()), float(drift), drift_std, *mains, *others)


def _largest(frequency_hz: Array, amplitude: Array, among: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Return frequency and amplitude of the strongest line among some bins; NaN and 0 without bins."""
    if not among.any():
        return float("nan"), 0.0
    best = int(np.argmax(np.where(among, amplitude, -1.0)))
    clear = amplitude[best] > _CLEAR * np.median(amplitude)
    return float(frequency_hz[best]) if clear else float("nan"), float(amplitude[best])
