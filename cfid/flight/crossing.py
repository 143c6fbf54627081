"""Find which torque turns the vehicle about which axis: this shows rotated axes and swapped motors."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of, sandwich, std_of
from cfid.flight.equations import THRUST, TURNS
from cfid.flight.likelihood import whitening, without
from cfid.flight.model import FlightEquation
from cfid.flight.rows import AXES

Array = npt.NDArray[np.float64]

_SIGNIFICANT = 4.0  # standard uncertainties
_CROSSED = 0.2  # of the largest gain: public logs have 0.04 at most, axes rotated by 12 degrees have 0.2
# The least gain of the other axis's torque relative to that of the axis's own torque after a quarter turn; after an
# eighth of a turn, both are equal.
_MOSTLY = 2.0
_YAW = 2
_OTHER_NUMBERS = "motors have other numbers than front right, rear right, rear left, front left"


class Crossing(NamedTuple):
    """Gains (3, 3) from torques about roll, pitch and yaw (columns) to rates (rows), and their standard uncertainties.

    They are in the units of `FlightFit.values[TURNS]`.
    """

    gains: Array
    std: Array

    def fault(self) -> str | None:
        """Return the likely error in axes or motors if a torque turns the vehicle about another axis, else None."""
        largest = float(np.max(np.abs(self.gains[:_YAW, :_YAW])))
        foreign = (np.abs(self.gains) > _CROSSED * largest) & (np.abs(self.gains) > _SIGNIFICANT * self.std)
        if foreign[:_YAW, _YAW].any():
            return _OTHER_NUMBERS
        plane = self.gains[:_YAW, :_YAW]
        if not (foreign[0, 1] and foreign[1, 0]):
            return None
        if np.linalg.det(plane) < 0:
            return "the rates about roll and pitch are exchanged, or motors have other numbers"
        if self.gains[_YAW, _YAW] < -_SIGNIFICANT * self.std[_YAW, _YAW]:  # as no rotation about the vertical makes it
            return _OTHER_NUMBERS
        turned = round(math.degrees(math.atan2(plane[1, 0] - plane[0, 1], plane[0, 0] + plane[1, 1])), -1)
        return (
            f"the gyro's axes are turned by about {turned:.0f} degrees about the vertical, or motors have other numbers"
        )

    @property
    def a_quarter(self) -> bool:
        """Whether roll torque turns the vehicle about pitch and pitch torque about roll, as after a quarter turn.

        A fit, in which each torque acts about its own axis, then never converges.
        """
        own, other = (np.abs([self.gains[0, place], self.gains[1, 1 - place]]) for place in (0, 1))
        return (
            bool(np.all(other > _MOSTLY * own)) and self.gains[0, 1] * self.gains[1, 0] < 0 and self.fault() is not None
        )


def crossing_of(blocks: Sequence[FlightEquation], values: Array) -> Crossing:
    """Fit the gains of all torques about each axis, with the lags and delays in `values` (10,)."""
    gains, stds = np.zeros((len(AXES), len(AXES))), np.full((len(AXES), len(AXES)), np.inf)
    turning = [[block for block in blocks if block.axis == axis] for axis in range(len(AXES))]
    torques = [[block.terms @ values[THRUST] for block in of_axis] for of_axis in turning]
    for axis, of_axis in enumerate(turning):
        rows, shown = [], []
        for place, block in enumerate(of_axis):
            left = without(block.shown - values[TURNS][axis] * torques[axis][place], block.others)
            white = whitening(block, left, fed_back=True)
            rows.append(white.of(np.column_stack([each[place] for each in torques])))
            shown.append(white.of(block.shown[:, np.newaxis])[:, 0])
        of_all, data = np.concatenate(rows), np.concatenate(shown)
        gains[axis] = gain_of(of_all) @ data
        longest = max(len(data) // (8 * len(of_axis)), 10)
        stds[axis] = std_of(sandwich(of_all, data - of_all @ gains[axis], longest=longest))
    return Crossing(gains, stds)
