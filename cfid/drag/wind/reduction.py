"""From averaged load cell forces to drag experiments: body frame, thrust without wind subtracted, wind as a vector."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.drag.experiments import UNSTATED_WIND_STD, DragExperiments
from cfid.drag.wind.frames import (
    AZIMUTH_DEG,
    MARKERS,
    YAW_DEG,
    speed_sum_rad_s,
    std_turned_about_z,
    velocity_in_air,
    wind_speed,
)
from cfid.drag.wind.swaps import Filed, swap_doubts
from cfid.errors import DataError
from cfid.records.frames import turn_about_z
from cfid.units import DEAD_COMMAND

Array = npt.NDArray[np.float64]

_FASTEST_MPS = 100.0  # a wind that is more is one in another unit
_HIGHEST_DEG = 180.0  # of the wind generator to the vertical: straight below


@dataclass(frozen=True, kw_only=True)
class WindRun:
    """One run: what the operator set and read, and its mean force (3,) with deviation, in the load cell's frame.

    The force is that of a steady stretch less the tare. A reference has wind 0 to 0; its angle does not matter.
    `yaw_deg` turns it into the body frame; the wind came from `azimuth_deg`; the tachometer counted `markers` a turn.
    """

    name: str
    command: int
    angle_deg: float | None
    min_mps: float
    max_mps: float
    shown_rpm: float
    force_n: Array
    force_std_n: Array
    azimuth_deg: float = AZIMUTH_DEG
    yaw_deg: float = YAW_DEG
    markers: int = MARKERS

    @property
    def force_in_body_n(self) -> Array:
        """The force (3,) in the body frame."""
        return turn_about_z(self.force_n, yaw_deg=self.yaw_deg)

    @property
    def force_std_in_body_n(self) -> Array:
        """Its standard uncertainty (3,) on the body's axes."""
        return std_turned_about_z(self.force_std_n, yaw_deg=self.yaw_deg)

    @property
    def windy(self) -> bool:
        """Whether there was wind."""
        return self.max_mps > 0

    @property
    def standing(self) -> bool:
        """Whether the rotors stood."""
        return self.command <= DEAD_COMMAND


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """Experiments with the names (n,) of their runs; `notes` on what was left out or assumed, `doubts` of files."""

    experiments: DragExperiments
    names: tuple[str, ...]
    notes: tuple[str, ...]
    doubts: tuple[str, ...]


class _Reference(NamedTuple):
    name: str
    force_n: Array  # (3,), body frame
    std_n: Array


def reduce_runs(runs: Sequence[WindRun]) -> Reduction:
    """Turn forces into the body frame and subtract the mean of the references at the same command (section 4.4.3).

    At the same command whatever the angle: the thesis has one series without wind for all three. Runs with standing
    rotors hold no drag of rotors and are left out, as there.

    Raises DataError, with names, when a reference, an angle or a reading is missing.
    """
    _check(runs)
    standing = [run for run in runs if run.windy and run.standing]
    windy = [run for run in runs if run.windy and not run.standing]
    references = _references([run for run in runs if not run.windy])
    _check_angles(runs)
    _check_references(windy, references)
    experiments, notes = _experiments(windy, references)
    if standing:
        notes = (*notes, f"{len(standing)} run(s) in wind with standing rotors hold no drag of rotors: not used.")
    names = tuple(run.name for run in windy)
    thrusts = {command: (reference.name, reference.force_n) for command, reference in references.items()}
    doubts = swap_doubts(Filed(experiments=experiments, names=names, references=thrusts))
    return Reduction(experiments=experiments, names=names, notes=notes, doubts=doubts)


def _experiments(
    windy: Sequence[WindRun], references: Mapping[int, _Reference]
) -> tuple[DragExperiments, tuple[str, ...]]:
    speed = wind_speed(min_mps=[run.min_mps for run in windy], max_mps=[run.max_mps for run in windy])
    azimuth = np.array([run.azimuth_deg for run in windy])
    angle = np.array([run.angle_deg for run in windy], dtype=np.float64)
    settings = np.stack([angle, azimuth, speed.mean_mps, speed.std_mps], axis=1)
    spread, notes = _relative_spread(speed.std_mps / speed.mean_mps)
    thrusts = [references[run.command] for run in windy]
    own = np.array([run.force_std_in_body_n for run in windy])
    known = bool(np.all(own > 0))
    experiments = DragExperiments(
        command=np.array([run.command for run in windy], dtype=np.float64),
        angle_deg=angle,
        velocity_mps=velocity_in_air(
            speed_mps=speed.mean_mps, angle_rad=np.radians(angle), azimuth_rad=np.radians(azimuth)
        ),
        speed_sum_rad_s=speed_sum_rad_s([run.shown_rpm for run in windy], markers=[run.markers for run in windy]),
        force_n=np.array([run.force_in_body_n for run in windy]) - np.array([thrust.force_n for thrust in thrusts]),
        force_std_n=own if known else np.ones_like(own),
        reference_std_n=np.array([thrust.std_n for thrust in thrusts]) if known else np.ones_like(own),
        noise_known=known,
        setting=np.unique(settings, axis=0, return_inverse=True)[1].reshape(-1),
        wind_relative_std=spread,
    )
    return experiments, notes


