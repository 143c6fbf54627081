"""When a flight was in the air: carried by its rotors, away from the ground, and touching nothing."""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.signal import lfilter

from cfid.findings import Finding, warning
from cfid.flight.rows import ROW_S, ROW_STEPS, STEP_S, segments
from cfid.units import FULL_COMMAND, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

EDGE_S = 1.0  # from there on, and before its end: the ground's air, and touching it
_LIFTED = 0.8  # of the median sum of squared drives, above which the vehicle is in the air
_CRASH_MPS2 = 60.0
_FORGOTTEN_S = 0.2  # in which thrust follows commands: their mean, less than half that of flight, carries nothing then
_IDLING = 0.05  # of the largest sum of squared drives: less carries nothing, however long motors idle
_UNCARRIED, _HELD = 0.5, 0.8  # of the sum of squared drives in flight, and of gravity: what holds it is the ground
_STANDING_S = 0.1  # for which that has to last: blows are shorter
_STRUCK_S = 0.5  # around such a specific force
_TURNED = 34.0  # rad/s, near the range of the gyro, 2000 deg/s
_LAGS_S = (0.02, 0.04, 0.07, 0.12)
_DELAY_STEPS = 4  # from a command to what the accelerometer shows of it, 8 ms
_TRIMMED, _ROUNDS = 3.0, 6  # standard deviations that thrust is fitted within, and how often
_AROUND_ROWS = 101  # 1 s, whose median is taken away: wind, a battery's charge and drag last longer than a touch
# What pushes the vehicle up beyond its rotors' thrust at a touch; and how much more than what, but for 0.1 % of the
# time, is missing from that thrust. In gusts and manoeuvres of simulated and public flights both are alike, to 3.8
# m/s^2; touches of 0.04 to 0.25 s push with 3.4 to 35 m/s^2.
_PUSHED_MPS2, _MORE, _RARE = 3.0, 2.0, 0.001
_OF_MEDIAN = 0.6745  # of a standard deviation, the median of absolute values
_NAMED = 6  # touches


def in_air(command: Array, force: Array, rates: Array) -> Mask:
    """Return the rows (m,) in the air: under a thrust that carries, away from the ground, and not struck.

    Between hops and in landings the ground carries the vehicle, whether its motors idle or stand. Commands (m, 4) are
    of any unit, specific forces (m, 3) in m/s^2, rates (m, 3) in rad/s.
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
    """Return rows (m,) in the air without those around short touches, and a finding that names these.

    `followed` (m,) marks rows before which commands were seen for so long that the rotors' thrust is known: touches are
    looked for there. `command` (n, 4) are the commands of each step, `vertical` (m,) is the specific force along z in
    m/s^2, and `begin_s` the first row's time in the log. In landings rotors are below their thrust for long, as
    `in_air` notices; a touch shows in a force alone that they do not give.
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
    """Return rows (m,) that are marked, and those for a time after them."""
    count = round(for_s / ROW_S)
    total = np.cumsum(np.concatenate([[0], mask.astype(int)]))
    return np.asarray(total[1:] - total[np.maximum(np.arange(len(mask)) - count, 0)] > 0)


def _thrust(airborne: Mask, drive: Array, vertical: Array) -> Array:
    """Return the specific force (m,) that lagging rotors give, a square of drives (n, 4), without regard to touches.

    It tells touches from manoeuvres before anything is fitted: one lag up and down, and a usual delay.
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
    """Return the median of sums of squared drives (m,) in flight: most rows between idling and full command fly."""
    running = lift[lift > 0]
    if not len(running):
        return np.inf
    return float(np.median(running[running > _IDLING * running.max()]))


def _standing(lift: Array, force: Array) -> Mask:
    """Return the rows (m,) at which the vehicle is held by the ground: it weighs, and its rotors do not carry it.

    `lift` (m,) is the sum of squared drives. In the air rotors that do not carry let the specific force fall as well.
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
    """Return rows (m,) that are marked, and those for a time before and after them."""
    return np.asarray(late(late(mask, for_s)[::-1], for_s)[::-1])
