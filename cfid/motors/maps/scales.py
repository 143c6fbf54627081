"""Verify the thrust map with scales under the vehicle (section 3.3.1, figure 3.9)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cfid.errors import FitError
from cfid.motors.maps.estimation import MotorMap
from cfid.motors.points import Array
from cfid.units import DEAD_COMMAND


@dataclass(frozen=True, kw_only=True)
class ScalesCheck:
    """Thrusts (n,) of one motor by another instrument, beside the map's; up to command 1000 that is zero.

    `difference_n` is instrument less map, `percent` the same of the map's, nan where that is zero. `rms_n` and
    `rms_percent` are over the points of a running motor. `gain` is the instrument's thrust over the map's, by least
    squares, with the standard uncertainty that the scatter of three points or more gives it, else nan, and the scales
    of both instruments.
    """

    command: Array
    thrust_n: Array
    map_n: Array
    difference_n: Array
    percent: Array
    rms_n: float
    rms_percent: float
    gain: float
    gain_std: float


def scales_thrust_n(command: Array, grams: Array, *, motors: int, gravity_mps2: float) -> Array:
    """Return one motor's thrusts (n,) in N from readings of scales (n,), as the change from motors that stand.

    Thrust reduces the weight; a reading that grows with the command is taken with the opposite sign.

    Raises FitError without a reading of motors that stand.
    """
    standing = command <= DEAD_COMMAND
    if not standing.any() or standing.all():
        raise FitError(
            f"scales show a change of weight: readings at command 0 and above {DEAD_COMMAND} are needed, and these "
            f"are from {command.min():.0f} to {command.max():.0f}."
        )
    lighter = grams[standing].mean() - grams
    upwards = math.copysign(1.0, float(lighter[~standing].sum()))
    return np.asarray(upwards * lighter * 1e-3 * gravity_mps2 / motors)


def verify_thrust(
    thrust_map: MotorMap, *, command: Array, thrust_n: Array, scale_stds: Sequence[float] = ()
) -> ScalesCheck:
    """Compare thrusts (n,) of one motor with the map at their commands (n,).

    `scale_stds` are the relative standard uncertainties of scales of either instrument.

    Raises FitError when no motor ran.
    """
    running = command > DEAD_COMMAND
    if not running.any():
        raise FitError(f"nothing to verify the map with: no reading above command {DEAD_COMMAND}.")
    expected = np.where(running, thrust_map.fit.at(command), 0.0)
    difference = thrust_n - expected
    percent = np.full_like(expected, np.nan)
    np.divide(100 * difference, expected, out=percent, where=expected != 0)
    ours, theirs = expected[running], thrust_n[running]
    gain = float(ours @ theirs / (ours @ ours))
    free = len(ours) - 1
    scatter = float(np.sum((theirs - gain * ours) ** 2)) / free if free > 1 else math.nan
    return ScalesCheck(
        command=command,
        thrust_n=thrust_n,
        map_n=expected,
        difference_n=difference,
        percent=percent,
        rms_n=float(np.sqrt(np.mean(difference[running] ** 2))),
        rms_percent=float(np.sqrt(np.mean(percent[running] ** 2))),
        gain=gain,
        gain_std=math.hypot(math.sqrt(scatter / float(ours @ ours)), *(gain * std for std in scale_stds)),
    )
