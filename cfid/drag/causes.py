"""Compute the effect of errors in the rig's scales and angles on experiments: gains, cross-talk, yaw and azimuth."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.drag.experiments import DragExperiments
from cfid.estimate.common_causes import (
    AXES,
    Cause,
    anemometer_scales,
    angles,
    force_cross_talk,
    gain,
    linearity,
    tachometer_scales,
)
from cfid.recordings.wrench import rotation_about_z, turn_about_z
from cfid.records.rig_file import RigFacts

Array = npt.NDArray[np.float64]


def distorted(runs: DragExperiments) -> Mapping[Cause, DragExperiments]:
    """Return the experiments as changed by one standard uncertainty of each cause of error in `runs`.

    A cause without a stated uncertainty changes nothing; a table of forces has no causes.
    """
    if not runs.rigs:
        return {}
    yaw, azimuth = angles(runs.rigs)
    forces = {cause: _shown(runs.force_n, change, runs.rigs[0]) for cause, change in _changes(runs.rigs).items()}
    forces[yaw] = turn_about_z(runs.force_n, yaw_deg=yaw.std or 0.0)
    speeds = {cause: runs.speed_sum_rad_s * _times(cause) for cause in tachometer_scales(runs.tachometers)}
    winds = {cause: runs.velocity_mps * _times(cause) for cause in anemometer_scales(runs.rigs)}
    winds[azimuth] = turn_about_z(runs.velocity_mps, yaw_deg=-(azimuth.std or 0.0))
    return {
        **{cause: replace(runs, force_n=moved) for cause, moved in forces.items()},
        **{cause: replace(runs, speed_sum_rad_s=moved) for cause, moved in speeds.items()},
        **{cause: replace(runs, velocity_mps=moved) for cause, moved in winds.items()},
    }


def _changes(rigs: Sequence[RigFacts]) -> dict[Cause, Array]:
    """Return each cause's errors of the cell's forces, as the matrix (3, 3) that multiplies the forces."""
    same = linearity(rigs)
    found = {same: (same.std or 0.0) * np.eye(3)}
    for place, axis in enumerate(AXES[:3]):
        cause = gain(rigs, axis)
        found[cause] = (cause.std or 0.0) * np.diag(np.eye(3)[place])
    for cause, (shown, acting) in force_cross_talk(rigs):
        found[cause] = (cause.std or 0.0) * np.outer(np.eye(3)[shown], np.eye(3)[acting])
    return found


def _shown(force_n: Array, change: Array, rig: RigFacts) -> Array:
    """Return forces (n, 3) in the body frame with errors that arise in the cell's frame."""
    turn = rotation_about_z(rig.yaw_in_wind_deg or 0.0)
    return np.asarray(force_n + force_n @ (turn @ change @ turn.T).T)


def _times(cause: Cause) -> float:
    return 1 + (cause.std or 0.0)
