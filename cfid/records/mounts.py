"""How a body is fixed to the swing: its frame, mounts and threads, as tables of rig.toml."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, model_validator

from cfid.records.facts import Number, Positive, RigTable, Spread
from cfid.units import MM

Vector = tuple[Number, Number, Number]
BodyAxis = Literal["x", "-x", "y", "-y", "z", "-z"]


def _non_zero(vector: Vector) -> Vector:
    if not math.hypot(*vector) > 0:
        raise ValueError("a direction needs a length above zero")
    return vector


Direction = Annotated[Vector, AfterValidator(_non_zero)]
SpreadVector = tuple[Spread, Spread, Spread]


class BodyFrame(RigTable):
    """Which body axes point forward, left and up."""

    forward: BodyAxis = "x"
    left: BodyAxis = "y"
    up: BodyAxis = "z"

    @model_validator(mode="after")
    def _right_handed(self) -> Self:
        forward, left, up = (_unit(axis) for axis in (self.forward, self.left, self.up))
        cross = (
            forward[1] * left[2] - forward[2] * left[1],
            forward[2] * left[0] - forward[0] * left[2],
            forward[0] * left[1] - forward[1] * left[0],
        )
        if cross != up:
            raise ValueError("forward, left and up must be three axes of a right-handed frame")
        return self

    def turned(self, vector: Sequence[float]) -> Vector:
        """Return the forward, left and up components of a vector (3,) of the body frame, without rounding."""
        forward, left, up = (
            (-1 if axis.startswith("-") else 1) * vector["xyz".index(axis[-1])] + 0.0
            for axis in (self.forward, self.left, self.up)
        )
        return forward, left, up


def _unit(axis: BodyAxis) -> tuple[int, int, int]:
    sign = -1 if axis.startswith("-") else 1
    x, y, z = (sign * int(axis[-1] == name) for name in "xyz")
    return x, y, z


class ThreadPair(RigTable):
    """Two threads of equal length that a body hangs on: their distance from each other above and below, and the length.

    The vertical through the centre of mass passes midway between the threads, above and below, except for an error
    along the line that joins them, of standard uncertainty `centre_std_mm`.
    """

    above_mm: Positive
    above_std_mm: Spread = 0.0
    below_mm: Positive
    below_std_mm: Spread = 0.0
    length_mm: Positive
    length_std_mm: Spread = 0.0
    centre_std_mm: Spread = 1.0

    @model_validator(mode="after")
    def _long_enough(self) -> Self:
        if self.length_mm <= abs(self.above_mm - self.below_mm) / 2:
            raise ValueError("threads of this length do not reach from above_mm to below_mm")
        if self.centre_std_mm > self.below_mm / 8:
            raise ValueError("centre_std_mm is more than an eighth of below_mm: balance the body between the threads")
        return self

    @property
    def lengths_m(self) -> tuple[Vector, Vector]:
        """Both distances and the length, and their standard uncertainties."""
        values = MM * self.above_mm, MM * self.below_mm, MM * self.length_mm
        return values, (MM * self.above_std_mm, MM * self.below_std_mm, MM * self.length_std_mm)

    @property
    def off_centre(self) -> tuple[float, float]:
        """The relative loss of the threads' torque, as the one nearer the centre of mass carries more: mean and std.

        The torque is proportional to x y, with lower ends at the distances x and y from the centre. A body centred
        between them has a quarter of the square of their distance instead. The mean is over the error of the centre,
        to either side.
        """
        mean = (2 * self.centre_std_mm / self.below_mm) ** 2
        return mean, math.sqrt(2) * mean


class Mount(RigTable):
    """One way of fixing a body to the swing's axis: a point on the axis and its direction.

    With `threads` the body hangs on two threads instead and turns about the vertical: `direction` is then that of the
    vertical through the centre of mass, and no point is needed.

    The thesis measures the distance of its xy mount along a different direction (C.1.7) from the one that it uses for
    the tensor (C.1.4), so `distance_direction` may differ; it defaults to `direction`. `point_yaw_deg` turns the
    frame in which the point was measured about z, so that numbers read along an arm can be entered as read.
    """

    point_mm: Vector = (0.0, 0.0, 0.0)
    point_std_mm: SpreadVector = (0.0, 0.0, 0.0)
    point_yaw_deg: Number = 0.0
    direction: Direction
    direction_std_deg: Spread = 0.0
    distance_direction: Direction | None = None
    threads: ThreadPair | None = None

    @model_validator(mode="after")
    def _hangs_somewhere(self) -> Self:
        if self.threads is None and "point_mm" not in self.model_fields_set:
            raise ValueError("point_mm is required: a point on the axis, or threads that the body hangs on")
        return self

    @property
    def point_m(self) -> Vector:
        """The point in the body frame, turned back from the frame it was measured in."""
        return self._turned(self.point_mm)

    @property
    def point_axes(self) -> tuple[Vector, Vector, Vector]:
        """The unit vectors, in the body frame, along which the point's three numbers were measured."""
        return self._turned((1e3, 0, 0)), self._turned((0, 1e3, 0)), self._turned((0, 0, 1e3))

    def _turned(self, vector_mm: Vector) -> Vector:
        yaw = math.radians(self.point_yaw_deg)
        x, y, z = vector_mm
        return (
            MM * (math.cos(yaw) * x - math.sin(yaw) * y),
            MM * (math.sin(yaw) * x + math.cos(yaw) * y),
            MM * z,
        )
