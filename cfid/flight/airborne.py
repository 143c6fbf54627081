"""Find when a flight was in the air: carried by its rotors, away from the ground, and touching nothing."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from cfid.findings import Finding, warning
from cfid.flight.estimation import roughly_fitted
from cfid.flight.model import without
from cfid.flight.rows import ROW_S, Flight, segments
from cfid.units import USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Rows within this time after take-off and before landing are left out: ground effect and contact.
EDGE_S = 1.0
_LIFTED = 0.8  # of the median sum of squared drives: above it, the vehicle is in the air
_IDLING = 0.05  # of the largest sum of squared drives: below it, rotors carry nothing, however long the motors idle
# Limits on the mean sum of squared drives over 0.2 s, which the thrust takes to follow, relative to flight, and on the
# specific force relative to gravity: below the first and above the second, the ground holds the vehicle.
_FORGOTTEN_S, _UNCARRIED, _HELD = 0.2, 0.5, 0.8
_STANDING_S = 0.1  # the shortest time on the ground: shocks are shorter
_STRUCK_S = 0.5  # left out before and after a crash or a rate near the end of the gyro's range
_CRASH_MPS2, _TURNED_RAD_S = 60.0, 34.0
_AROUND_ROWS = 101  # the median over 1 s is subtracted: wind, the battery's charge and drag last longer than a touch
# At a touch, the specific force exceeds the rotors' thrust. A touch has to exceed both an absolute limit and a multiple
# of the shortfall, the amount by which the force falls below that thrust, at its quantile `_RARE`. In gusts and
# manoeuvres of simulated and public flights, excess and shortfall are alike, up to 3.8 m/s^2; touches of 0.04 to 0.25 s
# push with 3.4 to 35 m/s^2.
_PUSHED_MPS2, _MORE, _RARE = 3.0, 2.0, 0.001


def in_air(command: Array, force: Array, rates: Array) -> Mask:
    """Return the rows (m,) in the air: carried by the rotors, away from the ground, and not struck.

    Between hops and during landings the ground carries the vehicle, whether its motors idle or stand still. Commands
    (m, 4) may have any unit; specific forces (m, 3) are in m/s^2, rates (m, 3) in rad/s.
    """
    lift = np.sum(command**2, axis=1)
    lifting = lift[lift > _IDLING * lift.max(initial=0.0)]
    usual = float(np.median(lifting)) if len(lifting) else np.inf
    carried = np.flatnonzero(lift > _LIFTED * usual)
    count = round(EDGE_S / ROW_S)
    flown = np.zeros(len(lift), bool)
    if len(carried):
        flown[carried[0] + count : carried[-1] + 1 - count] = True
    running = (command > 0).all(axis=1)
    struck = (np.linalg.norm(force, axis=1) > _CRASH_MPS2) | (np.abs(rates) > _TURNED_RAD_S).any(axis=1)
    standing = _standing(lift / usual, force[:, 2] / USUAL_GRAVITY_MPS2)
    return np.asarray(flown & running & ~_around(standing, EDGE_S) & ~_around(struck, _STRUCK_S))


def without_touches(flight: Flight, *, begin_s: float) -> tuple[Flight, list[Finding]]:
    """Return a flight without the rows around short touches, and a finding on the touches.

    `begin_s` is the first row's time in the log. During a landing the rotors give less than the weight for a long time,
    which `in_air` detects; a short touch shows only as a force that the rotors do not give, by a fit with coarse lags.
    """
    rows = flight.driven if flight.speeds is None else flight.airborne
    parts = segments(rows)
    if not parts:
        return flight, []
    at = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    if flight.speeds is None:
        vertical, thrusts = roughly_fitted(flight)[0]
        beyond = without(vertical.shown - thrusts, vertical.others)
    else:
        lift, force = np.sum(flight.row_speeds(0.0)[at] ** 2, axis=1), flight.force[at, 2]
        beyond = force - np.mean(force) / np.mean(lift) * lift
    beyond = beyond - median_filter(beyond, _AROUND_ROWS, mode="nearest")
    limit = max(_PUSHED_MPS2, -_MORE * float(np.quantile(beyond, _RARE)))
    pushed = np.zeros(len(rows), bool)
    pushed[at] = beyond > limit
    if not pushed.any():
        return flight, []
    near = flight.airborne & _around(pushed, EDGE_S)
    touches = [each for each in segments(near, 1) if pushed[each].any()]
    text = (
        f"the vehicle was pushed up {len(touches)} times, first at {begin_s + ROW_S * np.argmax(pushed):.2f} s, by up "
        f"to {beyond.max():.2g} m/s^2 more than its rotors give: it touched the ground, or something else. "
        f"{ROW_S * np.count_nonzero(near):.3g} s around that are left out."
    )
    left = replace(flight, airborne=flight.airborne & ~near, driven=flight.driven & ~near)
    return left, [warning("flight-touched", text)]


def late(mask: Mask, for_s: float) -> Mask:
    """Return the rows (m,) that are marked, and those within a time after them."""
    count = round(for_s / ROW_S)
    near = maximum_filter1d(mask.astype(np.uint8), count + 1, mode="constant", origin=count // 2)
    return np.asarray(near > 0)


def _around(mask: Mask, for_s: float) -> Mask:
    """Return the rows (m,) that are marked, and those within a time before and after them."""
    near = maximum_filter1d(mask.astype(np.uint8), 2 * round(for_s / ROW_S) + 1, mode="constant")
    return np.asarray(near > 0)


def _standing(lift: Array, force: Array) -> Mask:
    """Return the rows (m,) at which the ground holds the vehicle: its weight shows, but the rotors do not carry it.

    `lift` (m,) is the sum of squared drives relative to flight, `force` (m,) the vertical specific force relative to
    gravity. In the air, the specific force falls together with the rotors' thrust.
    """
    count = round(_FORGOTTEN_S / ROW_S)
    recent = uniform_filter1d(lift, count, mode="nearest", origin=(count - 1) // 2)
    standing = np.zeros(len(lift), bool)
    for part in segments((recent < _UNCARRIED) & (force > _HELD), round(_STANDING_S / ROW_S)):
        standing[part] = True
    return standing
