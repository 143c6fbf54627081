"""Thrusts of a command that a run held twice: they differ where the load cell warmed up meanwhile."""

import math

import numpy as np

from cfid.estimate.common_causes import Cause
from cfid.estimate.linear import weighted_mean
from cfid.estimate.propagation import widened
from cfid.findings import Finding, warning
from cfid.motors.points import Array, MotorPoints
from cfid.units import DEAD_COMMAND

_LARGEST_IN_STD = 3.0
_LEFT = 2.0
_SAGGED = 0.005  # of the battery's voltage: where it changed by more, so did the thrust itself


def warm_up(points: MotorPoints, vbat_v: Array | None, name: str) -> tuple[tuple[Cause, ...], tuple[Finding, ...]]:
    """Return the drift of a run's load cell as a cause of error, with a finding; neither where none is found.

    Points (n,) are in the order in which they were recorded. The drift is the weighted mean of the relative changes
    from the first to the last time that each command was held, its standard uncertainty twice that: the last thrust
    need not be the right one either, as a drift that has not ended may go on for as much again.
    """
    if points.thrust_n is None or points.thrust_std_n is None:
        return (), ()
    thrust, std, running = points.thrust_n, points.thrust_std_n, points.command > DEAD_COMMAND
    changes = []
    for command in np.unique(points.command[running]):
        first, *_, last = np.flatnonzero(points.command == command)[[0, -1]].tolist()
        sagged = vbat_v is not None and abs(vbat_v[last] / vbat_v[first] - 1) > _SAGGED
        if first < last and thrust[first] > 0 and not sagged:
            changes.append((thrust[last] / thrust[first] - 1, math.hypot(std[first], std[last]) / thrust[first]))
    if not changes:
        return (), ()
    change, own = np.array(changes).T
    mean = weighted_mean(change, std=own)
    found, found_std, freedom = float(mean.values[0]), float(mean.std[0]), mean.degrees_of_freedom
    if freedom:
        scatter = math.sqrt(float(np.sum((mean.residual / own) ** 2)) / freedom)
        found_std = widened(found_std * max(scatter, 1.0), freedom)
    if abs(found) <= _LARGEST_IN_STD * found_std:
        return (), ()
    text = (
        f"{name}: {len(changes)} command(s) held again gave {100 * found:+.1f} % of the first thrust more, "
        f"{abs(found) / found_std:.0f} standard uncertainties (limit {_LARGEST_IN_STD:g}): did the load cell warm up? "
        "The uncertainties contain twice that. Switch the load cell on half an hour before the first step."
    )
    keys = ("motor.thrust_poly", "motor.torque_poly", "motor.max_thrust_n", "motor.hover_mass_kg")
    return (Cause(f"drift of the load cell in {name}", _LEFT * abs(found)),), (
        warning("load-cell-drifted", text, *keys),
    )
