"""Convert mean forces in wind to drag experiments: thrust without wind subtracted, wind as a vector."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.drag.experiments import UNSTATED_WIND_STD, DragExperiments, standing_left_out
from cfid.drag.wind.frames import AZIMUTH_DEG, velocity_in_air, wind_speed
from cfid.drag.wind.plan import FASTEST_MPS, HIGHEST_DEG, WindSetting
from cfid.drag.wind.swaps import Filed, swap_findings
from cfid.errors import DataError
from cfid.findings import Finding, note, warning
from cfid.motors.maps.checks import marker_findings
from cfid.units import DEAD_COMMAND, ROTORS

Array = npt.NDArray[np.float64]

_SAG = 0.005  # of the voltage: it changes thrust by a hundredth, which is as much as weak drag


@dataclass(frozen=True, kw_only=True)
class WindForce:
    """The mean force (3,) at one command in one wind setting, body frame, with its standard uncertainty (3,).

    `rotor_rad_s` is the speed of one rotor, representing all four; a reference does not need it. `volts` is the
    battery's voltage, NaN where it was not logged. `at_s` is the time of the measurement in Unix seconds, NaN where it
    is unknown.
    """

    name: str
    command: int
    setting: WindSetting
    force_n: Array
    force_std_n: Array
    rotor_rad_s: float = 0.0
    volts: float = math.nan
    at_s: float = math.nan

    @property
    def windy(self) -> bool:
        """Whether there was wind."""
        return not self.setting.is_reference

    @property
    def standing(self) -> bool:
        """Whether the rotors stood still."""
        return self.command <= DEAD_COMMAND


class _Reference(NamedTuple):
    name: str
    force_n: Array
    std_n: Array
    at_s: float


def reduce_forces(forces: Sequence[WindForce]) -> DragExperiments:
    """Subtract the mean of the references at the same command (section 4.4.3).

    References apply to all angles: the thesis has one series without wind for all three. Standing rotors have no rotor
    drag, so their forces are left out, as in the thesis.

    Raises DataError, with names, when a reference, an angle or a reading is missing.
    """
    for one in forces:
        _check(one)
    standing = [one for one in forces if one.windy and one.standing]
    windy = [one for one in forces if one.windy and not one.standing]
    references = _references([one for one in forces if not one.windy])
    _check_angles(forces)
    windy, unreferenced = _with_reference(windy, references)
    experiments, spread = _experiments(windy, references)
    left_out = [standing_left_out(f"{counted(len(standing), 'run')} in wind with standing rotors")] if standing else []
    left_out += unreferenced
    thrusts = {command: (reference.name, reference.force_n) for command, reference in references.items()}
    swaps = swap_findings(
        Filed(
            experiments=experiments,
            names=[one.name for one in windy],
            references=thrusts,
            time_s=np.array([one.at_s for one in windy]),
            reference_s={command: reference.at_s for command, reference in references.items()},
        )
    )
    lift_n = np.array([references[one.command].force_n[2] / ROTORS for one in windy])
    markers = marker_findings(
        experiments.command, experiments.speed_sum_rad_s / ROTORS, lift_n, quantities=("drag.*",), single=False
    )
    return replace(experiments, findings=(*sagged(forces), *spread, *left_out, *swaps, *markers))


def sagged(forces: Sequence[WindForce]) -> list[Finding]:
    """Warn where the battery's voltage differs from that of the reference: the thrust without wind then differs too."""
    references = {one.command: one.volts for one in forces if not one.windy}
    off = {
        one.name: one.volts / references[one.command] - 1
        for one in forces
        if one.windy and one.command in references and abs(one.volts / references[one.command] - 1) > _SAG
    }
    if not off:
        return []
    name, most = max(off.items(), key=lambda item: abs(item[1]))
    text = (
        f"{counted(len(off), 'run')} had another battery voltage than their reference, {name} by "
        f"{100 * most:+.1f} %: thrust "
        "follows it, and counts as drag along z. Feed the vehicle from a supply of constant voltage."
    )
    return [warning("drag-battery-differs", text, "drag.*")]


def _experiments(
    windy: Sequence[WindForce], references: Mapping[int, _Reference]
) -> tuple[DragExperiments, tuple[Finding, ...]]:
    settings = [one.setting for one in windy]
    speed = wind_speed(min_mps=[at.min_mps for at in settings], max_mps=[at.max_mps for at in settings])
    azimuth = np.array([AZIMUTH_DEG if at.azimuth_deg is None else at.azimuth_deg for at in settings])
    angle = np.array([at.angle_deg for at in settings], dtype=np.float64)
    same = np.stack([angle, azimuth, speed.mean_mps, speed.std_mps], axis=1)
    spread, findings = _relative_spread(speed.std_mps / speed.mean_mps)
    thrusts = [references[one.command] for one in windy]
    own = np.array([one.force_std_n for one in windy])
    known = bool(np.all(own > 0))
    experiments = DragExperiments(
        command=np.array([one.command for one in windy], dtype=np.float64),
        angle_deg=angle,
        velocity_mps=velocity_in_air(
            speed_mps=speed.mean_mps, angle_rad=np.radians(angle), azimuth_rad=np.radians(azimuth)
        ),
        speed_sum_rad_s=ROTORS * np.array([one.rotor_rad_s for one in windy]),
        force_n=np.array([one.force_n for one in windy]) - np.array([thrust.force_n for thrust in thrusts]),
        force_std_n=own if known else np.ones_like(own),
        reference_std_n=np.array([thrust.std_n for thrust in thrusts]) if known else np.ones_like(own),
        noise_known=known,
        setting=np.unique(same, axis=0, return_inverse=True)[1].reshape(-1),
        wind_relative_std=spread,
    )
    return experiments, findings


