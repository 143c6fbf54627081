"""Drag of flights whose velocity is known: how fast air brakes along the axes across the thrust."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.blocks import block_means
from cfid.estimate.linear import gain_of, sandwich
from cfid.flight.likelihood import whitening, without
from cfid.flight.model import Flight, FlightEquation, segments

Array = npt.NDArray[np.float64]

_ROUNDS = 3  # in which noise and drag are estimated in turn
_FEWEST = 500  # rows: 5 s
_SMOOTH = 10  # rows over which noise is averaged before judging how much is explained


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisDrag:
    """How fast air brakes along one axis, in 1/s, with its standard uncertainty, and the part that it explains.

    `speed` is the root mean square of the velocity's changes in m/s. `velocity` and `force` (n,) are what was compared.
    """

    rate: float
    std: float
    explained: float
    speed: float
    velocity: Array
    force: Array


def fit_drag(flights: Sequence[Flight], *, axis: int) -> AxisDrag | None:
    """Fit specific force = -rate * velocity + a constant of each flight along an axis across the thrust, 0 or 1.

    A share of the force along z is a term beside: a tilted accelerometer shows that much of the thrust. Returns None
    where less than 5 s have a velocity.
    """
    blocks = []
    for flight in flights:
        parts = [] if flight.velocity is None else segments(flight.airborne)
        if flight.velocity is None or not parts:
            continue
        at = np.concatenate([np.arange(one.start, one.stop) for one in parts])
        lengths = tuple(one.stop - one.start for one in parts)
        terms = -flight.velocity[at, axis : axis + 1]
        others = np.column_stack([np.ones(len(at)), flight.force[at, 2]])
        blocks.append(FlightEquation(axis, flight.force[at, axis], terms, others, lengths))
    if sum(map(len, (block.shown for block in blocks))) < _FEWEST:
        return None
    found = np.zeros(1)
    rows, shown = np.zeros((0, 1)), np.zeros(0)
    for _ in range(_ROUNDS):
        each = []
        for block in blocks:
            left = without(block.shown - block.terms @ found, block.others)
            white = whitening(block, left)
            each.append((white.of(block.terms), white.of(block.shown[:, np.newaxis])[:, 0]))
        rows, shown = np.concatenate([one[0] for one in each]), np.concatenate([one[1] for one in each])
        found = gain_of(rows) @ shown
    covariance = sandwich(rows, shown - rows @ found, longest=len(shown) // (8 * len(blocks)))
    velocity = np.concatenate([-without(block.terms[:, 0], block.others) for block in blocks])
    force = np.concatenate([without(block.shown, block.others) for block in blocks])
    slow = [block_means(values, length=_SMOOTH) for values in (force + found[0] * velocity, force)]
    return AxisDrag(
        rate=float(found[0]),
        std=math.sqrt(float(covariance[0, 0])),
        explained=float(1 - np.var(slow[0]) / np.var(slow[1])),
        speed=float(np.std(velocity)),
        velocity=velocity,
        force=force,
    )
