"""Turn vectors about z, from the load cell's frame to the vehicle's."""

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def rotation_about_z(yaw_deg: float) -> Array:
    """Return Rz(+yaw) (3, 3): counterclockwise seen from above."""
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def turn_about_z(vector: Array, *, yaw_deg: float) -> Array:
    """Return vectors (..., 3) of the load cell's frame in the vehicle's, by Rz(+yaw) (C.3.1, prepare_data).

    The thesis mounted the vehicle at +45 degrees for wind (C.3.1), and at -45 degrees for sines, so that motor 1 lay on
    the cell's x axis (C.2.5).
    """
    return np.asarray(vector @ rotation_about_z(yaw_deg).T)
