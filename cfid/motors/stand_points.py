"""Settled steps of a stand to points of one motor, when several ran together."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.estimate.staircase import FZ, Point
from cfid.motors.points import MotorPoints
from cfid.units import ROTOR_TURNS

Array = npt.NDArray[np.float64]

TZ = 5


def points_of(steps: Sequence[Point], *, motors: int | None = None, thrust: int = FZ) -> MotorPoints:
    """Return one motor's points of settled steps; `motors` is how many ran where the steps do not state which.

    Thrust is divided by how many ran, torque, where there is such a channel, by how many more of them turn one way
    than the other: it is nan where as many do.
    """
    ran = np.array([len(step.motors) or motors or 1 for step in steps], float)
    mean, std = (np.array([getattr(step, name) for step in steps]) for name in ("mean", "std_of_mean"))
    shares = np.array([step.tare_shares for step in steps])
    points = MotorPoints(
        command=np.array([float(step.command or 0) for step in steps]),
        thrust_n=mean[:, thrust] / ran,
        thrust_std_n=std[:, thrust] / ran,
        thrust_shared_n=shares[:, :, thrust] / ran[:, np.newaxis],
    )
    if mean.shape[1] <= TZ:
        return points
    alike = np.array(
        [abs(sum(ROTOR_TURNS[motor] for motor in step.motors)) if step.motors else motors or 1 for step in steps]
    )
    alike = np.where(alike == 0, np.nan, alike)
    torque = {
        "torque_nm": mean[:, TZ] / alike,
        "torque_std_nm": std[:, TZ] / alike,
        "torque_shared_nm": shares[:, :, TZ] / alike[:, np.newaxis],
    }
    return MotorPoints(**{**vars(points), **torque})
