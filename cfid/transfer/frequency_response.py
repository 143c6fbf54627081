"""Compute the plant's response at a sine run's frequency: a complex number, with the variance of the noise.

The fit to the force consists of a sine and a cosine at the known frequency, a constant, a drift, and the two harmonics
that a nonlinear plant causes. The noise of a load cell under rotors consists of lines and drift and is not white: its
level is taken from the residual at nearby frequencies. For the slowest sines, noise that grows steeply towards zero
frequency exceeds that level, which the chi-squared of a fit shows.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.estimate.signals import block_means
from cfid.transfer.alignment import SineRun

Array = npt.NDArray[np.float64]

SETTLE_S = 1.0  # N_T of the thesis' first series, in seconds
END_S = 0.1  # of the run's end left out: stamps of commands may be late by as much
_HARMONICS = 3
_NEIGHBOURS = 20  # frequencies on either side from which the noise is estimated
_CLEAR = 0.75  # of 1/T, the least distance from any fitted frequency
_SPECTRUM_HZ = 1000.0  # a sufficient sampling rate for them


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Y/U of one run at its frequency, in N per unit of the command, with the covariance (2, 2) of its two parts.

    `value` refers to the samples u[n]; the hold that turns these into steps is part of the model. An error of the run's
    start rotates `value` and does not change its size: `start_std_s` is the run's own, `shared_s` are those in common
    with other runs. `second` is the second harmonic over the first, with its phase relative
    to that of the first, so that it does not depend on the start. `skew`, with its standard uncertainty, is how much
    lower the sine's frequency is by the load cell's stamps than by the host's clock, and `since_s` the time from the
    first stamp of a load cell with its own clock to the middle of the force that was used.
    """

    name: str
    periods: int
    frequency_rad_s: float
    sample_s: float
    value: complex
    covariance: Array
    start_std_s: float
    shared_s: Mapping[str, float]
    second: complex = 0j
    skew: float = 0.0
    skew_std: float = math.inf
    since_s: float = 0.0

    @property
    def std(self) -> float:
        """The standard uncertainty of the real and the imaginary part in N, taken as equal."""
        return float(np.sqrt(np.trace(self.covariance) / 2))

    @property
    def polar_std(self) -> tuple[float, float]:
        """The standard uncertainties of the size in N, and of the phase in rad with that of the run's own start."""
        size = abs(self.value)
        along = np.array([self.value.real, self.value.imag]) / size
        across = np.array([-along[1], along[0]])
        phase = np.sqrt(across @ self.covariance @ across) / size
        turned = self.frequency_rad_s * self.start_std_s
        return float(np.sqrt(along @ self.covariance @ along)), float(np.hypot(phase, turned))


