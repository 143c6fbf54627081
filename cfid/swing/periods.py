"""Find a natural frequency from timed periods: those of a stopwatch, or of a light gate.

A period grows with the amplitude A: T = T0 (1 + A^2 / 16 + ...), by the integral of the equation of motion, also of a
body on two threads. Friction changes it by the square of the decay alone, and is not corrected: where the amplitude
falls by 10 % in a period, the natural frequency squared is 0.03 % too low.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.propagation import widened
from cfid.findings import Finding, warning
from cfid.recordings.periods import PeriodRecord
from cfid.records.plausibility import taken_as_exact
from cfid.swing.pendulum import NO_THREADS, Threads

Array = npt.NDArray[np.float64]

_FEWEST = 3  # times whose scatter shows a standard uncertainty
_UNSTATED_DEG = 10.0  # an amplitude that nobody stated lies between zero and this
_SURE = 0.99  # probability below which a scatter is within the stated standard uncertainty
_LEAST_RAD = 1e-6  # below it, an amplitude changes no digit of a period
_ROUNDS = 4  # of a body on threads, whose period depends on its frequency
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)


class TimedFrequency(NamedTuple):
    """A natural frequency squared with its standard uncertainty, the mean period of small swings, and findings."""

    natural_frequency_squared_s2: float
    std_s2: float
    period_s: float
    findings: tuple[Finding, ...]


def timed_frequency(record: PeriodRecord, threads: Threads = NO_THREADS) -> TimedFrequency:
    """Return the natural frequency squared of a record of periods, for a body that `threads` may carry.

    The standard uncertainty of the times is the stated one, or that of their scatter. Raises DataError where neither
    is known.
    """
    count, stated = len(record.duration_s), record.std_s is not None
    if not stated and count < _FEWEST:
        raise DataError(
            f"{record.path}: {counted(count, 'time')} without a standard uncertainty: time {_FEWEST} swings or more, "
            "or add a column std_s (0.2 s for a hand with a stopwatch)."
        )
    duration_std = np.ones(count) if record.std_s is None else record.std_s
    frequency, amplitude = 0.0, record.amplitude_rad
    for _ in range(_ROUNDS):
        longer = 1.0 if amplitude is None else period_ratio(amplitude, threads, frequency)
        period = record.duration_s / (record.periods * longer)
        period_std = duration_std / (record.periods * longer)
        weight = period_std**-2.0
        mean = float(weight @ period / weight.sum())
        frequency = (2 * math.pi / mean) ** 2
    least = float(weight.sum()) ** -0.5
    squares = float(weight @ (period - mean) ** 2)
    scattered = widened(least * math.sqrt(squares / (count - 1)), count - 1) if count > 1 else least
    findings = []
    std = scattered
    if stated:
        too_much = count > 1 and squares > chi2.ppf(_SURE, count - 1)
        std = scattered if too_much else least
        if too_much:
            text = (
                f"the periods scatter by {math.sqrt(squares / (count - 1)):.2g} times their stated standard "
                "uncertainty: their scatter counts. Was a period missed, or the amplitude another one?"
            )
            findings.append(warning("swing-periods-scatter", text, "swing.*"))
    correction, amplitude_std, assumed = _of_amplitude(record, threads, frequency, weight)
    corrected = float(frequency * (1 + correction))
    relative = math.hypot(2 * std / mean, amplitude_std)
    return TimedFrequency(corrected, relative * corrected, mean, (*findings, *assumed))


def _of_amplitude(
    record: PeriodRecord, threads: Threads, frequency: float, weight: Array
) -> tuple[float, float, tuple[Finding, ...]]:
    """Return what amplitudes add to the natural frequency squared and leave uncertain of it, relative, and findings.

    An eye that reads amplitudes is wrong in the same way each time.
    """
    keys = ("swing.natural_frequency_squared_s2", "swing.axis_inertia_kg_m2", "inertia.*")
    if record.amplitude_rad is None:
        share = float(period_ratio([math.radians(_UNSTATED_DEG)], threads, frequency)[0]) ** 2 - 1
        # Of the square of an amplitude that lies anywhere between zero and its limit.
        mean, std = share / 3, share * math.sqrt(1 / 5 - 1 / 9)
        text = (
            f"no amplitude is stated: one between 0 and {_UNSTATED_DEG:g} degrees is assumed, which leaves the natural "
            f"frequency squared uncertain by {100 * std:.2g} %. Add a column amplitude_deg."
        )
        return mean, std, (warning("swing-amplitude-assumed", text, *keys),)
    if record.amplitude_std_rad is None:
        return 0.0, 0.0, (taken_as_exact("amplitude", *keys),)
    farther = period_ratio(record.amplitude_rad + record.amplitude_std_rad, threads, frequency)
    change = farther / period_ratio(record.amplitude_rad, threads, frequency) - 1
    return 0.0, 2 * float(weight @ change / weight.sum()), ()


def period_ratio(amplitude_rad: Array | Sequence[float], threads: Threads, frequency_s2: float) -> Array:
    """Return periods at amplitudes (n,) relative to that of small swings.

    Energy gives the speed at each angle; angles are A sin(theta), which makes the integrand smooth.
    """
    amplitude = np.maximum(np.asarray(amplitude_rad, dtype=float), _LEAST_RAD)[:, np.newaxis]
    theta = math.pi / 4 * (_NODES + 1)
    angle = amplitude * np.sin(theta)
    height, top = _height(angle, threads), _height(amplitude, threads)
    pull = np.sin(angle) / np.sqrt(1 - 2 * threads.ratio * (1 - np.cos(angle)))
    carried = 1 + frequency_s2 * threads.fall_s2 * pull**2
    quarter = np.sqrt(carried / (2 * (top - height))) * amplitude * np.cos(theta)
    return np.asarray(quarter @ _WEIGHTS) / 2


def _height(angle: Array, threads: Threads) -> Array:
    """Return the potential energy at angles, of which sin(phi) / s is the slope, with s the threads' height."""
    fall = 2 * np.sin(angle / 2) ** 2
    if threads.ratio == 0:
        return fall
    return np.asarray((1 - np.sqrt(1 - 2 * threads.ratio * fall)) / threads.ratio)
