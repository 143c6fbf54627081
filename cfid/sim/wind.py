"""Simulates a steady wind on the vehicle on the load cell: its forces on turning rotors and on the body."""

import math

import numpy as np
from pydantic import BaseModel, ConfigDict

from cfid.records.rig_file import Number, Spread, Vector
from cfid.sim.stepping import Array


class WindTruth(BaseModel):
    """Wind of `speed_mps` from a fan at `angle_deg` to the vertical and `azimuth_deg` about it.

    Rotors feel `kg_per_rad`, for the body's x, y and z, times their speeds' sum times the velocity relative to the air
    (thesis eq. 4.2, its coefficients of eq. 4.8), the body `body_kg_per_m` times that velocity times its magnitude. The
    load cell's x axis lies `yaw_deg` left of the vehicle's. The anemometer reads too much by `anemometer_gain`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    speed_mps: Spread = 0.0
    angle_deg: Number = 0.0
    azimuth_deg: Number = 28.46
    yaw_deg: Number = 45.0
    kg_per_rad: Vector = (-9.1785e-7, -9.1785e-7, -10.311e-7)
    body_kg_per_m: Number = -3e-4
    anemometer_gain: Number = 0.0

    @property
    def drag_ns_per_rad(self) -> Array:
        """The force (3,) per rad/s of the rotors, in the load cell's frame."""
        return self._in_the_cell(np.array(self.kg_per_rad) * self._velocity_mps)

    @property
    def body_n(self) -> Array:
        """The force on the body (3,), in the load cell's frame, independent of the rotors."""
        return self._in_the_cell(self.body_kg_per_m * self.speed_mps * self._velocity_mps)

    @property
    def _velocity_mps(self) -> Array:
        """The vehicle's velocity relative to the air (3,), in its own frame."""
        angle, azimuth = math.radians(self.angle_deg), math.radians(self.azimuth_deg)
        across, up = math.sin(angle), math.cos(angle)
        towards = np.array([across * math.cos(azimuth), -across * math.sin(azimuth), up])
        return np.asarray(self.speed_mps * towards)

    def _in_the_cell(self, force: Array) -> Array:
        cos, sin = math.cos(math.radians(self.yaw_deg)), math.sin(math.radians(self.yaw_deg))
        return np.array([cos * force[0] + sin * force[1], cos * force[1] - sin * force[0], force[2]])
