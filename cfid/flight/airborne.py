"""Find when a flight was in the air: carried by its rotors, away from the ground, and touching nothing."""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.signal import lfilter

from cfid.findings import Finding, warning
from cfid.flight.rows import ROW_S, ROW_STEPS, STEP_S, segments
from cfid.units import FULL_COMMAND, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Rows within this time after take-off and before landing are left out: ground effect and contact.
EDGE_S = 1.0
_LIFTED = 0.8  # of the median sum of squared drives: above it, the vehicle is in the air
_CRASH_MPS2 = 60.0
# The thrust follows the commands within this time. Where their mean over it is below half of that in flight, the rotors
# cannot carry the vehicle.
_FORGOTTEN_S = 0.2
_IDLING = 0.05  # of the largest sum of squared drives: below it, rotors carry nothing, however long the motors idle
# Limits on the sum of squared drives relative to flight, and on the specific force relative to gravity: below the first
# and above the second, the ground holds the vehicle.
_UNCARRIED, _HELD = 0.5, 0.8
_STANDING_S = 0.1  # the shortest time on the ground: shocks are shorter
_STRUCK_S = 0.5  # left out before and after a crash or a rate near the end of the gyro's range
_TURNED = 34.0  # rad/s, near the range of the gyro, 2000 deg/s
_LAGS_S = (0.02, 0.04, 0.07, 0.12)
_DELAY_STEPS = 4  # 8 ms from a command until the accelerometer shows its effect
_TRIMMED, _ROUNDS = 3.0, 6  # the thrust is fitted to rows within this many standard deviations, in this many rounds
# The median over 1 s is subtracted: wind, the battery's charge and drag last longer than a touch.
_AROUND_ROWS = 101
# At a touch, the specific force exceeds the rotors' thrust. A touch has to exceed both an absolute limit and a multiple
# of the shortfall, the amount by which the force falls below that thrust, at its quantile `_RARE`. In gusts and
# manoeuvres of simulated and public flights, excess and shortfall are alike, up to 3.8 m/s^2; touches of 0.04 to 0.25 s
# push with 3.4 to 35 m/s^2.
_PUSHED_MPS2, _MORE, _RARE = 3.0, 2.0, 0.001
_OF_MEDIAN = 0.6745  # the median of absolute values, in standard deviations
_NAMED = 6  # the most touches that the message lists


def in_air(command: Array, force: Array, rates: Array) -> Mask:
    """Return the rows (m,) in the air: carried by the rotors, away from the ground, and not struck.

    Between hops and during landings the ground carries the vehicle, whether its motors idle or stand still. Commands
    (m, 4) may have any unit; specific forces (m, 3) are in m/s^2, rates (m, 3) in rad/s.
    """
    lift = np.sum(command**2, axis=1)
    carried = lift > _LIFTED * _usual(lift)
    count = round(EDGE_S / ROW_S)
    flown = np.zeros(len(lift), bool)
    if carried.any():
        flown[np.argmax(carried) + count : len(carried) - np.argmax(carried[::-1]) - count] = True
    running = (command > 0).all(axis=1)
    struck = np.linalg.norm(force, axis=1) > _CRASH_MPS2
    wild = (np.abs(rates) > _TURNED).any(axis=1)
    flown &= ~_around(_standing(lift, force), EDGE_S)
    return np.asarray(flown & running & ~_around(struck | wild, _STRUCK_S))


def without_touches(
    airborne: Mask, followed: Mask, command: Array, vertical: Array, *, begin_s: float
) -> tuple[Mask, list[Finding]]:
    """Return the rows (m,) in the air without those around short touches, and a finding that lists the touches.

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
    begins_s = [
        begin_s + ROW_S * (one.start + np.argmax(pushed[one])) for one in segments(near, 1) if pushed[one].any()
    ]
    times = [f"{at_s:.2f}" for at_s in begins_s[:_NAMED]]
    rest = len(begins_s) - len(times)
    listed = ", ".join(times) if rest or len(times) == 1 else f"{', '.join(times[:-1])} and {times[-1]}"
    text = (
        f"the vehicle was pushed up at {listed} s{f' and {rest} other times' if rest else ''}, by up to "
        f"{beyond[pushed].max():.2g} m/s^2 more than its rotors give: it touched the ground, or something else. "
        f"{ROW_S * np.count_nonzero(near):.3g} s around that are left out."
    )
    return airborne & ~near, [warning("flight-touched", text)]


def late(mask: Mask, for_s: float) -> Mask:
    """Return the rows (m,) that are marked, and those within a time after them."""
    count = round(for_s / ROW_S)
    total = np.cumsum(np.concatenate([[0], mask.astype(int)]))
    return np.asarray(total[1:] - total[np.maximum(np.arange(len(mask)) - count, 0)] > 0)


def _thrust(airborne: Mask, drive: Array, vertical: Array) -> Array:
    """Return the specific force (m,) that lagging rotors give: a quadratic in the drives (n, 4), with touches ignored.

    It distinguishes touches from manoeuvres before anything is fitted, with one lag for rising and falling drives and a
    typical delay.
    """
    best, found = np.inf, vertical
    for lag_s in _LAGS_S:
        share = 1 - np.exp(-STEP_S / lag_s)
        lagging = drive[0] + lfilter([share], [1.0, share - 1], drive - drive[0], axis=0)
        lagging = np.concatenate([lagging[:1].repeat(_DELAY_STEPS, axis=0), lagging[:-_DELAY_STEPS]])
        rows = lagging[::ROW_STEPS][: len(vertical)]
        powers = np.column_stack([np.ones(len(rows)), rows.sum(axis=1), np.sum(rows**2, axis=1)])
        used = airborne
        for _ in range(_ROUNDS):
            given = powers @ np.linalg.lstsq(powers[used], vertical[used], rcond=None)[0]
            size = np.abs(vertical - given)
            std = float(np.median(size[airborne])) / _OF_MEDIAN
            used = airborne & (size <= _TRIMMED * std)
        if std < best:
            best, found = std, given
    return np.asarray(found)


def _usual(lift: Array) -> float:
    """Return the median in flight of the sums of squared drives (m,): most rows above idling are in flight."""
    running = lift[lift > 0]
    if not len(running):
        return np.inf
    return float(np.median(running[running > _IDLING * running.max()]))


def _standing(lift: Array, force: Array) -> Mask:
    """Return the rows (m,) at which the ground holds the vehicle: its weight shows, but the rotors do not carry it.

    `lift` (m,) is the sum of squared drives. In the air, the specific force falls together with the rotors' thrust.
    """
    count = round(_FORGOTTEN_S / ROW_S)
    total = np.cumsum(np.concatenate([[0.0], lift]))
    begin = np.maximum(np.arange(len(lift)) - count, 0)
    recent = (total[1:] - total[begin]) / (np.arange(len(lift)) + 1 - begin)
    held = (recent < _UNCARRIED * _usual(lift)) & (force[:, 2] > _HELD * USUAL_GRAVITY_MPS2)
    standing = np.zeros(len(lift), bool)
    for part in segments(held, round(_STANDING_S / ROW_S)):
        standing[part] = True
    return standing


def _around(mask: Mask, for_s: float) -> Mask:
    """Return the rows (m,) that are marked, and those within a time before and after them."""
    return np.asarray(late(late(mask, for_s)[::-1], for_s)[::-1])
