"""Whiten an equation's errors: remove what their own past predicts, so that the rest is independent of the commands.

What a rotor's command does not explain, such as wind, vibration and the sensors' noise, is autocorrelated and, through
the autopilot, correlated with later commands. An autoregression in each equation removes the part that its past
predicts; what remains is independent of everything before, and so of the effects of the commands (L. Ljung, System
Identification, 2nd ed., 1999, sections 7.3 and 13.4: the direct method in a closed loop).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from cfid.estimate.linear import gain_of
from cfid.flight.model import FlightEquation

Array = npt.NDArray[np.float64]

PAST = 16  # rows that predict the next: 0.16 s


@dataclass(frozen=True, eq=False)
class White:
    """A filter that removes an equation's other terms and its errors' predictable part, and scales to unit variance."""

    filter: Array
    lengths: tuple[int, ...]
    basis: Array  # (k, q), an orthonormal basis of the whitened other terms
    shares: Array  # (q, k), maps whitened errors to the coefficients of the other terms
    size: float

    def of(self, columns: Array) -> Array:
        """Return columns (n, p) whitened, without each segment's first rows and without what other terms explain."""
        white = _filtered(columns, self.filter, self.lengths)
        return np.asarray((white - self.basis @ (self.basis.T @ white)) / self.size)

    def others_in(self, errors: Array) -> Array:
        """Return the coefficients (q,) of the equation's other terms in its errors (n,)."""
        return np.asarray(self.shares @ _filtered(errors[:, np.newaxis], self.filter, self.lengths)[:, 0])


def whitening(block: FlightEquation, left: Array, *, fed_back: bool = False, rows: int = PAST) -> White:
    """Return the filter that whitens an equation whose errors (n,) are `left`, from this many `rows` before each.

    Where an autopilot responds to errors (`fed_back`), past errors count as other terms: the effects of the commands
    and the autocorrelation of the errors are then found together, and the uncertainty of each contains that of the
    other.
    """
    parts = _parts(left, block.lengths)
    past = np.concatenate(
        [np.column_stack([part[rows - k - 1 : len(part) - k - 1] for k in range(rows)]) for part in parts]
    )
    now = np.concatenate([part[rows:] for part in parts])
    coefficients = np.concatenate([[1.0], -(gain_of(past) @ now)])
    others = _filtered(block.others, coefficients, block.lengths)
    taken = np.column_stack([others, past]) if fed_back else others
    basis = np.linalg.qr(taken / np.maximum(np.linalg.norm(taken, axis=0), 1e-300))[0]
    white = _filtered(left[:, np.newaxis], coefficients, block.lengths)[:, 0]
    return White(coefficients, block.lengths, basis, gain_of(others), max(float(np.std(white)), 1e-12))


def without(values: Array, others: Array) -> Array:
    """Return values (n,) without what other terms (n, q) explain."""
    return np.asarray(values - others @ (gain_of(others) @ values))


def _filtered(columns: Array, coefficients: Array, lengths: Sequence[int]) -> Array:
    rows = len(coefficients) - 1
    return np.concatenate([lfilter(coefficients, [1.0], part, axis=0)[rows:] for part in _parts(columns, lengths)])


def _parts(columns: Array, lengths: Sequence[int]) -> list[Array]:
    return np.split(columns, np.cumsum(lengths)[:-1])
