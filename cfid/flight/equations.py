"""Combine the equations of flights: their residuals over lag, delays, thrust and moments, and the slopes of these.

Parameters (10,) are two time constants and two delays in s, thrust over mass in powers of the drive, and lever times
mass over moment about each axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.flight.likelihood import White, whitening, without
from cfid.flight.model import EquationsOf, FlightEquation, ThrustLag
from cfid.flight.rows import AXES

Array = npt.NDArray[np.float64]

DELAY_S = 0.008  # the initial value
_SHARES = (1.0, 0.5, 0.25)  # of a round's step, tried where it reverses the last one
LAGS, DELAYS, THRUST, TURNS = slice(0, 2), slice(2, 4), slice(4, 7), slice(7, 10)  # of the parameters
_STEP = 1e-3  # the relative change of a time constant or delay over which a slope is taken


@dataclass(frozen=True, eq=False)
class Equations:
    """The equations of flights, whose residuals are whitened."""

    each: Sequence[EquationsOf]
    white: tuple[White, ...] = ()
    of_command: float = 0.0  # the share of the delays that applies to the command alone, not to the battery's voltage
    # The share of an unknown accelerometer's delay relative to the gyro that is not due to a filter.
    unfiltered: float = 0.0

    def whitened(self, p: Array) -> "Equations":
        """Return the equations with the filters that whiten the errors of parameters (10,)."""
        white = [whitening(block, _left(block, p), fed_back=True) for block in self.at(p)]
        return replace(self, white=tuple(white))

    def likeliest(self, p: Array, step: Array) -> float:
        """Return the share of a step (10,) from parameters (10,) after which the whitened errors are most likely.

        The likelihood is that of normal errors with the best-fitting sizes and autoregression.
        """
        sizes = [[math.log(one.size) for one in self.whitened(p + share * step).white] for share in _SHARES]
        rows = [len(one.basis) for one in self.white]
        return _SHARES[int(np.argmin(np.array(sizes) @ rows))]

    def at(self, p: Array) -> list[FlightEquation]:
        """Return the equations at the time constants and delays of parameters (10,)."""
        rising_s, falling_s, of_force_s, of_rates_s = map(float, p[: DELAYS.stop])
        lag, delays_s = ThrustLag(rising_s, falling_s), (of_force_s, of_rates_s)
        return [one for equations in self.each for one in equations(lag, delays_s, self.of_command, self.unfiltered)]

    def residual(self, p: Array) -> Array:
        """Return the whitened errors (n,) of parameters (10,)."""
        each = zip(self.at(p), self.white, strict=True)
        return np.concatenate([one.of((block.shown - fitted_in(block, p))[:, np.newaxis])[:, 0] for block, one in each])

    def jacobian(self, p: Array) -> Array:
        """Return the slopes (n, 10) of the whitened errors over the parameters."""
        blocks, columns = self.at(p), []
        for place in range(DELAYS.stop):
            ahead = p.copy()
            step = _STEP * max(abs(float(p[place])), DELAY_S)
            ahead[place] += step
            moved = zip(self.at(ahead), blocks, strict=True)
            columns.append([-(fitted_in(one, p) - fitted_in(block, p)) / step for one, block in moved])
        each = []
        for place, (block, white) in enumerate(zip(blocks, self.white, strict=True)):
            gains, turned = np.ones(3), np.zeros((len(block.shown), len(AXES)))
            if block.axis is not None:
                gains = np.full(3, p[TURNS][block.axis])
                turned[:, block.axis] = -(block.terms @ p[THRUST])
            slow = [column[place] for column in columns]
            each.append(white.of(np.column_stack([*slow, -block.terms * gains, turned])))
        return np.concatenate(each)


def fitted_in(block: FlightEquation, p: Array) -> Array:
    """Return the rotors' contribution (k,) to an equation."""
    gain = 1.0 if block.axis is None else float(p[TURNS][block.axis])
    return np.asarray(gain * (block.terms @ p[THRUST]))


def _left(block: FlightEquation, p: Array) -> Array:
    """Return an equation's errors (k,), before they are whitened."""
    return without(block.shown - fitted_in(block, p), block.others)