def _references(runs: Sequence[WindRun]) -> dict[int, _Reference]:
    found = {}
    for command in {run.command for run in runs}:
        there = [run for run in runs if run.command == command]
        std = np.array([run.force_std_in_body_n for run in there])
        found[command] = _Reference(
            name=", ".join(run.name for run in there),
            force_n=np.mean([run.force_in_body_n for run in there], axis=0),
            std_n=np.linalg.norm(std, axis=0) / len(there),
        )
    return found


def _relative_spread(spread: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the wind's relative deviations (n,); where one reading says nothing of it, as that of the others is."""
    single = spread == 0
    if not single.any():
        return spread, ()
    usual = UNSTATED_WIND_STD if single.all() else float(np.median(spread[~single]))
    source = "by default" if single.all() else "as in the median of the others"
    note = f"{int(single.sum())} run(s) state one wind speed alone: {100 * usual:.2g} % deviation is taken, {source}."
    return np.where(single, usual, spread), (note,)


def _check(runs: Sequence[WindRun]) -> None:
    for run in runs:
        if math.isnan(run.min_mps) or math.isnan(run.max_mps):
            raise DataError(f"{run.name}: no wind speed: say its lowest and highest reading, 0 and 0 for a reference.")
        if run.max_mps > _FASTEST_MPS:
            raise DataError(f"{run.name}: wind of {run.max_mps:g} m/s: give it in m/s, up to {_FASTEST_MPS:g}.")
        if not 0 <= run.min_mps <= run.max_mps:
            raise DataError(
                f"{run.name}: wind between {run.min_mps:g} and {run.max_mps:g} m/s: give the lowest reading, then the "
                "highest, none below zero."
            )
        if not (np.all(np.isfinite(run.force_n)) and np.all(np.isfinite(run.force_std_n))):
            raise DataError(f"{run.name}: its mean force is no number: look at the recording and its window.")
        if run.windy and (run.angle_deg is None or not math.isfinite(run.angle_deg)):
            raise DataError(f"{run.name}: wind of {run.max_mps:g} m/s without an angle: say where it came from.")
        if run.windy and run.angle_deg is not None and not 0 <= run.angle_deg <= _HIGHEST_DEG:
            raise DataError(
                f"{run.name}: an angle of {run.angle_deg:g} degrees: it counts from 0, straight above, to 180; the "
                "side is the azimuth's."
            )
        if run.windy and not (run.standing or run.shown_rpm > 0):
            raise DataError(
                f"{run.name}: a tachometer reading of {run.shown_rpm:g} rpm at command {run.command}: measure the "
                "speed of a rotor, as drag grows with it."
            )


def _check_angles(runs: Sequence[WindRun]) -> None:
    """Refuse an angle that has no wind at all: wind that was not typed would make references of its runs.

    Angle 0 is what an empty field may have been filled with.
    """
    for angle in sorted({run.angle_deg for run in runs if run.angle_deg and math.isfinite(run.angle_deg)}):
        there = [run for run in runs if run.angle_deg == angle]
        if not any(run.windy for run in there):
            raise DataError(
                f"{len(there)} run(s) at {angle:g} degrees, none with wind ({there[0].name}): give their wind speeds, "
                "or no angle where they are references."
            )


def _check_references(windy: Sequence[WindRun], references: Mapping[int, _Reference]) -> None:
    if not windy:
        raise DataError("no run has both wind and turning rotors: without them there is no drag to identify.")
    lacking = sorted({run.command for run in windy} - set(references))
    if lacking:
        needing = sum(run.command in lacking for run in windy)
        raise DataError(
            f"no run without wind at command {', '.join(map(str, lacking))}: {needing} run(s) in wind need it, as its "
            "thrust is subtracted from theirs. Record it with wind 0,0."
        )
