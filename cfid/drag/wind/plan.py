"""A run of `cfid log wind`: what was asked of it, and which of the thesis' runs a campaign has already."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.options import finite
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.drag.wind.campaign_plan import PlannedRun
    from cfid.records.run import Run

KIND = "wind"

AzimuthRad = Annotated[float | None, typer.Option(hidden=True, help="The azimuth in radians, as version 0.1 had it.")]


def azimuth(in_deg: float | None, in_rad: float | None) -> float | None:
    """Return the azimuth in degrees that --azimuth-deg or --azimuth-rad states. Raises ConfigError for both."""
    if in_deg is not None and in_rad is not None:
        raise ConfigError("--azimuth-deg and --azimuth-rad are the same: give one of them.")
    if in_rad is not None:
        return math.degrees(finite(in_rad, "--azimuth-rad"))
    return None if in_deg is None else finite(in_deg, "--azimuth-deg")


@dataclass(frozen=True, kw_only=True)
class WindSetting:
    """One wind setting as the operator set and read it; wind 0 is a reference, which has no angle."""

    angle_deg: float | None
    fan_v: float
    min_mps: float
    max_mps: float
    azimuth_deg: float | None = None

    @property
    def asked(self) -> dict[str, Any]:
        """What run.toml says of it."""
        told = {
            "angle_deg": self.angle_deg,
            "fan_v": self.fan_v,
            "wind_min_mps": self.min_mps,
            "wind_max_mps": self.max_mps,
            "azimuth_deg": self.azimuth_deg,
        }
        return {name: value for name, value in told.items() if value is not None}

    @property
    def sentence(self) -> str:
        """What it is, for a person."""
        if self.max_mps == 0:
            return "no wind (references)"
        return (
            f"wind of {self.min_mps:g} to {self.max_mps:g} m/s at {self.angle_deg:g} degrees, fan at {self.fan_v:g} V"
        )


def setting_of(run: "Run") -> WindSetting:
    """Return the wind setting of a run. Raises DataError when it is no run of `cfid log wind`."""
    asked = run.header.asked
    try:
        if run.header.kind != KIND:
            raise KeyError
        return WindSetting(
            angle_deg=None if asked.get("angle_deg") is None else float(asked["angle_deg"]),
            fan_v=float(asked.get("fan_v", 0.0)),
            min_mps=float(asked["wind_min_mps"]),
            max_mps=float(asked["wind_max_mps"]),
            azimuth_deg=_azimuth_deg(asked),
        )
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{run.folder}: is no run of `cfid log wind` that says its wind.") from None


def _azimuth_deg(asked: Mapping[str, Any]) -> float | None:
    """Return the azimuth that a run states; version 0.1 wrote it in radians."""
    if asked.get("azimuth_rad") is not None:
        return math.degrees(asked["azimuth_rad"])
    return None if asked.get("azimuth_deg") is None else float(asked["azimuth_deg"])


def recorded(runs: "Sequence[Run]") -> "list[PlannedRun]":
    """Return what runs of `cfid log wind` hold of a campaign: each command that was held to its end."""
    from cfid.drag.wind.campaign_plan import PlannedRun
    from cfid.motors.resume import held_steps

    found = []
    for run in runs:
        with suppress(DataError):  # a run that cannot be read is told where it is looked at
            setting = setting_of(run)
            angle_deg, fan_v = (setting.angle_deg, setting.fan_v) if setting.max_mps > 0 else (None, 0.0)
            found += [PlannedRun(command, angle_deg, fan_v) for command in held_steps(run)]
    return found


def missing_lines(done: "Sequence[PlannedRun]") -> list[str]:
    """Return what of the thesis' 112 runs is still missing, a line a wind setting."""
    from cfid.drag.wind.campaign_plan import THESIS_COMMANDS, missing_runs, thesis_plan

    plan, left = thesis_plan(), missing_runs(done)
    if not left:
        return [f"all {len(plan)} runs of the thesis' plan are recorded."]
    settings = dict.fromkeys((run.angle_deg, run.fan_v) for run in plan)
    lines = [f"of the thesis' {len(plan)} runs {len(plan) - len(left)} are recorded, missing are:"]
    for angle_deg, fan_v in settings:
        commands = [run.command for run in left if (run.angle_deg, run.fan_v) == (angle_deg, fan_v)]
        if commands:
            where = "no wind" if angle_deg is None else f"{angle_deg:g} deg, {fan_v:g} V"
            all_of_them = Counter(commands) == Counter(THESIS_COMMANDS)
            lines.append(f"  {where:15} {'all commands' if all_of_them else ', '.join(map(str, commands))}")
    return lines
