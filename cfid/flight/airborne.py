"""Find when a flight was in the air: carried by its rotors, away from the ground, and touching nothing."""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import lfilter

from cfid.findings import Finding, warning
from cfid.flight.rows import ROW_S, ROW_STEPS, STEP_S, segments
from cfid.units import FULL_COMMAND, USUAL_GRAVITY_MPS2

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
_LAGS_S, _DELAY_STEPS = (0.02, 0.04, 0.07, 0.12), 4  # from a command until the accelerometer shows its effect
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


def without_touches(
    airborne: Mask, followed: Mask, command: Array, vertical: Array, *, begin_s: float
) -> tuple[Mask, list[Finding]]:
    """Return the rows (m,) in the air without those around short touches, and a finding on the touches.

    `followed` (m,) marks rows before which commands were recorded for long enough that the rotors' thrust is known;
    only these rows are searched for touches. `command` (n, 4) are the commands of each step, `vertical` (m,) is the
    specific force along z in m/s^2, and `begin_s` is the first row's time in the log. During a landing the rotors give
    less than the weight for a long time, which `in_air` detects; a short touch shows only as a force that the rotors do
    not give.
    """
    judged = airborne & followed
    if np.count_nonzero(judged) < _AROUND_ROWS:
        return airborne, []
    beyond = np.where(judged, vertical - _thrust(judged, command / FULL_COMMAND, vertical), 0.0)
    beyond = beyond - median_filter(beyond, _AROUND_ROWS, mode="nearest")
    limit = max(_PUSHED_MPS2, -_MORE * float(np.quantile(beyond[judged], _RARE)))
    pushed = judged & (beyond > limit)
    if not pushed.any():
        return airborne, []
    near = airborne & _around(pushed, EDGE_S)
    touches = [each for each in segments(near, 1) if pushed[each].any()]
    text = (
        f"the vehicle was pushed up {len(touches)} times, first at {begin_s + ROW_S * np.argmax(pushed):.2f} s, by up "
        f"to {beyond[pushed].max():.2g} m/s^2 more than its rotors give: it touched the ground, or something else. "
        f"{ROW_S * np.count_nonzero(near):.3g} s around that are left out."
    )
    return airborne & ~near, [warning("flight-touched", text)]


def late(mask: Mask, for_s: float) -> Mask:
    """Return the rows (m,) that are marked, and those within a time after them."""
    count = round(for_s / ROW_S)
    near = maximum_filter1d(mask.astype(np.uint8), count + 1, mode="constant", origin=count // 2)
    return np.asarray(near > 0)


def _around(mask: Mask, for_s: float) -> Mask:
    """Return the rows (m,) that are marked, and those within a time before and after them."""
    near = maximum_filter1d(mask.astype(np.uint8), 2 * round(for_s / ROW_S) + 1, mode="constant")
    return np.asarray(near > 0)


def _thrust(airborne: Mask, drive: Array, vertical: Array) -> Array:
    """Return the specific force (m,) that lagging rotors give: a quadratic in the drives (n, 4), whatever few rows say.

    It distinguishes touches from manoeuvres before anything is fitted, with one lag for rising and falling drives and a
    typical delay.
    """
    best, thrust = np.inf, vertical
    for lag_s in _LAGS_S:
        share = 1 - np.exp(-STEP_S / lag_s)
        lagging = drive[0] + lfilter([share], [1.0, share - 1], drive - drive[0], axis=0)
        lagging = np.concatenate([lagging[:1].repeat(_DELAY_STEPS, axis=0), lagging[:-_DELAY_STEPS]])
        rows = lagging[::ROW_STEPS][: len(vertical)]
        powers = np.column_stack([np.ones(len(rows)), rows.sum(axis=1), np.sum(rows**2, axis=1)])
        cost, coefficients = _robust_fit(powers[airborne], vertical[airborne])
        if cost < best:
            best, thrust = cost, powers @ coefficients
    return np.asarray(thrust)


def _robust_fit(rows: Array, data: Array) -> tuple[float, Array]:
    """Return the cost and the coefficients (p,) of data (n,) in rows (n, p) where some data are far off."""
    begin = np.linalg.lstsq(rows, data, rcond=None)[0]
    fit = least_squares(lambda p: rows @ p - data, begin, lambda _: rows, x_scale="jac", loss="cauchy")
    return float(fit.cost), np.asarray(fit.x)


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