def _references(forces: Sequence[WindForce]) -> dict[int, _Reference]:
    found = {}
    for command in {one.command for one in forces}:
        there = [one for one in forces if one.command == command]
        std = np.array([one.force_std_n for one in there])
        found[command] = _Reference(
            name=", ".join(one.name for one in there),
            force_n=np.mean([one.force_n for one in there], axis=0),
            std_n=np.linalg.norm(std, axis=0) / len(there),
            at_s=float(np.mean([one.at_s for one in there])),
        )
    return found


def _relative_spread(spread: Array) -> tuple[Array, tuple[Finding, ...]]:
    """Return the wind's relative standard uncertainties (n,); that of a single reading is the others' median."""
    single = spread == 0
    if not single.any():
        return spread, ()
    usual = UNSTATED_WIND_STD if single.all() else float(np.median(spread[~single]))
    source = "by default" if single.all() else "as in the median of the others"
    text = (
        f"{counted(int(single.sum()), 'run states', 'runs state')} a single wind speed: a relative standard "
        f"uncertainty of {100 * usual:.2g} % "
        f"is taken, {source}."
    )
    return np.where(single, usual, spread), (note("drag-wind-single-reading", text, "drag.*"),)


def _check(one: WindForce) -> None:
    at = one.setting
    if math.isnan(at.min_mps) or math.isnan(at.max_mps):
        raise DataError(f"{one.name}: no wind speed: give its lowest and highest reading, 0 and 0 for a reference.")
    if at.max_mps > FASTEST_MPS:
        raise DataError(f"{one.name}: wind of {at.max_mps:g} m/s: give it in m/s, up to {FASTEST_MPS:g}.")
    if not 0 <= at.min_mps <= at.max_mps:
        raise DataError(
            f"{one.name}: wind between {at.min_mps:g} and {at.max_mps:g} m/s: give the lowest reading, then the "
            "highest, none below zero."
        )
    if not (np.all(np.isfinite(one.force_n)) and np.all(np.isfinite(one.force_std_n))):
        raise DataError(f"{one.name}: its mean force is not a number: check the recording and its window.")
    if not one.windy:
        return
    if at.angle_deg is None or not math.isfinite(at.angle_deg):
        raise DataError(f"{one.name}: wind of {at.max_mps:g} m/s without an angle: give the wind generator's.")
    if not 0 <= at.angle_deg <= HIGHEST_DEG:
        raise DataError(
            f"{one.name}: an angle of {at.angle_deg:g} degrees: it counts from 0, straight above, to {HIGHEST_DEG:g}; "
            "the side is the azimuth's."
        )
    if not (one.standing or one.rotor_rad_s > 0):
        raise DataError(
            f"{one.name}: a rotor speed of {one.rotor_rad_s:g} rad/s at command {one.command}: measure it, as drag "
            "grows with it."
        )


def _check_angles(forces: Sequence[WindForce]) -> None:
    """Refuse an angle at which no run has wind: a missing wind speed would turn its runs into references.

    An empty field may have been filled with angle 0.
    """
    for angle in sorted({angle for one in forces if (angle := one.setting.angle_deg) and math.isfinite(angle)}):
        there = [one for one in forces if one.setting.angle_deg == angle]
        if not any(one.windy for one in there):
            raise DataError(
                f"{counted(len(there), 'run')} at {angle:g} degrees, none with wind ({there[0].name}): give "
                "their wind speeds, "
                "or no angle where they are references."
            )


def _with_reference(
    windy: Sequence[WindForce], references: Mapping[int, _Reference]
) -> tuple[list[WindForce], list[Finding]]:
    """Return the forces that have a reference at their command, and a warning about the others.

    Raises DataError where none is left.
    """
    if not windy:
        raise DataError("no run has both wind and turning rotors: without them there is no drag to identify.")
    lacking = sorted({one.command for one in windy} - set(references))
    if not lacking:
        return list(windy), []
    kept = [one for one in windy if one.command in references]
    text = (
        f"no run without wind at command {', '.join(map(str, lacking))}: "
        f"{counted(len(windy) - len(kept), 'run in wind needs', 'runs in wind need')} "
        "it, as its thrust is subtracted from theirs. Record it with wind 0,0."
    )
    if not kept:
        raise DataError(text)
    return kept, [warning("drag-reference-missing", f"{text} They are left out.", "drag.*")]
