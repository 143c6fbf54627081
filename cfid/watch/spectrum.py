"""Computes the spectrum of a load cell's newest samples, and finds the lines in it that move with the rotors."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.motors.vibration.estimation import EVIDENCE_LIMIT, PLAUSIBLE_RAD_PER_S, aliased, rotor_comb
from cfid.motors.vibration.spectrum import Spectrum, spectrum

Array = npt.NDArray[np.float64]

LENGTH_S = 0.5  # resolves 2 Hz, and follows a staircase
HIGHEST_HZ = 1500.0  # blade pass of the fastest rotors of a Crazyflie

_FEWEST = 64
_BLADES, _MOST_ROTORS = 2, 4
_LOBE = 3.0  # resolutions to each side of a line that belong to it
_CLEAR = 8.0  # evidence of a line that is worth a label, as for a fit


class Line(NamedTuple):
    """A line of a rotor: its frequency, its height in N and what it is."""

    frequency_hz: float
    force_n: float
    label: str


class RotorLines(NamedTuple):
    """Amplitudes (m,) of the force in N at frequencies (m,), all axes together, and the rotors' lines in them."""

    frequency_hz: Array
    force_n: Array
    rotors: tuple[Line, ...]


def spectrum_of(time_s: Array, force_n: Array) -> RotorLines | None:
    """Return the spectrum of samples (n,), (n, 3) and the rotors' lines; None where they are too few or uneven.

    Rotors are found one after another: the lines of the most evident rotor are removed before the next is sought.
    """
    if len(time_s) < _FEWEST or not np.isfinite(force_n).all():
        return None
    interval_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if interval_s <= 0 or float(np.median(np.diff(time_s))) < 0.5 * interval_s:  # a gap
        return None
    seen = spectrum(signal=force_n, interval_s=interval_s, length_s=LENGTH_S)
    shown = seen.frequency_hz <= HIGHEST_HZ
    height = np.sqrt(np.sum(seen.amplitude**2, axis=1))
    return RotorLines(seen.frequency_hz[shown], height[shown], tuple(_rotor_lines(seen, height)))


def _rotor_lines(seen: Spectrum, height: Array) -> list[Line]:
    if aliased(0.5 / float(seen.frequency_hz[-1]), _BLADES, PLAUSIBLE_RAD_PER_S[1]):
        return []  # blade pass may be folded to any frequency
    comb, found = rotor_comb(_BLADES), list[Line]()
    try:
        grid = comb.candidates(seen, PLAUSIBLE_RAD_PER_S)
    except FitError:  # sampled too slowly for any rotor
        return []
    for _ in range(_MOST_ROTORS):
        evidence = comb.lines(seen, grid)
        score = comb.score(evidence)
        best = int(score.argmax())
        if score[best] < EVIDENCE_LIMIT:
            break
        turning_hz = grid[best] / (2 * math.pi)
        for harmonic, clear in zip(comb.harmonics, evidence[:, best], strict=True):
            if clear > _CLEAR:
                place = int(np.abs(seen.frequency_hz - harmonic * turning_hz).argmin())
                found.append(Line(float(seen.frequency_hz[place]), float(height[place]), _label(harmonic)))
        seen = _without(seen, [harmonic * turning_hz for harmonic in comb.harmonics])
    return found


def _label(harmonic: int) -> str:
    return {1: "rotor", _BLADES: "blade pass"}.get(harmonic, f"rotor × {harmonic}")


def _without(seen: Spectrum, lines_hz: list[float]) -> Spectrum:
    """Return a spectrum with only noise at some lines."""
    amplitude = seen.amplitude.copy()
    for line_hz in lines_hz:
        near = np.abs(seen.frequency_hz - line_hz) < _LOBE / seen.length_s
        amplitude[near] = seen.floor[near]
    return seen._replace(amplitude=amplitude)
