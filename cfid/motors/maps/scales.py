"""Verification of the thrust map with scales under the vehicle (section 3.3.1, figure 3.9)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cfid.errors import FitError
from cfid.estimate.polynomials import fit_polynomial
from cfid.findings import Finding, warning
from cfid.motors.maps.estimation import MotorMap
from cfid.motors.points import Array
from cfid.units import DEAD_COMMAND

_STANDING_N = 1e-3  # less than any motor that turns gives: 0.1 g
_FEWEST = 5  # points, with that of motors at rest, that can show one to be off a quadratic
_OFF = 0.25  # of the largest of the others: more than a sagging battery or a coarse display causes at one of them
_LEFT = 0.25  # largest share of the sum of squares that remains once that reading is left out
_DIFFERS = 0.1  # rms over the map's largest thrust there; different batteries cause a few hundredths


@dataclass(frozen=True, kw_only=True)
class ScalesCheck:
    """Thrusts (n,) of one motor by another instrument, and by the map, whose thrust is zero up to command 1000.

    `difference_n` is instrument less map, and `percent` the same relative to the map, nan where that is zero. `rms_n`
    and `rms_percent` are over the points of a running motor. `gain` is the instrument's thrust over the map's, by least
    squares. Its standard uncertainty contains the scatter of the points and the scales of both instruments; it is nan
    for fewer than three points.
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


def scales_thrust_n(
    command: Array, grams: Array, *, motors: int, gravity_mps2: float, rest_g: Array | None = None
) -> Array:
    """Return one motor's thrusts (n,) in N from readings of scales (n,), as the change of weight from motors at rest.

    Thrust reduces the weight; a reading that grows with the command is taken with the opposite sign. Readings of
    several recordings have a weight at rest `rest_g` (n,) each; otherwise it is the mean of the readings at rest.

    Raises FitError without a reading of motors at rest, where the display stands still, and where one reading is off
    the curve through the others.
    """
    standing = command <= DEAD_COMMAND
    if not standing.any() or standing.all():
        raise FitError(
            f"scales show a change of weight: readings at command 0 and above {DEAD_COMMAND} are needed, and these "
            f"are from {command.min():.0f} to {command.max():.0f}."
        )
    lighter = (grams[standing].mean() if rest_g is None else rest_g) - grams
    upwards = math.copysign(1.0, float(lighter[~standing].sum()))
    thrust_n = np.asarray(upwards * lighter * 1e-3 * gravity_mps2 / motors)
    _check_readings(command, grams, thrust_n)
    return thrust_n


def _check_readings(command: Array, grams: Array, thrust_n: Array) -> None:
    """Raise FitError where weights (n,) do not change with the command, or one of them is off the others' curve."""
    if np.abs(thrust_n).max() < _STANDING_N:
        raise FitError(
            f"the scales show {grams.min():g} to {grams.max():g} g at every command from {command.min():.0f} to "
            f"{command.max():.0f}: the display stands still, or the motors never ran. A motor that turns changes it by "
            "0.1 g or more."
        )
    if len(np.unique(command)) < _FEWEST:
        return
    rest = [_without(place, command, thrust_n) for place in range(len(command))]
    place = int(np.argmin([squares for squares, _ in rest]))
    squares, curve_n = rest[place]
    usual_n = float(np.abs(np.delete(thrust_n, place)).max())
    before = float(np.sum(fit_polynomial(command, thrust_n, order=2).residual ** 2))
    off = abs(float(thrust_n[place]) - curve_n) / usual_n
    if off > _OFF and squares < _LEFT * before:
        raise FitError(
            f"the reading {grams[place]:g} g at command {command[place]:.0f} is off the curve through the others by "
            f"{100 * off:.0f} % of their largest change of weight (limit {100 * _OFF:.0f} %): a slip, or the vehicle "
            "moved."
        )


def _without(place: int, command: Array, thrust_n: Array) -> tuple[float, float]:
    """Return the sum of squares about the curve through all points (n,) but one, and the curve's value there."""
    fit = fit_polynomial(np.delete(command, place), np.delete(thrust_n, place), order=2)
    return float(np.sum(fit.residual**2)), float(fit.at(command[place]))


def scales_findings(found: ScalesCheck) -> tuple[Finding, ...]:
    """Warn where scales and map differ by more than batteries and scales explain: one of them is wrong."""
    largest_n = float(np.abs(found.map_n).max())
    if found.rms_n <= _DIFFERS * largest_n:
        return ()
    text = (
        f"the scales differ from the map by {1e3 * found.rms_n:.3g} mN rms, {100 * found.rms_n / largest_n:.0f} % of "
        f"its largest thrust there (limit {100 * _DIFFERS:.0f} %), and show {found.gain:.2f} times the map's thrust: "
        "one of the two is wrong. Check the number of motors, the batteries, and that nothing touched the scales."
    )
    return (warning("scales-differ", text, "motor.thrust_poly"),)


def verify_thrust(
    thrust_map: MotorMap, *, command: Array, thrust_n: Array, scale_stds: Sequence[float] = ()
) -> ScalesCheck:
    """Compare thrusts (n,) of one motor with the map at their commands (n,).

    `scale_stds` are the relative standard uncertainties of the scales of both instruments.

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
