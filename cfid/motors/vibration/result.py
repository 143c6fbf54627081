"""Rotor speeds in a load cell's record, in the contract's keys."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cfid.errors import CfidError, DataError
from cfid.findings import Finding, rejection, warning
from cfid.motors.data import RunStaircase, reduce_run
from cfid.motors.vibration.data import Rotors, VibrationRecord
from cfid.motors.vibration.estimation import KEY, RotorSpeed
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import WrenchRecord, wrench_of
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result
from cfid.records.run import Run

_APART = 0.02  # share of the reported speed from which vibration contradicts it


@dataclass(frozen=True, kw_only=True)
class RotorWindow:
    """The speed found in one window, and what a tachometer or the vehicle reported there."""

    command: int | None
    begin_s: float
    end_s: float
    speed: RotorSpeed
    reported_rad_s: float | None = None

    @property
    def place(self) -> str:
        """The name of the window."""
        return f"{self.begin_s:.2f} to {self.end_s:.2f} s" if self.command is None else f"command {self.command}"

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings about the window; a rejection concerns this window alone, and becomes a warning for the record."""
        found = [replace(one, severity=_severity_of_window(one), where=(self.place,)) for one in self.speed.findings]
        if self.reported_rad_s and self.speed.accepted:
            off = self.speed.speed_rad_per_s / self.reported_rad_s - 1
            text = f"vibration and tachometer differ by {100 * off:+.1f} %."
            found += [warning("vibration-against-tachometer", text, KEY).at(self.place)] if abs(off) >= _APART else []
        return tuple(found)


def fit(
    recording: WrenchRecord | Run | Path | str,
    *,
    rotors: Rotors | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
) -> Result:
    """Return the rotors' speeds in each steady window of a recording, or from `from_s` to `to_s`.

    Without `rotors`, their number is that which the run states, or else one. Raises DataError for a recording that
    cannot be read or has no window, FitError where no step settles.
    """
    record = _record(recording)
    staircase = reduce_run(record) if from_s is None and to_s is None else None
    try:
        rest_s = 0.0 if staircase is None else staircase.reduced.rest_s
        vibration = VibrationRecord(record, rotors or Rotors(), rest_s=rest_s)
        windows = [_between(record, vibration, from_s, to_s)] if staircase is None else _steps(staircase, vibration)
    except CfidError as error:
        raise type(error)(f"{record.path}: {error}") from None
    rejected = [one for one in windows if not one.speed.accepted]
    none = (rejection("vibration-no-window", "no window shows a rotor's speed.", "rotor.*"),)

    def drawings() -> Figures:
        from cfid.motors.vibration.figures import rotor_figure

        last = windows[-1]
        title = record.name if last.command is None else f"{record.name}, command {last.command}"
        speed, window_s = last.speed.speed_rad_per_s, (last.begin_s, last.end_s)
        return {f"fit_rotor_{record.name}": rotor_figure(record, window_s, speed_rad_per_s=speed, title=title)}

    return Result(
        command="fit speed",
        section="rotor",
        prints_lines=True,
        method="default",
        quantities=_quantities(windows),
        wanted=(KEY,),
        merits={"windows": len(windows), "rejected": len(rejected)},
        findings=(
            *record.findings,
            *(finding for one in windows for finding in one.findings),
            *(none if len(rejected) == len(windows) else ()),
        ),
        sources=(record.source,) if staircase is None else staircase.sources,
        lines=tuple(Dependent(_line(one), KEY) for one in windows if one.speed.accepted),
        drawings=drawings,
    )


def _record(recording: WrenchRecord | Run | Path | str) -> WrenchRecord:
    if isinstance(recording, WrenchRecord):
        return recording
    return wrench_of(read_recording(recording.folder if isinstance(recording, Run) else recording))


def _between(record: WrenchRecord, vibration: VibrationRecord, from_s: float | None, to_s: float | None) -> RotorWindow:
    begin_s, end_s = from_s or 0.0, float(record.time_s[-1]) if to_s is None else to_s
    if begin_s >= end_s:
        raise DataError(f"the window from {begin_s:g} to {end_s:g} s contains no samples.")
    speed = vibration.speed_in(begin_s, end_s, rotors=1)
    return RotorWindow(command=None, begin_s=begin_s, end_s=end_s, speed=speed)


def _steps(staircase: RunStaircase, vibration: VibrationRecord) -> list[RotorWindow]:
    """Return the speed found in the steady window of each step."""
    points = staircase.reduced.steady()
    reported = staircase.reported_speeds(points)
    speeds = [math.nan] * len(points) if reported is None else reported.tolist()
    return [
        RotorWindow(
            command=point.command,
            begin_s=point.begin_s,
            end_s=point.end_s,
            speed=vibration.speed_of_step(point),
            reported_rad_s=None if math.isnan(speed) else speed,
        )
        for point, speed in zip(points, speeds, strict=True)
    ]


def _severity_of_window(finding: Finding) -> Any:
    return "warning" if finding.severity == "rejection" else finding.severity


def _quantities(windows: Sequence[RotorWindow]) -> dict[str, Parameter]:
    """Return the speeds, NaN in rejected windows; where all windows are rejected, so is the whole key."""
    some = any(one.speed.accepted for one in windows)
    given = np.array([one.speed.accepted or not some for one in windows])
    value = np.where(given, [one.speed.speed_rad_per_s for one in windows], math.nan).tolist()
    std = np.where(given, [one.speed.std_rad_per_s for one in windows], math.nan).tolist()
    rows = [
        {
            "cmd": one.command,
            "speed_rad_s": one.speed.speed_rad_per_s,
            "std_rad_s": one.speed.std_rad_per_s,
            "tachometer_rad_s": one.reported_rad_s,
            "rotors": len(one.speed.rotors),
            "from_s": one.begin_s,
            "to_s": one.end_s,
            "accepted": one.speed.accepted,
        }
        for one in windows
    ]
    only = len(windows) == 1
    speed = Parameter(value=value[0] if only else value, std=std[0] if only else std)
    return {KEY: speed, "rotor.windows": Parameter(value=rows)}


def _line(one: RotorWindow) -> str:
    speed = one.speed
    apart = "" if speed.resolved else ", rotors not resolved"
    tachometer = "" if one.reported_rad_s is None else f", tachometer {one.reported_rad_s:.1f} rad/s"
    return f"{one.place}: {speed.speed_rad_per_s:.2f} +- {speed.std_rad_per_s:.2g} rad/s{apart}{tachometer}"
