"""Check that a flight was logged so that it can be fitted: dense rows, rotors on a square, forces that carry it."""

import math

import numpy as np

from cfid.findings import Finding, rejection, warning
from cfid.flight.data import FlownLog
from cfid.flight.values import MOMENTS, TIMES
from cfid.units import MOTORS, USUAL_GRAVITY_MPS2

_CLOSE_S = 0.005  # between commands: farther apart, the autopilot's commands in between are unknown
_SEEN_S = 0.012  # between rows of a sensor, for quantities that depend on how fast it responds
# Limits on the mean force of a flight, in g: less does not carry it, more means steep flight; public logs have 1.01 to
# 1.05.
_LIGHTEST, _HEAVIEST = 0.9, 1.3
_TILTED_DEG = 6.0  # public logs: 0.2 to 1.0


def spacing_findings(flown: FlownLog) -> list[Finding]:
    """Reject quantities for which rows are too far apart: autopilots send two to ten commands in between."""
    moved, turned, pushed = flown.apart_s
    found = []
    if moved > _CLOSE_S:
        text = (
            f"commands are {1e3 * moved:.0f} ms apart (limit {1e3 * _CLOSE_S:.0f} ms): those between are not seen, and "
            "lags come out up to twice as long. Log them at 500 Hz for lags."
        )
        found.append(rejection("flight-commands-apart", text, *TIMES))
    if max(turned, pushed) > _SEEN_S:
        what, apart_s = ("accelerometer", pushed) if pushed > _SEEN_S else ("gyro", turned)
        text = (
            f"the {what}'s readings are {1e3 * apart_s:.0f} ms apart (limit {1e3 * _SEEN_S:.0f} ms): lags come out "
            f"several per cent long{', and moments small' if pushed > _SEEN_S else ''}. Log them every 10 ms at least."
        )
        lost = (*TIMES, *(MOMENTS.values() if pushed > _SEEN_S else ()))
        found.append(rejection("flight-sensors-apart", text, *lost))
    return [one.at(flown.log.path.name) for one in found]


def square_findings(flown: FlownLog) -> list[Finding]:
    """Reject roll and pitch moments where the log does not place the rotors on a square."""
    facts = flown.log.facts
    others = facts.motors not in (None, len(MOTORS))
    if facts.square is not False and not others:
        return []
    there = f"there are {facts.motors} motors" if others else "the rotors do not stand on a square"
    text = f"{there}: moments about roll and pitch are fitted only for four rotors at the corners of a square."
    return [rejection("flight-rotors-off-square", text, MOMENTS["roll"], MOMENTS["pitch"]).at(flown.log.path.name)]


def weight_findings(flown: FlownLog) -> list[Finding]:
    """Judge specific forces in the air: their mean has to carry the vehicle, and point along z where it hovers."""
    force = flown.flight.force[flown.flight.airborne]
    if not len(force):
        return []
    size = float(np.mean(np.linalg.norm(force, axis=1))) / USUAL_GRAVITY_MPS2
    mean = np.mean(force, axis=0)
    tilt_deg = math.degrees(math.atan2(math.hypot(mean[0], mean[1]), mean[2]))
    text = f"the accelerometer shows {size:.2f} g in the mean of the flight, which carries the vehicle with"
    keys = ("flight.thrust*", *MOMENTS.values())
    result = []
    if size < _LIGHTEST:
        result.append(rejection("flight-weight-unlike", f"{text} 1 g: see its scale.", *keys))
    elif size > _HEAVIEST:
        result.append(
            warning(
                "flight-weight-apart",
                f"{text} 1 g where it hovers: without steep turns its scale is wrong, and thrust and moments by as "
                "much.",
                *keys,
            )
        )
    if tilt_deg > _TILTED_DEG:
        text = (
            f"the specific force is {tilt_deg:.0f} degrees off z in the mean (limit {_TILTED_DEG:g}): fast flight one "
            "way, wind, or a tilted accelerometer, which makes thrust and moments wrong."
        )
        result.append(warning("flight-force-tilted", text, *keys))
    return [one.at(flown.flight.name) for one in result]
