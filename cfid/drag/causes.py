"""Compute the effect of errors in the rig's scales and angles on experiments: gains, cross-talk, yaw and azimuth."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cfid.drag.model import DragExperiments
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


def distorted(runs: DragExperiments) -> Mapping[Cause, DragExperiments]:
    """Return the experiments as changed by one standard uncertainty of each cause of error in `runs`.

    A cause without a stated uncertainty changes nothing; a table of forces has no causes.
    """
    if not runs.rigs:
        return {}
    same = linearity(runs.rigs)
    errors = {same: (same.std or 0.0) * np.eye(3)}  # of the cell's forces, as the matrix that multiplies them
    for place, axis in enumerate(AXES[:3]):
        cause = gain(runs.rigs, axis)
        errors[cause] = (cause.std or 0.0) * np.diag(np.eye(3)[place])
    for cause, (shown, acting) in force_cross_talk(runs.rigs):
        errors[cause] = (cause.std or 0.0) * np.outer(np.eye(3)[shown], np.eye(3)[acting])
    turn = rotation_about_z(runs.rigs[0].yaw_in_wind_deg or 0.0)  # from the cell's frame to the body's
    changed = {
        cause: replace(runs, force_n=runs.force_n + runs.force_n @ (turn @ error @ turn.T).T)
        for cause, error in errors.items()
    }
    yaw, azimuth = angles(runs.rigs)
    changed[yaw] = replace(runs, force_n=turn_about_z(runs.force_n, yaw_deg=yaw.std or 0.0))
    for cause in tachometer_scales(runs.tachometers):
        changed[cause] = replace(runs, speed_sum_rad_s=runs.speed_sum_rad_s * (1 + (cause.std or 0.0)))
    for cause in anemometer_scales(runs.rigs):
        changed[cause] = replace(runs, velocity_mps=runs.velocity_mps * (1 + (cause.std or 0.0)))
    changed[azimuth] = replace(runs, velocity_mps=turn_about_z(runs.velocity_mps, yaw_deg=-(azimuth.std or 0.0)))
    return changed
