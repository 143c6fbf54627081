"""What scales under the vehicle showed in a staircase, and the thrusts that follow from it (section 3.3.1)."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError, FitError
from cfid.findings import Finding
from cfid.motors.points import Points, frame
from cfid.recordings.resumed import with_completed
from cfid.recordings.vehicle import (
    READINGS,
    SCALES,
    VEHICLE_LOG,
    TakenBackError,
    holds,
    read_rows,
    shown_at_commands,
)
from cfid.records.parameters import Source
from cfid.records.rig_file import RigFacts
from cfid.records.run import Run
from cfid.units import DEAD_COMMAND

Array = npt.NDArray[np.float64]

STANDING_N = 1e-3  # less than any motor that turns gives: 0.1 g
_DIGITS_G = [first * 10.0**power for power in range(1, -4, -1) for first in (5, 2, 1)]  # the last digit of a display
_COMPARED = ("command", "grams")
_LOOKED_S = 1.0  # before a reading: the battery's voltage that belongs to it


class _Readings(NamedTuple):
    """Commands (n,), grams (n,) and logged volts (n,) of a run, and the last digit of its display in g."""

    command: Array
    grams: Array
    volts: Array | None
    digit_g: float
    source: Source
    findings: tuple[Finding, ...]


class WeighedThrusts(NamedTuple):
    """Points of one motor by scales, the file that they come from, and findings about it."""

    points: Points
    source: Source
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class Weighing:
    """Commands (n,), grams (n,) that scales showed, how many motors ran, and the facts of the rig.

    `rest_g` (n,) is the weight at rest with which each reading is compared, None where that is the mean of the readings
    at rest. `parts` maps the name of each run to its commands.
    """

    command: Array
    grams: Array
    motors: int
    facts: RigFacts
    rest_g: Array | None = None
    parts: Mapping[str, Array] = field(default_factory=dict)

    def thrust_n(self, gravity_mps2: float) -> Array:
        """Return one motor's thrusts (n,). Raises as `scales_thrust_n`."""
        return scales_thrust_n(
            self.command, self.grams, motors=self.motors, gravity_mps2=gravity_mps2, rest_g=self.rest_g
        )


def weighing_of(run: Run) -> Weighing:
    """Return what scales showed in a run and in those that it completes.

    Each part is compared with its own weight at rest, since the vehicle may have been set down anew; a part without a
    reading at rest is compared with that of the part before. Raises DataError.
    """
    return _weighing(run, _readings(run))


def _weighing(run: Run, readings: Mapping[str, _Readings]) -> Weighing:
    """Put the readings of a run, and of those that it completes, together."""
    command, grams = (np.concatenate([getattr(part, name) for part in readings.values()]) for name in _COMPARED)
    return Weighing(
        command=command,
        grams=grams,
        motors=len(run.header.requested.get("motors", ())) or 1,
        facts=run.header.rig,
        rest_g=_rest_g(list(readings.values())),
        parts={name: part.command for name, part in readings.items()},
    )


def weighed_thrusts(run: Run, *, gravity_mps2: float) -> WeighedThrusts:
    """Return one motor's thrusts by the scales of a run, which is compared with a part's weight at rest if it has none.

    Raises as `thrust_points`.
    """
    readings = _readings(run)
    part = list(readings.values())[-1]
    points = thrust_points(
        _weighing(run, readings),
        last=len(part.command),
        shown_g=part.digit_g,
        gravity_mps2=gravity_mps2,
        volts=part.volts,
        source=str(run.folder),
    )
    return WeighedThrusts(points, part.source, part.findings)


def thrust_points(
    weighing: Weighing, *, last: int, shown_g: float, gravity_mps2: float, volts: Array | None, source: str
) -> Points:
    """Return one motor's thrusts by the `last` readings of scales, at logged voltages `volts` (last,).

    Their standard uncertainty is that of the last digit `shown_g`, at the reading and at rest; the latter is common to
    all. Raises FitError as `scales_thrust_n`.
    """
    command, thrust_n = weighing.command[-last:], weighing.thrust_n(gravity_mps2)[-last:]
    running = command > DEAD_COMMAND
    at_rest = max(int(np.count_nonzero(weighing.command <= DEAD_COMMAND)), 1)
    read_n = shown_g / math.sqrt(12) * 1e-3 * gravity_mps2 / weighing.motors
    count = int(np.count_nonzero(running))
    return frame(
        command[running],
        thrust_n=thrust_n[running],
        thrust_std_n=np.full(count, read_n * math.sqrt(1 + 1 / at_rest)),
        thrust_shared_n=np.full((count, 1), read_n / math.sqrt(at_rest)),
        motors=float(weighing.motors),
        vbat_v=None if volts is None else volts[running],
        source=source,
    )


