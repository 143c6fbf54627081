"""Fit the drag of flights whose velocity is known: how fast air slows the vehicle along the axes across the thrust."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import sandwich
from cfid.estimate.signals import block_means
from cfid.flight.model import FlightEquation, whitened_fit, without
from cfid.flight.rows import ROW_S, Flight, segments

Array = npt.NDArray[np.float64]

_SHORTEST_S = 5.0  # of all flights together
_MEAN_ROWS = 10
# The number of means that predict the next one. With 16, as for rows, they took up a tenth of a flight's 150 means, and
# intervals were too narrow.
_PAST_MEANS = 1
_FEWEST_MEANS = 32  # in a segment
LEAST_SPEED_MPS = 0.3  # root mean square along an axis
LEAST_EXPLAINED = 0.8  # of the horizontal specific force: else wind or a tilted sensor decides


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisDrag:
    """How fast air slows the vehicle along one axis, in 1/s, with its standard uncertainty and the part explained.

    `explained` is the part of the force's variance that drag explains, and `speed` is the root mean square of the
    velocity's changes in m/s. `velocity` and `force` (n,) are the data that were compared.
    """

    rate: float
    std: float
    explained: float
    speed: float
    velocity: Array
    force: Array

    @property
    def excited(self) -> bool:
        """Whether the vehicle moved enough along the axis, and drag explains the force."""
        return self.speed >= LEAST_SPEED_MPS and self.explained >= LEAST_EXPLAINED


def fit_drag(flights: Sequence[Flight], *, axis: int) -> AxisDrag | None:
    """Fit specific force = -rate * velocity + a constant of each flight along an axis across the thrust, 0 or 1.

    A share of the force along z is a further term, because a tilted accelerometer shows that much of the thrust. The
    fit compares means over 0.1 s, in which the fast noise of a velocity hardly counts as motion. Returns None where
    less than 5 s have a velocity.
    """
    blocks = [
        block for flight in flights if flight.velocity is not None if (block := _block(flight, flight.velocity, axis))
    ]
    if ROW_S * _MEAN_ROWS * sum(len(block.shown) for block in blocks) < _SHORTEST_S:
        return None
    white = whitened_fit(blocks, past=_PAST_MEANS)
    covariance = sandwich(white.rows, white.errors, longest=len(white.errors) // (8 * len(blocks)))
    rate = float(white.values[0])
    velocity = np.concatenate([-without(block.terms[:, 0], block.others) for block in blocks])
    force = np.concatenate([without(block.shown, block.others) for block in blocks])
    return AxisDrag(
        rate=rate,
        std=math.sqrt(float(covariance[0, 0])),
        explained=float(1 - np.var(force + rate * velocity) / np.var(force)),
        speed=float(np.std(velocity)),
        velocity=velocity,
        force=force,
    )


def _block(flight: Flight, velocity: Array, axis: int) -> FlightEquation | None:
    """Return the equation of those segments of a flight that are long enough for the noise model."""
    columns = np.column_stack([-velocity[:, axis], np.ones(len(velocity)), flight.force[:, 2], flight.force[:, axis]])
    parts = [
        block_means(columns[part].T, length=_MEAN_ROWS).T
        for part in segments(flight.airborne, fewest=_FEWEST_MEANS * _MEAN_ROWS)
    ]
    if not parts:
        return None
    means = np.concatenate(parts)
    return FlightEquation(axis, means[:, 3], means[:, :1], means[:, 1:3], tuple(map(len, parts)))