def respond(run: SineRun, *, settle_s: float = SETTLE_S) -> Response:
    """Return the frequency response of a run with l from 1 to below N/2, without `settle_s` at its start.

    Raises DataError for l = 0, which has no frequency, and FitError when the force is zero or has too few samples.
    """
    if not 0 < 2 * run.sine.periods < run.sine.samples:
        raise DataError(f"{run.name}: {run.sine.hz:g} Hz is not above zero and below half of the sampling rate.")
    begin, end = np.searchsorted(run.time_s, [settle_s, run.duration_s - END_S])
    time_s, force, omega = run.time_s[begin:end], run.force_n[begin:end], run.frequency_rad_s
    if len(force) < 2 * (3 + 2 * _HARMONICS):
        raise FitError(
            f"{run.name}: {counted(len(force), 'sample')} of force after {settle_s:g} s: too few for a sine."
        )
    rate_hz, least_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0]), _HARMONICS * omega / np.pi
    if rate_hz <= least_hz:
        raise FitError(
            f"{run.name}: {rate_hz:.3g} samples of force a second are too few for a sine of "
            f"{omega / (2 * np.pi):.3g} Hz and its harmonics (above {least_hz:.3g})."
        )
    columns = sine_columns(time_s, omega)
    inverse = np.linalg.inv(columns @ columns.T)
    values = inverse @ (columns @ force)
    phasors = values[3::2] - 1j * values[4::2]
    if not phasors[0]:
        raise FitError(f"{run.name}: the load cell measured nothing while it was played: is the channel the motor's?")
    residual = force - values @ columns
    level = _noise_level(time_s, residual, omega)
    middle_s = float(time_s.mean())
    # The derivative of the sine with respect to its relative frequency, about the middle, where it moves no phase.
    turning = -omega * (time_s - middle_s) * (values[3] * columns[4] - values[4] * columns[3])
    power = float(turning @ turning)
    drive = drive_of(run)
    return Response(
        name=run.name,
        periods=run.sine.periods,
        frequency_rad_s=omega,
        sample_s=run.sample_s,
        value=complex(phasors[0] / drive),
        covariance=level / drive**2 * inverse[3:5, 3:5] * [[1, -1], [-1, 1]],
        start_std_s=run.start_std_s,
        shared_s=run.shared_s,
        second=complex(phasors[1] * np.conj(phasors[0]) ** 2 / abs(phasors[0]) ** 3),
        skew=-float(turning @ residual) / power,
        skew_std=math.sqrt(level / power),
        since_s=0.0 if run.first_s is None else middle_s - run.first_s,
    )


def sine_columns(time_s: Array, omega: float) -> Array:
    """Return constant, linear and quadratic drift, then cosine and sine of each harmonic (9, n)."""
    wave = np.exp(1j * omega * time_s)
    columns = np.empty((3 + 2 * _HARMONICS, len(time_s)))
    columns[0] = 1
    columns[1] = time_s - time_s[:1]
    columns[2] = columns[1] ** 2
    turned = wave
    for row in range(3, len(columns), 2):
        columns[row], columns[row + 1] = turned.real, turned.imag
        turned = turned * wave
    return columns


def drive_of(run: SineRun) -> float:
    """Return the amplitude of the samples played, whose phase is 0; that of a clipped sine is less than A."""
    samples = np.arange(run.sine.samples)
    angle = 2 * np.pi * (run.sine.periods * samples % run.sine.samples) / run.sine.samples
    return float(2 * np.mean(run.sine.commands() * np.cos(angle)))


def _noise_level(time_s: Array, residual: Array, omega: float) -> float:
    """Return the variance per sample of white noise with the level found around a frequency.

    The level is taken at frequencies half a bin off the multiples of 1/T around it, except near the fitted frequencies.
    """
    span_s = float(time_s[-1] - time_s[0])
    width = 2 * np.pi / span_s
    place = omega / width
    fitted = place * np.arange(_HARMONICS + 1)
    first = max(1.5 - _NEIGHBOURS, math.ceil(_CLEAR - place - 0.5) + 0.5)
    tried = place + first + np.arange(2 * _NEIGHBOURS + 8 * len(fitted))
    tried = tried[(np.abs(tried[:, None] - fitted) >= _CLEAR).all(axis=1)][: 2 * _NEIGHBOURS]
    block = max(int(len(residual) / (span_s * _SPECTRUM_HZ)), 1)
    middle_s, means = (block_means(values, length=block) for values in (time_s - time_s[0], residual))
    # Neighbours are whole bins apart, so each wave is the one before, turned by whole bins.
    wave, turn = means * np.exp(-1j * tried[0] * width * middle_s), np.exp(-1j * width * middle_s)
    powers = [abs(wave.sum()) ** 2]
    for steps in np.rint(np.diff(tried)).astype(int):
        wave = wave * turn if steps == 1 else wave * turn**steps
        powers.append(abs(wave.sum()) ** 2)
    # The variance comes from few values and is uncertain itself: sums of squares over it are too large on average.
    unsure = len(powers) / (len(powers) - 1)
    return float(np.mean(powers)) * block**2 / len(residual) * unsure
