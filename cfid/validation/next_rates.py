"""Judge moments and lags by how well parameter sets predict the next row of the rates from the rows before.

Over a longer time, rates accumulate effects that no set contains, mainly of air, to which the autopilot responds:
commands then counteract it, and moments that are too large have smaller errors than the true ones. One row ahead, given
the errors before, what remains happened after the commands, and only the true set minimises it: by this condition, `fit
flight` finds moments (docs/decisions/0022).
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

    The part that the errors of the 16 rows before predict is removed, and so are the effects of damping, gyroscopic
    torque and the like, which are fitted for every set. Parts are consecutive and of equal length.
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
