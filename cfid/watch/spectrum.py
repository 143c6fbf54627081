"""Computes the spectrum of a load cell's newest samples, and finds the lines in it that move with the rotors."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.motors.vibration.estimation import (
    EVIDENCE_LIMIT,
    FEWEST,
    PLAUSIBLE_RAD_PER_S,
    aliased,
    clear_lines,
    rotor_comb,
)
from cfid.motors.vibration.spectrum import Spectrum, spectrum

Array = npt.NDArray[np.float64]

LENGTH_S = 0.5  # resolves 2 Hz, and follows a staircase
HIGHEST_HZ = 1500.0  # blade pass of the fastest rotors of a Crazyflie

_BLADES, _MOST_ROTORS = 2, 4
_LOBE = 3.0  # resolutions to each side of a line that belong to it


class RotorLines(NamedTuple):
    """Amplitudes (m,) of the force at frequencies (m,), all axes together, and the rotors' lines in them.

    Each of the latter is its frequency, its height and what it is.
    """

    frequency_hz: Array
    height: Array
    rotors: list[tuple[float, float, str]]


def spectrum_of(time_s: Array, force: Array) -> RotorLines | None:
    """Return the spectrum of the newest of samples (n,), (n, 3) in their own unit, and the rotors' lines.

    Returns None where the samples are too few, or have a gap.
    """
    newest = time_s > time_s[-1:] - LENGTH_S
    time_s, force = time_s[newest], force[newest]
    if len(time_s) < FEWEST or not np.isfinite(force).all():
        return None
    interval_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if float(np.median(np.diff(time_s))) < 0.5 * interval_s:
        return None
    seen = spectrum(signal=force, interval_s=interval_s, length_s=LENGTH_S)
    shown = seen.frequency_hz <= HIGHEST_HZ
    height = np.sqrt(np.sum(seen.amplitude**2, axis=1))
    folded = aliased(interval_s, _BLADES, PLAUSIBLE_RAD_PER_S[1])  # to any frequency
    return RotorLines(seen.frequency_hz[shown], height[shown], [] if folded else _rotor_lines(seen, height))


def _rotor_lines(seen: Spectrum, height: Array) -> list[tuple[float, float, str]]:
    """Find rotors one after another: the lines of the most evident one are removed before the next is sought."""
    comb, lines = rotor_comb(_BLADES), list[tuple[float, float, str]]()
    grid = comb.candidates(seen, PLAUSIBLE_RAD_PER_S)
    for _ in range(_MOST_ROTORS):
        evidence = comb.lines(seen, grid)
        score = comb.score(evidence)
        best = int(score.argmax())
        if score[best] < EVIDENCE_LIMIT:
            break
        turning_hz = grid[best] / (2 * math.pi)
        for harmonic in clear_lines(comb, evidence[:, best]):
            place = int(np.abs(seen.frequency_hz - harmonic * turning_hz).argmin())
            label = {1: "rotor", _BLADES: "blade pass"}.get(harmonic, f"rotor × {harmonic}")
            lines.append((float(seen.frequency_hz[place]), float(height[place]), label))
        amplitude = seen.amplitude.copy()
        for harmonic in comb.harmonics:
            near = np.abs(seen.frequency_hz - harmonic * turning_hz) < _LOBE / seen.length_s
            amplitude[near] = seen.floor[near]
        seen = seen._replace(amplitude=amplitude)
    return lines
