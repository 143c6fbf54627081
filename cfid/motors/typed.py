"""What an instrument can show at a motor's command: a reading outside that range was most likely mistyped."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cfid.quantities.plausible import out_of_range
from cfid.quantities.registry import Platform, Range, range_of
from cfid.units import RPM, USUAL_GRAVITY_MPS2

_SLOWER, _FASTER = 2.0, 5.0  # than in proportion to the command: more than starts, dead zones and batteries cause


@dataclass(frozen=True, kw_only=True)
class Expected:
    """The largest plausible reading in `unit`, and its largest distance from the others (None: other rules apply)."""

    unit: str
    most: float
    change: float | None = None

    def fault(
        self,
        reading: float,
        others: Sequence[float] = (),
        *,
        command: float | None = None,
        commands: Sequence[float] = (),
    ) -> str:
        """Return a sentence on why a reading is implausible given the others, "" where it is plausible.

        At command 0 a tachometer shows 0: any other reading there most likely belongs to another step. Where the
        `commands` of the others are given, the reading is compared with the one at the nearest command: a digit may be
        missing, or one too many.
        """
        if self.change is None and command == 0 and reading:
            shown = f"{reading:g} {self.unit}"
            return f"the reading is implausible, {shown} of a rotor that stands. Expected 0 {self.unit}."
        if self.change is None and command and (mistyped := self._mistyped(reading, others, command, commands)):
            return mistyped
        if self.change is None or not others:
            return out_of_range("the reading is implausible", reading, Range(0, self.most, "what turns"), self.unit)
        usual = float(np.median(others))
        claim = f"the reading {reading:g} {self.unit} is implausible: its distance from the others ({usual:g})"
        return out_of_range(claim, abs(reading - usual), Range(0, self.change, "the motors' thrust"), self.unit)

    def _mistyped(self, speed: float, others: Sequence[float], command: float, commands: Sequence[float]) -> str:
        near = [
            (abs(command - at), at, value)
            for at, value in zip(commands, others, strict=False)
            if at and 0 < value <= self.most
        ]
        if not near:
            return ""
        _, at, usual = min(near)
        low, high = usual * min(command / at, 1) / _SLOWER, usual * max(command / at, 1) * _FASTER
        if low <= speed <= high:
            return ""
        return (
            f"the reading {speed:g} {self.unit} is implausible beside {usual:g} at command {at:g}. Expected {low:.0f} "
            f"to {high:.0f} {self.unit}."
        )


def expected_of(column: str, *, motors: int, markers: int | None, platform: Platform) -> Expected | None:
    """Return what a tachometer (`rpm`) or scales (`grams`) can show for some motors; None for an unknown platform.

    Scales may also carry a stand: a first reading is compared with the vehicle's mass, later ones with each other.
    """
    ranges = [range_of(key, platform) for key in ("motor.speed_poly", "motor.max_thrust_n", "mass_kg")]
    if platform == "other" or any(one is None for one in ranges):
        return None
    speed, thrust, mass = (one.largest for one in ranges if one is not None)
    if column == "rpm":
        return Expected(unit="rpm", most=speed / RPM * (markers or 1))
    change = 1e3 * motors * thrust / USUAL_GRAVITY_MPS2
    return Expected(unit="g", most=1e3 * mass + change, change=change)