def _readings(run: Run) -> dict[str, _Readings]:
    """Return what scales showed in each run that a run completes, and last in the run itself, by name."""
    readings: dict[str, _Readings] = {}
    for part in with_completed(run)[:-1]:
        with suppress(TakenBackError):
            if holds(part, READINGS) or holds(part, SCALES):
                readings[part.folder.resolve().name] = _readings_of(part)
    readings[run.folder.resolve().name] = _readings_of(run)
    return readings


def _rest_g(parts: Sequence[_Readings]) -> Array:
    """Return the weight at rest (n,) for each reading of some parts, nan where no part has one."""
    rests = [float(part.grams[at].mean()) if (at := part.command <= DEAD_COMMAND).any() else None for part in parts]
    rest_g, columns = next((rest for rest in rests if rest is not None), np.nan), list[Array]()
    for rest, part in zip(rests, parts, strict=True):
        rest_g = rest_g if rest is None else rest
        columns.append(np.full(len(part.command), rest_g))
    return np.concatenate(columns)


def _readings_of(run: Run) -> _Readings:
    """Return typed readings, or means of those that scales sent in the second half of each step."""
    if holds(run, READINGS):
        rows = read_rows(run, READINGS)
        if "grams" not in rows.columns:
            raise DataError(f"{rows.source.path}: no column 'grams': this is no run of `cfid log scales`.")
        command, grams, ends_s = rows.columns["command"], rows.columns["grams"], rows.time_s
    elif holds(run, SCALES):
        rows, command, grams, ends_s = shown_at_commands(run, SCALES, "grams")
    else:
        raise DataError(f"{run.folder}: holds no scales: `cfid log scales` records them.")
    shown_g = digit_g(rows.columns["grams"])
    return _Readings(command, grams, _volts(run, ends_s), shown_g, rows.source, rows.findings)


def digit_g(grams: Array) -> float:
    """Return the last digit of a display in g: the largest of which all readings (n,) are multiples."""
    whole = (g for g in _DIGITS_G if np.allclose(grams / g, np.round(grams / g), rtol=0, atol=1e-6))
    return next(whole, _DIGITS_G[-1])


def _volts(run: Run, ends_s: Array) -> Array | None:
    """Return the battery's mean voltage (n,) in the last second before each time (n,), None where none was logged."""
    log = read_rows(run, VEHICLE_LOG) if holds(run, VEHICLE_LOG) else None
    if log is None or "pm.vbat" not in log.columns:
        return None
    volts = log.columns["pm.vbat"]
    within = [(log.time_s > end_s - _LOOKED_S) & (log.time_s <= end_s) for end_s in ends_s]
    return np.array([volts[at].mean() if at.any() else np.nan for at in within])


def scales_thrust_n(
    command: Array, grams: Array, *, motors: int, gravity_mps2: float, rest_g: Array | None = None
) -> Array:
    """Return one motor's thrusts (n,) in N from readings of scales (n,), as the change of weight from motors at rest.

    Thrust reduces the weight; a reading that grows with the command is taken with the opposite sign. Readings of
    several recordings have a weight at rest `rest_g` (n,) each; otherwise it is the mean of the readings at rest.

    Raises FitError without a reading of motors at rest, and where the display stands still.
    """
    standing = command <= DEAD_COMMAND
    if not standing.any() or standing.all():
        raise FitError(
            f"scales show a change of weight: readings at command 0 and above {DEAD_COMMAND} are needed, and these "
            f"are from {command.min():.0f} to {command.max():.0f}."
        )
    lighter = (grams[standing].mean() if rest_g is None else rest_g) - grams
    upwards = math.copysign(1.0, float(lighter[~standing].sum()))
    thrust_n = np.asarray(upwards * lighter * 1e-3 * gravity_mps2 / motors)
    if np.abs(thrust_n).max() < STANDING_N:
        raise FitError(
            f"the scales show {grams.min():g} to {grams.max():g} g at every command from {command.min():.0f} to "
            f"{command.max():.0f}: the display stands still, or the motors never ran. A motor that turns changes it by "
            "0.1 g or more."
        )
    return thrust_n
