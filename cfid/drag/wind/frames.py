"""Describe wind on a vehicle that is held still: conventions of frames and signs, and the operator's readings.

The conventions hold for all of drag:

- The body frame has x forward, y left, z up (along the thrust). The load cell is turned about z against it:
  F_body = Rz(+yaw) F_sensor; the thesis' yaw in wind is 45 degrees (see `turn_about_z`).
- v is the velocity of the vehicle relative to the air, in the body frame: it points against the wind. Wind from
  straight above (angle 0) is a climb, so v_z > 0.
- An angle is that of the wind generator to the vertical, an azimuth that of its place about z:
  v = speed (sin angle cos azimuth, -sin angle sin azimuth, cos angle).
- A drag force f is the force of the air on the vehicle beyond the thrust without wind, in the body frame; a drag
  coefficient in f = k speed_sum v is therefore negative.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.recordings.wrench import rotation_about_z

Array = npt.NDArray[np.float64]

AZIMUTH_DEG = math.degrees(0.4967)  # C.3.1, from figure 4.9
YAW_DEG = 45.0  # C.3.1, prepare_data
MARKERS = 2  # reflective strips of the tachometer's rotor, eq. 3.2


class WindSpeed(NamedTuple):
    """The wind speed at the vehicle, and its standard uncertainty, each (n,)."""

    mean_mps: Array
    std_mps: Array


def wind_speed(*, min_mps: npt.ArrayLike, max_mps: npt.ArrayLike) -> WindSpeed:
    """Return the wind at the vehicle from the lowest and the highest reading (n,) around it.

    The result is their middle, as in section 4.4.3. The wind may have any speed between them, so its standard
    uncertainty is that of a uniform distribution. A single reading, given twice, results in 0: it does not show the
    spread.
    """
    low, high = np.asarray(min_mps, dtype=np.float64), np.asarray(max_mps, dtype=np.float64)
    return WindSpeed(np.asarray((low + high) / 2), np.asarray((high - low) / math.sqrt(12)))


def velocity_in_air(*, speed_mps: npt.ArrayLike, angle_rad: npt.ArrayLike, azimuth_rad: npt.ArrayLike) -> Array:
    """Return the vehicle's velocity relative to the air (n, 3) in the body frame, m/s (C.3.1)."""
    speed, angle, azimuth = np.broadcast_arrays(
        *(np.asarray(given, dtype=np.float64) for given in (speed_mps, angle_rad, azimuth_rad))
    )
    lateral = speed * np.sin(angle)
    return np.stack([lateral * np.cos(azimuth), -lateral * np.sin(azimuth), speed * np.cos(angle)], axis=-1)


def std_turned_about_z(std: Array, *, yaw_deg: float) -> Array:
    """Return standard uncertainties (..., 3) on the body's axes, from independent ones on the load cell's axes."""
    return np.asarray(np.sqrt(std**2 @ (rotation_about_z(yaw_deg) ** 2).T))
