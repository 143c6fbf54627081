"""The requested staircase of motor commands: its steps, those that an interrupted run lacks, and plausible readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cfid.errors import ConfigError
from cfid.estimate.battery_endurance import Held
from cfid.quantities.plausible import out_of_range
from cfid.quantities.registry import Platform, Range, range_of
from cfid.recordings.resumed import RESUMES, recorded_after, steps_lacking, steps_left
from cfid.records.run import Run, read_run
from cfid.units import RPM, USUAL_GRAVITY_MPS2

FEWEST_COMMANDS = {"thrust": 3, "speed": 2}  # above the dead zone: as many as the map of each kind has coefficients
LONGEST_STEP_S = 3600.0  # longer than any battery lasts: a larger value is a typing error
WAIT_S, LONGEST_WAIT_S = 60.0, 600.0  # for a typed reading while motors run; a battery lasts for ten minutes at most

_SLOWER, _FASTER = 2.0, 5.0  # than in proportion to the command: more than starts, dead zones and batteries cause


@dataclass(frozen=True, kw_only=True)
class StaircasePlan:
    """Commands for some of the motors, held one after the other, with pauses (motors off) before, between and after.

    Where readings are typed, a command is held for `wait_s` more at most, until its reading; then motors pause until
    the operator resumes. It is None where none are. `resumes` is the name of the run that this staircase completes.
    """

    steps: tuple[int, ...]
    motors: tuple[int, ...]
    hold_s: float
    rest_s: float
    wait_s: float | None = None
    resumes: str = ""

    @classmethod
    def of_run(cls, run: Run) -> "StaircasePlan":
        """Return the staircase that run.toml states.

        Raises KeyError for a run without a staircase, TypeError or ValueError for values that are not numbers.
        """
        request = run.header.requested
        steps, motors = tuple(map(int, request["steps"])), tuple(map(int, request["motors"]))
        return cls(steps=steps, motors=motors, hold_s=float(request["hold_s"]), rest_s=float(request["rest_s"]))

    @property
    def duration_s(self) -> float:
        """The duration of the staircase."""
        return self.rest_s + len(self.steps) * (self.hold_s + self.rest_s)

    @property
    def held(self) -> list[Held]:
        """The loads that draw current: each command, and the pauses."""
        steps = [Held(step, len(self.motors), self.hold_s) for step in self.steps]
        return [*steps, Held(0, 0, self.duration_s - len(steps) * self.hold_s)]

    def to_run(self) -> dict[str, Any]:
        """Return what run.toml states about the staircase."""
        stated: dict[str, Any] = {
            "steps": self.steps, "motors": self.motors, "hold_s": self.hold_s, "rest_s": self.rest_s
        }  # fmt: skip
        stated |= {} if self.wait_s is None else {"wait_s": self.wait_s}
        return stated | ({RESUMES: self.resumes} if self.resumes else {})


def missing(folder: Path, *, kind: str) -> StaircasePlan:
    """Return the steps of an interrupted run that are still to be recorded, as a staircase.

    A step is recorded if it has a typed reading or, in a run without typed readings, if it was held to its end. Steps
    in later runs that resume this one count as recorded, too. Raises ConfigError when the run is no staircase of this
    kind, is complete, or has every step.
    """
    run = read_run(folder)
    if run.header.kind != kind or not {"steps", "motors", "hold_s", "rest_s"} <= set(run.header.requested):
        raise ConfigError(f"{folder}: is no run of `cfid log {kind}` that could be resumed.")
    try:
        before = StaircasePlan.of_run(run)
    except (TypeError, ValueError):
        raise ConfigError(f"{folder}: run.toml states no staircase that could be resumed.") from None
    if run.header.state == "complete":
        raise ConfigError(f"{folder}: is complete; nothing is left to record.")
    left = steps_left(run)
    if not any(left):
        raise ConfigError(
            f"{folder}: has every step, though it ended early; nothing is left to record. Name it to the fit: "
            f"{run.folder.resolve().name}."
        )
    later = recorded_after(run)
    lacking = steps_lacking(run, later)
    if not any(lacking):
        raise ConfigError(f"{folder}: {later[-1].folder.name} completes it; nothing is left to record.")
    return replace(before, steps=lacking, resumes=(later or [run])[-1].folder.resolve().name)


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
