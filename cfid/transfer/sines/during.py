"""Estimate from sums how clearly a load cell measures a sine, and notice during the recording that it does not."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

CLEAR = 5.0  # standard uncertainties of an amplitude

_FZ = 3  # column of a load cell's rows, after `t`
_SETTLED_S = 0.3  # after the first report, the time until rotors follow
_PERIODS, _LEAST_S = 2.0, 2.0  # the part of the sine that is evaluated


class SineSums:
    """Sums for the least squares of a constant and a sine of known frequency, sample by sample."""

    def __init__(self) -> None:
        """Start without samples."""
        self._normal, self._right = np.zeros((3, 3)), np.zeros(3)
        self._squares, self._count = 0.0, 0

    def add(self, phase_rad: Array, force_n: Array) -> None:
        """Add forces (n,) at phases (n,) of the sine."""
        columns = np.stack([np.ones_like(phase_rad), np.cos(phase_rad), np.sin(phase_rad)], axis=1)
        self._normal += columns.T @ columns
        self._right += columns.T @ force_n
        self._squares += float(force_n @ force_n)
        self._count += len(force_n)

    def amplitude(self) -> tuple[float, float]:
        """Return the amplitude and its standard uncertainty in white noise."""
        found = np.linalg.lstsq(self._normal, self._right, rcond=None)[0]
        variance = max(self._squares - float(found @ self._right), 0.0) / self._count
        return float(np.hypot(found[1], found[2])), float(np.sqrt(2 * variance / self._count))


class Felt:
    """Evaluate the first periods of a sine, from its first report on; report at most once."""

    def __init__(self, frequency_rad_s: float, counts_per_n: float) -> None:
        """Set the sine's frequency, 0 for a constant command, and the load cell's scale."""
        self._frequency_rad_s, self._counts_per_n = frequency_rad_s, counts_per_n
        self._begin_s: float | None = None
        self._sums, self._bias = SineSums(), 0.0
        self._done = not frequency_rad_s
        self._lasts_s = max(_LEAST_S, _PERIODS * 2 * np.pi / frequency_rad_s) if frequency_rad_s else 0.0

    def __call__(self, device: str, columns: Sequence[Any]) -> str:
        """Add new rows of the crossings or the load cell; return what is wrong, "" for nothing."""
        if self._done:
            return ""
        if device == "crossings" and self._begin_s is None:
            self._begin_s = float(columns[0][0]) + _SETTLED_S
        if device != "loadcell":
            return ""
        time_s, force_n = np.asarray(columns[0]), np.asarray(columns[_FZ]) / self._counts_per_n
        if self._begin_s is None:
            self._bias = float(force_n.mean())
            return ""
        kept = time_s >= self._begin_s
        if kept.any():  # the bias is subtracted to keep the squares precise
            self._sums.add(self._frequency_rad_s * (time_s[kept] - self._begin_s), force_n[kept] - self._bias)
        if time_s[-1] < self._begin_s + self._lasts_s:
            return ""
        self._done = True
        amplitude_n, std_n = self._sums.amplitude()
        return "" if amplitude_n >= CLEAR * std_n else not_felt(amplitude_n, std_n)


def not_felt(amplitude_n: float, std_n: float) -> str:
    """Return the sentence about a sine that the load cell does not measure."""
    return (
        f"the load cell does not feel it: {1e3 * amplitude_n:.2g} mN at its frequency, noise {1e3 * std_n:.2g} mN. "
        "Is it this motor's channel? A larger amplitude or a slower sine is felt."
    )
