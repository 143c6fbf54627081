"""The requested staircase of motor commands."""

from dataclasses import dataclass
from typing import Any

from cfid.estimate.battery_endurance import Held
from cfid.recordings.resumed import RESUMES
from cfid.records.run import Run

FEWEST_COMMANDS = {"thrust": 3, "speed": 2}  # above the dead zone: as many as the map of each kind has coefficients
LONGEST_STEP_S = 3600.0  # longer than any battery lasts: a larger value is a typing error
WAIT_S, LONGEST_WAIT_S = 60.0, 600.0  # for a typed reading while motors run; a battery lasts for ten minutes at most


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
        own: dict[str, Any] = {"steps": self.steps, "motors": self.motors, "hold_s": self.hold_s, "rest_s": self.rest_s}
        own |= {} if self.wait_s is None else {"wait_s": self.wait_s}
        return own | ({RESUMES: self.resumes} if self.resumes else {})
