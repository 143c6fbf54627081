"""Thrusts at commands that a run held twice: they differ where the load cell warmed up in between."""

import math

import numpy as np

from cfid.counted import counted
from cfid.estimate.common_causes import Cause
from cfid.estimate.linear import weighted_mean
from cfid.estimate.propagation import widened
from cfid.findings import Finding, note, warning
from cfid.motors.points import Array, MotorPoints
from cfid.units import DEAD_COMMAND

_LARGEST_IN_STD = 3.0
_SAGGED = 0.005  # of the battery's voltage: where it changed by more, the thrust itself changed
_NOTABLE = 0.01  # of the thrust: a smaller drift need not be seen
_KEYS = ("motor.thrust_poly", "motor.torque_poly", "motor.max_thrust_n", "motor.hover_mass_kg")


def warm_up(
    points: MotorPoints, time_s: Array, vbat_v: Array | None, name: str
) -> tuple[tuple[Cause, ...], tuple[Finding, ...]]:
    """Return the drift of a run's load cell as a cause of error, with findings; no cause where noise explains it.

    Points (n,) were recorded at times (n,). Each command that was held again gives a relative change over the time
    between. The weighted mean rate of these changes, times the run's duration, is the drift. What noise adds to its
    square is subtracted. The rest is the standard uncertainty, since the last thrust need not be the right one either:
    a drift that has not ended may go on for as much again.
    """
    if points.thrust_n is None or points.thrust_std_n is None:
        return (), ()
    thrust, std, running = points.thrust_n, points.thrust_std_n, points.command > DEAD_COMMAND
    rates, rate_stds = [], []
    for command in np.unique(points.command[running]):
        first, *_, last = np.flatnonzero(points.command == command)[[0, -1]].tolist()
        sagged = vbat_v is not None and abs(vbat_v[last] / vbat_v[first] - 1) > _SAGGED
        if first < last and thrust[first] > 0 and not sagged:
            scale = thrust[first] * (time_s[last] - time_s[first])
            rates.append((thrust[last] - thrust[first]) / scale)
            rate_stds.append(math.hypot(std[first], std[last]) / scale)
    if not rates:
        return (), ()
    duration_s = float(np.ptp(time_s[running]))
    found, found_std = (duration_s * size for size in _mean(np.array(rates), np.array(rate_stds)))
    causes = (Cause(f"drift of the load cell in {name}", math.sqrt(max(found**2 - found_std**2, 0.0))),)
    return causes if causes[0].std else (), _findings(
        found, found_std, duration_s, f"{name}: {counted(len(rates), 'command')}"
    )


def _mean(values: Array, std: Array) -> tuple[float, float]:
    """Return the weighted mean of values (n,), and its standard uncertainty by their scatter where that is larger."""
    mean = weighted_mean(values, std=std)
    found_std, freedom = float(mean.std[0]), mean.degrees_of_freedom
    if freedom:
        scatter = math.sqrt(float(np.sum((mean.residual / std) ** 2)) / freedom)
        found_std = widened(found_std * max(scatter, 1.0), freedom)
    return float(mean.values[0]), found_std


def _findings(found: float, found_std: float, duration_s: float, whose: str) -> tuple[Finding, ...]:
    if abs(found) > _LARGEST_IN_STD * found_std:
        text = (
            f"{whose} held again gave {100 * found:+.1f} % more thrust within {duration_s:.0f} s, "
            f"{abs(found) / found_std:.0f} standard uncertainties (limit {_LARGEST_IN_STD:g}): did the load cell warm "
            "up? The uncertainties contain that. Switch the load cell on half an hour before the first step."
        )
        return (warning("load-cell-drifted", text, *_KEYS),)
    least = _LARGEST_IN_STD * found_std
    if least > _NOTABLE:
        text = (
            f"{whose} held again would show a drift of the load cell only beyond {100 * least:.1f} % of the thrust "
            f"within {duration_s:.0f} s. A cell that warms up by less is not found: switch it on half an hour before "
            "the first step, or hold each command longer."
        )
        return (note("load-cell-drift-unseen", text, *_KEYS),)
    return ()
