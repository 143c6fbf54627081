"""Forces that contradict the wind or the command they are filed under, as when two recordings were exchanged.

Only gross contradictions are found. Forces of one wind are compared with each other first, as no model of drag is
needed for that: divided by the rotors' speed they are nearly the same. The measure is their median distance.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.drag.experiments import DragExperiments
from cfid.findings import Finding, rejection

Array = npt.NDArray[np.float64]

_GROSS_RUN, _GROSS_REFERENCE = 6.0, 4.0  # times the median distance
_GROSS_PART = 0.5  # of the force that one coefficient for everything means
_GROSS_SETTING = 0.75  # of that force, for a whole wind setting
_FEWEST = 4  # experiments in a setting, from where their median stands against one that is wrong


@dataclass(frozen=True, kw_only=True)
class Filed:
    """Experiments with the names (n,) of their runs, and the references by command: name, force (3,), body frame."""

    experiments: DragExperiments
    names: Sequence[str]
    references: Mapping[int, tuple[str, Array]]


def swap_findings(filed: Filed) -> tuple[Finding, ...]:
    """Reject each file that seems to belong elsewhere; none of a valid campaign."""
    experiments = filed.experiments
    speed = experiments.speed_sum_rad_s[:, np.newaxis]
    common = _common(experiments)
    typical = _typical(experiments, common)
    off = experiments.force_n - speed * typical
    size = np.linalg.norm(speed * common, axis=1)
    shifted, references = _shifted_references(filed, off, size)
    return (
        *_unordered(filed.references),
        *references,
        *_lost_settings(experiments, typical, common),
        *_lost_runs(filed, off - shifted, size),
    )


def _common(experiments: DragExperiments) -> Array:
    """Return force over speed sum (n, 3) by the median coefficient, for all directions."""
    velocity = experiments.velocity_mps
    along = np.sum(experiments.force_n * velocity, axis=1) / np.sum(velocity**2, axis=1)
    return np.asarray(np.median(along / experiments.speed_sum_rad_s) * velocity)


def _typical(experiments: DragExperiments, common: Array) -> Array:
    """Return force over speed sum (n, 3) by the median of the same wind setting, else `common`."""
    ratio = experiments.force_n / experiments.speed_sum_rad_s[:, np.newaxis]
    typical = common.copy()
    for setting in range(experiments.settings):
        rows = experiments.setting == setting
        if rows.sum() >= _FEWEST:
            typical[rows] = np.median(ratio[rows], axis=0)
    return typical


def _unordered(references: Mapping[int, tuple[str, Array]]) -> list[Finding]:
    found = []
    for low, high in itertools.pairwise(sorted(references)):
        (low_name, low_force), (high_name, high_force) = references[low], references[high]
        if high_force[2] <= low_force[2]:
            text = (
                f"without wind, command {low} lifts {low_force[2]:.4f} N ({low_name}) and command {high} no more than "
                f"{high_force[2]:.4f} N ({high_name}): were their files exchanged?"
            )
            found.append(rejection("drag-references-out-of-order", text, "drag.*"))
    return found


def _shifted_references(filed: Filed, off: Array, size: Array) -> tuple[Array, list[Finding]]:
    """Return what grossly wrong references add to all forces at their command (n, 3), and findings."""
    shifts, found = np.zeros_like(off), []
    yardstick = _GROSS_REFERENCE * float(np.median(np.linalg.norm(off, axis=1)))
    for command in np.unique(filed.experiments.command):
        rows = filed.experiments.command == command
        shift = np.median(off[rows], axis=0)
        distance = float(np.linalg.norm(shift))
        if rows.sum() >= _FEWEST and distance > max(yardstick, _GROSS_PART * float(np.median(size[rows]))):
            shifts[rows] = shift
            text = (
                f"all forces at command {command:.0f} are off by {_newtons(shift)}: is the reference "
                f"{filed.references[int(command)][0]} of another command, or was there wind?"
            )
            found.append(rejection("drag-reference-off", text, "drag.*"))
    return shifts, found


def _lost_settings(experiments: DragExperiments, typical: Array, common: Array) -> list[Finding]:
    found = []
    for setting in range(experiments.settings):
        row = int(np.flatnonzero(experiments.setting == setting)[0])
        if np.linalg.norm(typical[row] - common[row]) > _GROSS_SETTING * np.linalg.norm(common[row]):
            speed = float(np.median(experiments.speed_sum_rad_s[experiments.setting == setting]))
            text = (
                f"forces in wind of {experiments.wind_mps[row]:.2f} m/s at {experiments.angle_deg[row]:g} degrees are "
                f"typically {_newtons(speed * typical[row])}, where all winds together give "
                f"{_newtons(speed * common[row])}: are angle and wind speed those of its files?"
            )
            found.append(rejection("drag-wind-off", text, "drag.*"))
    return found


def _lost_runs(filed: Filed, off: Array, size: Array) -> list[Finding]:
    distance = np.linalg.norm(off, axis=1)
    gross = (distance > _GROSS_RUN * np.median(distance)) & (distance > _GROSS_PART * size)
    return [
        rejection(
            "drag-run-off",
            f"{filed.names[row]}: its force is off by {_newtons(off[row])} from that of other commands in its wind "
            "setting: is it the file of another run?",
            "drag.*",
        )
        for row in np.flatnonzero(gross).tolist()
    ]


def _newtons(force: Array) -> str:
    return f"({', '.join(f'{value:z.4f}' for value in force)}) N"
