"""Why the lag of a log is rejected: the command excites it too little, or it explains too little."""

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, rejection
from cfid.motors.lag.model import InputLag

Array = npt.NDArray[np.float64]

EXPLAINED = 0.9  # of the variance

_LOOSE = 0.2  # of a time constant: the largest accepted standard uncertainty
_COARSE = 0.5  # of a time constant: the largest interval of a command that shows it


def rejections(
    lag: InputLag,
    std_s: Array,
    explained: float,
    *,
    singular: bool,
    unseen_s: float,
    moves: bool,
    levels: int,
) -> tuple[Finding, ...]:
    """Return why a lag is rejected; where no lag follows a command that `moves`, a misfit is the only reason.

    More excitation would show no more there. `levels` is how many values the command has: many maps of second order
    pass through any two.
    """
    keys = ("dynamics.rising", "dynamics.falling", "dynamics.delay_s")
    unexplained = explained < EXPLAINED
    if unexplained and moves:
        text = (
            f"its command moves and a first-order lag explains only {100 * explained:.0f} % "
            f"(limit {100 * EXPLAINED:.0f} %)."
        )
        return (rejection("lag-misfit", text, *keys),)
    if singular:
        text = (
            "the command has two levels alone, and the map from commands takes three: add a third level."
            if levels == 2
            else "the command does not move enough to show a time constant: excite the rotor more."
        )
        return (rejection("lag-not-excited", text, *keys),)
    found = []
    share, way, tau_s = max(
        (std_s[0] / lag.rising_s, "rising", lag.rising_s), (std_s[1] / lag.falling_s, "falling", lag.falling_s)
    )
    if not share < _LOOSE:
        text = (
            f"the time constant of {way} speed, {1e3 * tau_s:.0f} ms, is open by {100 * share:.0f} % "
            f"(limit {100 * _LOOSE:.0f} %): excite the rotor more, or longer."
        )
        found.append(rejection("lag-not-excited", text, *keys))
    if unexplained:
        text = f"a first-order lag explains only {100 * explained:.0f} % (limit {100 * EXPLAINED:.0f} %)."
        found.append(rejection("lag-misfit", text, *keys))
    if unseen_s > _COARSE * min(lag.rising_s, lag.falling_s):
        text = (
            f"the command was logged every {1e3 * unseen_s:.0f} ms (limit {100 * _COARSE:.0f} % of the time "
            f"constant, {1e3 * min(lag[:2]):.0f} ms): log faster."
        )
        found.append(rejection("lag-log-too-slow", text, *keys))
    return tuple(found)
