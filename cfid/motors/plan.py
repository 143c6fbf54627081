"""The request of a staircase of motor commands, and the missing steps of an interrupted one."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cfid.errors import ConfigError
from cfid.estimate.battery_endurance import Held
from cfid.records.resumed import RESUMES, recorded_after
from cfid.records.run import Run, read_run
from cfid.records.steps import steps_lacking, steps_left

FEWEST_COMMANDS = {"thrust": 3, "speed": 2}  # above the dead zone: coefficients of the map of each kind
LONGEST_STEP_S = 3600.0  # longer than any battery lasts: a slip of the keyboard


@dataclass(frozen=True, kw_only=True)
class StaircasePlan:
    """Commands in turn for some of the motors, each held, with a pause (motors off) before, between and after.

    `resumes` is the name of the run that it completes.
    """

    steps: tuple[int, ...]
    motors: tuple[int, ...]
    hold_s: float
    rest_s: float
    resumes: str = ""

    @classmethod
    def of_run(cls, run: Run) -> "StaircasePlan":
        """Return the staircase that run.toml states.

        Raises KeyError for a run of something else, TypeError or ValueError for what are no numbers.
        """
        request = run.header.requested
        steps, motors = tuple(map(int, request["steps"])), tuple(map(int, request["motors"]))
        return cls(steps=steps, motors=motors, hold_s=float(request["hold_s"]), rest_s=float(request["rest_s"]))

    @property
    def duration_s(self) -> float:
        """How long it takes."""
        return self.rest_s + len(self.steps) * (self.hold_s + self.rest_s)

    @property
    def held(self) -> list[Held]:
        """What draws current: each command, and the pauses."""
        steps = [Held(step, len(self.motors), self.hold_s) for step in self.steps]
        return [*steps, Held(0, 0, self.duration_s - len(steps) * self.hold_s)]

    def to_run(self) -> dict[str, Any]:
        """Return what run.toml states of it."""
        own = {"steps": self.steps, "motors": self.motors, "hold_s": self.hold_s, "rest_s": self.rest_s}
        return own | ({RESUMES: self.resumes} if self.resumes else {})


def missing(folder: Path, *, kind: str) -> StaircasePlan:
    """Return the staircase of a run without the steps that it has a typed reading of, or held to their end.

    The latter counts where no reading was requested. What runs that complete it have is not missing either. Raises
    ConfigError when the run is no staircase of this kind, is complete, or has every step.
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
