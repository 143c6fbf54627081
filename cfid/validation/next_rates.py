"""How well parameter sets foretell the next row of the rates, given the rows before: what judges moments and lags.

Over a longer time rates add up what no set contains, air above all, to which the autopilot answers: commands then go
against it, and moments that are too large err by less than the true ones. One row ahead, given the errors before, what
is left happened after the commands, and no set but the true one makes it smallest: the condition by which `fit flight`
finds moments (docs/decisions/0022).
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.flight.likelihood import whitening, without
from cfid.flight.model import turning_equation
from cfid.flight.rows import AXES, LEVER, ROW_S, Flight
from cfid.validation.rollout import ParameterSet, late_drives, thrusts_of

Array = npt.NDArray[np.float64]


def next_rate_errors(flight: Flight, one: ParameterSet, axes: Sequence[str], *, parts: int) -> Array:
    """Return the root mean square errors (parts,) of the rates' next row about some axes, in rad/s.

    Taken from them is what the errors of 16 rows before foretell, and what damping, gyroscopic torque and the like do,
    which are fitted for every set. Parts are as long as each other, one after the other.
    """
    levers = dict(zip(AXES, (LEVER * one.arm_m, LEVER * one.arm_m, one.torque_m), strict=True))
    late, thrusts = late_drives(flight, one), thrusts_of(flight, one)
    squares = []
    for axis in axes:
        place = AXES.index(axis)
        block = turning_equation(flight, np.stack([thrusts, late, late**2]), place)
        error = block.shown - levers[axis] / one.moments_kg_m2[place] * block.terms[:, 0]
        white = whitening(block, without(error, block.others), fed_back=True)
        squares.append((ROW_S * white.size * white.of(error[:, np.newaxis])[:, 0]) ** 2)
    return np.array([np.sqrt(np.mean(part)) for part in np.array_split(np.sum(squares, axis=0), parts)])
