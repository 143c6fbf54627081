"""Points of one motor from a stand's settled steps, where several motors ran together or only speed is known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.estimate.staircase import FZ, Point, Staircase, reduce_staircase
from cfid.large import chosen_rows, some_steps, stored
from cfid.motors.points import MotorPoints
from cfid.units import ROTOR_TURNS

Array = npt.NDArray[np.float64]

TZ = 5
_STANDING_S = 2.0  # of rotors at rest, put before a record that begins with turning rotors


def points_of(steps: Sequence[Point], *, motors: int | None = None, thrust: int = FZ) -> MotorPoints:
    """Return one motor's points from settled steps; `motors` is how many ran where the steps do not state which.

    Thrust is divided by the number of motors that ran. Torque, where it has a channel, is divided by how many more of
    these motors turn one way than the other; it is nan where equally many turn each way. A channel that is nan was not
    measured.
    """
    ran = np.array([len(step.motors) or motors or 1 for step in steps], float)
    mean, std = (np.array([getattr(step, name) for step in steps]) for name in ("mean", "std_of_mean"))
    shares = np.array([step.tare_shares for step in steps])
    measured = np.isfinite(mean).any(axis=0)
    points = MotorPoints(command=np.array([float(step.command or 0) for step in steps]))
    if measured[thrust]:
        points = replace(
            points,
            thrust_n=mean[:, thrust] / ran,
            thrust_std_n=std[:, thrust] / ran,
            thrust_shared_n=shares[:, :, thrust] / ran[:, np.newaxis],
        )
    if mean.shape[1] <= TZ or not measured[TZ]:
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


def reduce_speeds(time_s: Array, speeds_rad_s: Array, command_time_s: Array, commands: Array) -> Staircase:
    """Reduce speeds (n, k), nan where missing, at times (n,) by commands (m, 4) that hold from `command_time_s` (m,).

    A rotor at rest has speed 0, so the pause before the first command need not be recorded. The speed of a rotor that
    idles in a pause, such as that of an armed Brushless, is not subtracted. Raises what `reduce_staircase` raises.
    """
    known = np.asarray(np.isfinite(speeds_rad_s).all(axis=1))
    time_s, speeds_rad_s = chosen_rows(time_s, known), chosen_rows(speeds_rad_s, known)
    begins_running = len(time_s) > 1 and np.any(commands[command_time_s <= time_s[0]][-1:])
    if begins_running:
        step_s = float(np.median(some_steps(time_s)))
        before_s = time_s[0] - step_s * np.arange(round(_STANDING_S / step_s), 0, -1)
        time_s = stored(np.concatenate([before_s, time_s]))
        speeds_rad_s = stored(np.vstack([np.zeros((len(before_s), speeds_rad_s.shape[1])), speeds_rad_s]))
        command_time_s = np.concatenate([before_s[:1], command_time_s])
        commands = np.vstack([np.zeros((1, commands.shape[1])), commands])
    return reduce_staircase(
        time_s=time_s, channels=speeds_rad_s, command_time_s=command_time_s, commands=commands, thrust=0, tared=False
    )
