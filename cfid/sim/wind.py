"""A steady wind on the vehicle that is fastened to the load cell: what it does to turning rotors and to the body."""

import math

import numpy as np
from pydantic import BaseModel, ConfigDict

from cfid.records.campaign import Number, Spread, Vector
from cfid.sim.stepping import Array


class WindTruth(BaseModel):
    """Wind of `speed_mps` from a generator at `angle_deg` to the vertical and `azimuth_rad` about it.

    Rotors feel `kg_per_rad`, for the body's x, y and z, times their speeds' sum times the velocity relative to the air
    (thesis eq. 4.2, its coefficients of eq. 4.8), the body `body_kg_per_m` times that velocity and its size. The load
    cell lies turned against the vehicle by `yaw_rad`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    speed_mps: Spread = 0.0
    angle_deg: Number = 0.0
    azimuth_rad: Number = 0.4967
    yaw_rad: Number = math.pi / 4
    kg_per_rad: Vector = (-9.1785e-7, -9.1785e-7, -10.311e-7)
    body_kg_per_m: Number = -3e-4

    @property
    def drag_ns_per_rad(self) -> Array:
        """What each rad/s of the rotors adds to the force (3,), in the load cell's frame."""
        return self._in_the_cell(np.array(self.kg_per_rad) * self._velocity_mps)

    @property
    def body_n(self) -> Array:
        """The force on the body (3,), in the load cell's frame, whatever the rotors do."""
        return self._in_the_cell(self.body_kg_per_m * self.speed_mps * self._velocity_mps)

    @property
    def _velocity_mps(self) -> Array:
        """The vehicle's velocity relative to the air (3,), in its own frame."""
        angle = math.radians(self.angle_deg)
        across, up = math.sin(angle), math.cos(angle)
        towards = np.array([across * math.cos(self.azimuth_rad), -across * math.sin(self.azimuth_rad), up])
        return np.asarray(self.speed_mps * towards)

    def _in_the_cell(self, force: Array) -> Array:
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.array([cos * force[0] + sin * force[1], cos * force[1] - sin * force[0], force[2]])
