"""What an instrument can show at a motor's command: a reading beyond that was most likely mistyped."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cfid.quantities.platforms import Platform
from cfid.quantities.plausible import out_of_range, range_of
from cfid.quantities.quantity import Range
from cfid.units import RPM, USUAL_GRAVITY_MPS2


@dataclass(frozen=True, kw_only=True)
class Expected:
    """The largest plausible reading in `unit`, and how far one can be from the others, None where that says nothing."""

    unit: str
    most: float
    change: float | None = None

    def fault(self, reading: float, others: Sequence[float] = (), *, command: float | None = None) -> str:
        """Return why a reading is implausible beside the others as a sentence, "" where it is plausible.

        At command 0 a tachometer shows 0: another reading there is most likely that of another step.
        """
        if self.change is None and command == 0 and reading:
            shown = f"{reading:g} {self.unit}"
            return f"the reading is implausible, {shown} of a rotor that stands. Expected 0 {self.unit}."
        if self.change is None or not others:
            return out_of_range("the reading is implausible", reading, Range(0, self.most, "what turns"), self.unit)
        usual = float(np.median(others))
        claim = f"the reading {reading:g} {self.unit} is implausible: its distance from the others ({usual:g})"
        return out_of_range(claim, abs(reading - usual), Range(0, self.change, "the motors' thrust"), self.unit)


def expected_of(column: str, *, motors: int, markers: int | None, platform: Platform) -> Expected | None:
    """Return what a tachometer (`rpm`) or scales (`grams`) can show of some motors; None of any other body.

    Scales may carry a stand: a first reading is compared with the vehicle's mass, later ones with each other.
    """
    ranges = [range_of(key, platform) for key in ("motor.speed_poly", "motor.max_thrust_n", "mass_kg")]
    if platform == "other" or any(one is None for one in ranges):
        return None
    speed, thrust, mass = (one.largest for one in ranges if one is not None)
    if column == "rpm":
        return Expected(unit="rpm", most=speed / RPM * (markers or 1))
    change = 1e3 * motors * thrust / USUAL_GRAVITY_MPS2
    return Expected(unit="g", most=1e3 * mass + change, change=change)
