"""Describe the wind setting of a run, which the operator states, and the thesis' plan of 112 runs (section 4.4.2)."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

from cfid.errors import DataError
from cfid.recordings.resumed import held_steps, steps_left
from cfid.records.campaign import Campaign
from cfid.records.run import Run, list_runs

KIND = "wind"
HIGHEST_DEG = 180.0  # of the wind generator to the vertical: directly below
FASTEST_MPS = 100.0  # a faster wind is in another unit
THESIS_COMMANDS = (0, 10000, 20000, 30000, 37300, 40000, 50000)


@dataclass(frozen=True, kw_only=True)
class WindSetting:
    """Place and voltage of the wind generator, and the lowest and highest wind speed read around the vehicle.

    Wind 0 is a reference, which has no angle. The angle counts from the vertical, the azimuth about z to the right of
    the nose; an azimuth of None means that of the rig.
    """

    angle_deg: float | None = None
    fan_v: float = 0.0
    min_mps: float = 0.0
    max_mps: float = 0.0
    azimuth_deg: float | None = None

    @property
    def is_reference(self) -> bool:
        """Whether there is no wind."""
        return self.max_mps == 0

    def to_run(self) -> dict[str, Any]:
        """Return the entries of run.toml for this setting."""
        entries = {
            "angle_deg": self.angle_deg,
            "fan_v": self.fan_v,
            "wind_min_mps": self.min_mps,
            "wind_max_mps": self.max_mps,
            "azimuth_deg": self.azimuth_deg,
        }
        return {name: value for name, value in entries.items() if value is not None}

    @property
    def sentence(self) -> str:
        """The setting in words."""
        if self.is_reference:
            return "no wind (references)"
        to = "" if self.max_mps == self.min_mps else f" to {self.max_mps:g}"
        return f"wind of {self.min_mps:g}{to} m/s at {self.angle_deg:g} degrees, fan at {self.fan_v:g} V"


class PlannedRun(NamedTuple):
    """One command in one wind setting; a reference, without wind, has neither angle nor voltage."""

    command: int
    angle_deg: float | None = None
    fan_v: float = 0.0


# Angle, voltage, and v_abs of C.3.1; the first two winds have a single reading.
THESIS_WINDS = tuple(
    WindSetting(angle_deg=angle_deg, fan_v=fan_v, min_mps=min_mps, max_mps=max_mps)
    for angle_deg, fan_v, min_mps, max_mps in (
        (0.0, 5, 1.5, 1.5),
        (0.0, 6, 2.25, 2.25),
        (0.0, 8, 2.8, 3.6),
        (0.0, 10, 3.1, 4.2),
        (0.0, 12, 3.7, 5.1),
        (48.4, 5, 1.0, 1.8),
        (48.4, 6, 1.6, 2.8),
        (48.4, 8, 2.0, 3.7),
        (48.4, 10, 2.8, 4.3),
        (48.4, 12, 3.3, 5.0),
        (77.9, 5, 1.4, 1.8),
        (77.9, 6, 1.8, 2.5),
        (77.9, 8, 2.2, 3.4),
        (77.9, 10, 2.6, 4.0),
        (77.9, 12, 3.0, 4.5),
    )
)


def thesis_plan() -> tuple[PlannedRun, ...]:
    """Return the 112 runs in the order of section 4.4.2: seven references, then setting by setting."""
    settings = (WindSetting(), *THESIS_WINDS)
    return tuple(PlannedRun(command, at.angle_deg, at.fan_v) for at in settings for command in THESIS_COMMANDS)


def missing_runs(done: Iterable[PlannedRun], plan: Iterable[PlannedRun] = thesis_plan()) -> tuple[PlannedRun, ...]:
    """Return the runs of a plan, in its order, that have not been recorded; runs outside the plan do not count."""
    left = Counter(done)
    missing = []
    for run in plan:
        if left[run] > 0:
            left[run] -= 1
        else:
            missing.append(run)
    return tuple(missing)


def missing_lines(done: Sequence[PlannedRun]) -> list[str]:
    """Return lines on the runs of the thesis' 112 that are still missing, one line per wind setting."""
    plan, left = thesis_plan(), missing_runs(done)
    if not left:
        return [f"all {len(plan)} runs of the thesis' plan are recorded."]
    lines = [f"{len(plan) - len(left)} of {len(plan)} runs of the thesis' plan are recorded. Missing:"]
    for angle_deg, fan_v in dict.fromkeys((run.angle_deg, run.fan_v) for run in left):
        commands = tuple(run.command for run in left if (run.angle_deg, run.fan_v) == (angle_deg, fan_v))
        where = "no wind" if angle_deg is None else f"{angle_deg:g} deg, {fan_v:g} V"
        lines.append(f"  {where:15} {'all commands' if commands == THESIS_COMMANDS else ', '.join(map(str, commands))}")
    return lines


def setting_of(run: Run) -> WindSetting:
    """Return the wind setting of a run. Raises DataError when it is not a wind run."""
    request = run.header.requested
    try:
        if run.header.kind != KIND:
            raise KeyError
        return WindSetting(
            angle_deg=None if request.get("angle_deg") is None else float(request["angle_deg"]),
            fan_v=float(request.get("fan_v", 0.0)),
            min_mps=float(request["wind_min_mps"]),
            max_mps=float(request["wind_max_mps"]),
            azimuth_deg=_azimuth_deg(request),
        )
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{run.folder}: not a run of `cfid log wind` that states its wind.") from None


def wind_runs(campaign: Campaign, *, simulated: bool) -> list[Run]:
    """Return the campaign's wind runs on this kind of rig: simulated runs count for a simulated rig only."""
    runs = [run for run in list_runs(campaign.runs_folder) if isinstance(run, Run)]
    same = [run for run in runs if run.header.kind == KIND and run.header.simulated == simulated]
    return [run for run in same if not run.header.excluded]


def recorded(runs: Sequence[Run]) -> list[PlannedRun]:
    """Return each command that runs held to its end, with its wind setting.

    In a run that ended early, the commands count that `--resume` would not hold again.
    """
    commands = []
    for run in runs:
        with suppress(DataError):  # errors in a run are reported by its fit
            setting = setting_of(run)
            place = (None, 0.0) if setting.is_reference else (setting.angle_deg, setting.fan_v)
            commands += [PlannedRun(command, *place) for command in _done(run)]
    return commands


def _done(run: Run) -> list[int]:
    """Return the commands that a run has. Raises the same errors as `held_steps`."""
    if run.header.state == "complete":  # where no reading was typed, vibration shows the speed
        return held_steps(run)
    return list((Counter(map(int, run.header.requested["steps"])) - Counter(steps_left(run))).elements())


def _azimuth_deg(request: Mapping[str, Any]) -> float | None:
    """Return the azimuth that a run states; version 0.1 wrote it in radians."""
    if request.get("azimuth_rad") is not None:
        return math.degrees(request["azimuth_rad"])
    return None if request.get("azimuth_deg") is None else float(request["azimuth_deg"])
