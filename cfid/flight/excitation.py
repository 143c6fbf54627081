"""Check that rotors moved a flight enough to show thrust and moments: else the autopilot only responds to the air."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cfid.errors import FitError
from cfid.flight.equations import THRUST, TURNS, Equations
from cfid.flight.estimation import EXPLAINED, FlightFit, explained_of
from cfid.flight.model import equations_of
from cfid.flight.rows import AXES, ROW_S, Flight, segments
from cfid.flight.search import most_explained

LEAST_LIFT_MPS2 = 1.0  # root mean square of the rotors' vertical effect; see docs/decisions/0022
CLIMB = "climb and drop quickly, once or twice a second, for 20 s"
LOOSE = 0.1  # of a value: the largest accepted standard uncertainty
LEAST_TURN_RAD_PER_S2 = 5.0  # root mean square; at 0.6 about yaw a public log gave 8e-5 kg m^2, others publish 3e-5
# Of a value: the largest uncertainty, scaled to 20 s, that is accepted with less motion; flights that hover have 0.09
# and more.
CLEAR = 0.06
_CLEAR_S = 20.0
# The part of the sensor's variance from which air matters little, however small the rotors' effect is. Simulated
# flights with gentle tilts, 1 to 5 rad/s^2, have 0.99 for rates and 0.95 for the force, those that hover 0.8 at most.
CALM = 0.9


class Motion(NamedTuple):
    """The rotors' effect along the vertical, in m/s^2, or about an axis, in rad/s^2, and its part of the whole motion.

    `moved` is a root mean square, `explained` a part of the variance of means over 0.1 s, `open` the relative standard
    uncertainty of a rotor's effect per drive, and `unclear` the same uncertainty scaled to 20 s of such flight.
    """

    name: str
    moved: float
    least: float
    explained: float
    open: float
    unclear: float

    @property
    def is_large(self) -> bool:
        """Whether rotors moved the vehicle more than an autopilot's responses to air do, or air and noise are small."""
        calm = self.explained >= CALM or (self.explained >= EXPLAINED and self.unclear < CLEAR)
        return self.moved >= self.least or calm

    @property
    def tells(self) -> bool:
        """Whether the sensor shows the effect of a rotor's drive."""
        return self.is_large and self.explained >= EXPLAINED and self.open < LOOSE


def refuse_still(flights: Sequence[Flight]) -> None:
    """Raise FitError where in no flight rotors explain half of the part required of a thrust, whatever their lag.

    A fit to such flights takes many rounds or never converges, and all its results depend on the thrust.
    """
    least = EXPLAINED / 2  # half, because lags are tried by factors of two
    flown = [Equations([equations_of(flight)]) for flight in flights if segments(flight.driven)]
    most = max((most_explained(one, enough=least) for one in flown), default=least)
    if most < least:
        raise FitError(
            f"thrust is not excited: rotors explain {100 * most:.0f} % of the vertical force at most (at least "
            f"{100 * EXPLAINED:.0f} %), whatever their lag: {CLIMB}. Moments need the thrust."
        )


def lifted(found: FlightFit) -> bool:
    """Return whether rotors moved the vehicle up and down enough to fit their thrust."""
    return found.excitation["vertical"] >= LEAST_LIFT_MPS2 and found.explained >= EXPLAINED


def climbing(found: FlightFit) -> Motion:
    """Return the rotors' effect along the vertical."""
    return _motion(found, "vertical", None, LEAST_LIFT_MPS2, found.explained)


def turnings(found: FlightFit) -> list[Motion]:
    """Return the rotors' effect about each axis."""
    return [
        _motion(found, axis, place, LEAST_TURN_RAD_PER_S2, explained_of(found.blocks, place))
        for place, axis in enumerate(AXES)
    ]


def _motion(found: FlightFit, name: str, place: int | None, least: float, explained: float) -> Motion:
    is_open = _open(found, place)
    unclear = is_open * math.sqrt(found.rows * ROW_S / _CLEAR_S)
    return Motion(name, found.excitation[name], least, explained, is_open, unclear)


def _open(found: FlightFit, place: int | None) -> float:
    """Return the relative standard uncertainty of a drive's effect: thrust's slope, times the gain about an axis."""
    slope = np.array([0.0, 1.0, 2 * found.drive])
    lift, gain = float(slope @ found.thrust), 1.0 if place is None else float(found.values[TURNS][place])
    if lift == 0 or gain == 0:
        return math.inf
    shares = np.zeros(len(found.values))
    shares[THRUST] = slope / lift
    if place is not None:
        shares[TURNS.start + place] = 1 / gain
    return math.sqrt(float(shares @ found.covariance @ shares))
