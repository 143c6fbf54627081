"""Find forces that contradict the wind or the command of their file, for example after two recordings were swapped.

Only gross contradictions are found. A force whose offset resembles those before and after it is part of a drift, of the
load cell's tare or with the battery's voltage, and not a swap.

Forces of one wind are compared with each other first, because that needs no model of drag: divided by the rotors'
speed, they are nearly the same. The yardstick is their median distance.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cfid.drag.experiments import DragExperiments
from cfid.findings import Finding, rejection, warning

Array = npt.NDArray[np.float64]

_GROSS_RUN, _GROSS_REFERENCE = 6.0, 4.0  # times the median distance
_GROSS_PART = 0.5  # of the force according to a single coefficient for all directions
_GROSS_SETTING = 0.75  # of that force, for a whole wind setting
# Of a force's offset: neighbours in time with similar offsets predict it to within less than this.
_SMOOTH = 0.5
# The least time between forces that were measured one after the other: closer times are from different clocks.
_APART_S = 1.0
_FEWEST = 4  # experiments in a setting from which their median is robust against a wrong one


@dataclass(frozen=True, kw_only=True)
class Filed:
    """Experiments with the names (n,) of their runs, and the references by command: name, force (3,), body frame.

    `time_s` (n,) and `reference_s` by command are the times of recording, NaN where unknown.
    """

    experiments: DragExperiments
    names: Sequence[str]
    references: Mapping[int, tuple[str, Array]]
    time_s: Array
    reference_s: Mapping[int, float]


def swap_findings(filed: Filed) -> tuple[Finding, ...]:
    """Reject each file that seems to belong elsewhere; a valid campaign has none."""
    experiments = filed.experiments
    speed = experiments.speed_sum_rad_s[:, np.newaxis]
    common = _common(experiments)
    typical = _typical(experiments, common)
    off = experiments.force_n - speed * typical
    size = np.linalg.norm(speed * common, axis=1)
    shifted, references = _shifted_references(filed, off, size)
    wrong = [*references, *_lost_settings(filed, typical, common), *_lost_runs(filed, off - shifted, size)]
    drifted = [one.text for one in wrong if one.severity == "warning"]
    more = [f"{len(drifted) - 1} more drift too."] if len(drifted) > 1 else []
    return (
        *_unordered(filed.references),
        *(one for one in wrong if one.severity == "rejection"),
        *((warning("drag-forces-drift", " ".join([drifted[0], *more]), "drag.*"),) if drifted else ()),
    )


def _drift(text: str) -> Finding:
    drift = "those recorded before and after by nearly as much: does the tare drift, or the battery sag?"
    return warning("drag-forces-drift", f"{text}, {drift}", "drag.*")


def _drifts(off: Array, time_s: Array, place: int) -> bool:
    """Return whether one of the offsets (m, 3), measured at times (m,), continues those before and after it."""
    if len(off) <= 2 or not np.diff(np.sort(time_s)).min() > _APART_S:  # also false for NaN
        return False
    order = np.argsort(time_s, kind="stable")
    own, rank = off[order], int(np.flatnonzero(order == place)[0])
    inside = 0 < rank < len(own) - 1
    one, other = (rank - 1, rank + 1) if inside else (1, 2) if rank == 0 else (rank - 1, rank - 2)
    expected = (own[one] + own[other]) / 2 if inside else 2 * own[one] - own[other]
    left = np.linalg.norm(off[place] - expected)
    return bool(left < _SMOOTH * np.linalg.norm(off[place]))


def _common(experiments: DragExperiments) -> Array:
    """Return force over speed sum (n, 3) according to the median coefficient for all directions."""
    velocity = experiments.velocity_mps
    along = np.sum(experiments.force_n * velocity, axis=1) / np.sum(velocity**2, axis=1)
    return np.asarray(np.median(along / experiments.speed_sum_rad_s) * velocity)


def _typical(experiments: DragExperiments, common: Array) -> Array:
    """Return force over speed sum (n, 3) as the median in the same wind setting, else `common`."""
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
    """Return the offsets (n, 3) by grossly wrong references in all forces at their command, and findings."""
    shifts, found = np.zeros_like(off), []
    yardstick = _GROSS_REFERENCE * float(np.median(np.linalg.norm(off, axis=1)))
    commands = np.unique(filed.experiments.command)
    each = np.array([np.median(off[filed.experiments.command == command], axis=0) for command in commands])
    time_s = np.array([filed.reference_s.get(int(command), math.nan) for command in commands])
    for place, (command, shift) in enumerate(zip(commands, each, strict=True)):
        rows = filed.experiments.command == command
        distance = float(np.linalg.norm(shift))
        if rows.sum() >= _FEWEST and distance > max(yardstick, _GROSS_PART * float(np.median(size[rows]))):
            shifts[rows] = shift
            name = filed.references[int(command)][0]
            text = f"all forces at command {command:.0f} are off by {_newtons(shift)}"
            question = f"{text}: is the reference {name} of another command, or was there wind?"
            drifts = _drifts(each, time_s, place)
            found.append(_drift(text) if drifts else rejection("drag-reference-off", question, "drag.*"))
    return shifts, found


def _lost_settings(filed: Filed, typical: Array, common: Array) -> list[Finding]:
    experiments, found = filed.experiments, []
    rows = [np.flatnonzero(experiments.setting == setting) for setting in range(experiments.settings)]
    speed = np.array([np.median(experiments.speed_sum_rad_s[own]) for own in rows])
    first = np.array([own[0] for own in rows])
    off = speed[:, np.newaxis] * (typical - common)[first]
    time_s = np.array([np.mean(filed.time_s[own]) for own in rows])
    for setting, row in enumerate(first.tolist()):
        if np.linalg.norm(typical[row] - common[row]) > _GROSS_SETTING * np.linalg.norm(common[row]):
            text = (
                f"forces in wind of {experiments.wind_mps[row]:.2f} m/s at {experiments.angle_deg[row]:g} degrees are "
                f"typically {_newtons(speed[setting] * typical[row])}, where all winds together give "
                f"{_newtons(speed[setting] * common[row])}"
            )
            question = f"{text}: are angle and wind speed those of its files?"
            drifts = _drifts(off, time_s, setting)
            found.append(_drift(text) if drifts else rejection("drag-wind-off", question, "drag.*"))
    return found


def _lost_runs(filed: Filed, off: Array, size: Array) -> list[Finding]:
    distance = np.linalg.norm(off, axis=1)
    gross = (distance > _GROSS_RUN * np.median(distance)) & (distance > _GROSS_PART * size)
    found = []
    for row in np.flatnonzero(gross).tolist():
        text = (
            f"{filed.names[row]}: its force is off by {_newtons(off[row])} from that of other commands in its wind "
            "setting"
        )
        question = f"{text}: is it the file of another run?"
        drifts = _drifts(off, filed.time_s, row)
        found.append(_drift(text) if drifts else rejection("drag-run-off", question, "drag.*"))
    return found


def _newtons(force: Array) -> str:
    return f"({', '.join(f'{value:z.4f}' for value in force)}) N"
