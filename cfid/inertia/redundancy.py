"""What swings show of each other: which one is wrong, which two were exchanged, and what would pass unnoticed."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, note, rejection, warning
from cfid.inertia.consistency import entries_of
from cfid.inertia.directions import checking_axis, matrix_rows
from cfid.inertia.estimation import MATRIX, InertiaFit, contradictory, deviation, solve
from cfid.inertia.sensitivities import UNKNOWNS, Moved
from cfid.swing.axis_inertias import AxisInertias, MountedSwing
from cfid.swing.plausibility import BEYOND_STD

Array = npt.NDArray[np.float64]

DISTANCES_APART_STD = 3.0

_PARALLEL = math.cos(math.radians(2))
_ALIKE = math.cos(math.radians(10))  # a gyro may not distinguish nearer directions, given what rig.toml states
_OTHER_DISTANCE = 1.05
_NAMED = 4  # suspects in a sentence


def redundancy_findings(axis_inertias: AxisInertias, fit: InertiaFit) -> tuple[Finding, ...]:
    """Name the suspects where swings contradict each other; else state which errors would pass unnoticed."""
    apart = distance_findings(axis_inertias, fit.moved)
    if fit.contradictory:
        return (_suspects_finding(suspects(axis_inertias, fit)), *apart)
    return (*_unchecked(axis_inertias, _swings_of(axis_inertias, fit), fit), *apart)


class Suspects(NamedTuple):
    """What may be wrong where swings contradict each other, and sentences that state why.

    `names` are those of mounts, or of recordings without which the others about the same mount agree.
    """

    names: tuple[str, ...]
    reasons: tuple[str, ...]


def suspects(axis_inertias: AxisInertias, fit: InertiaFit) -> Suspects:
    """Return mounts whose own swings differ, else those without which, or with which exchanged, all agree; maybe none.

    Where a mount's own swings differ, agreement without another mount is no evidence against that other mount.
    """
    if not fit.contradictory:
        return Suspects((), ())
    swings = _swings_of(axis_inertias, fit)
    differ = _unlike_repeats(axis_inertias.swings)
    alone = _superfluous(axis_inertias, swings)
    pairs = list(dict.fromkeys(pair for pair, _ in _exchanges(axis_inertias, swings)))
    reasons = (
        *(text for text, _ in differ.values()),
        *([f"without {_listed(alone, 'or')} the others agree"] if alone else []),
        *([f"with {_listed([' and '.join(pair) for pair in pairs], 'or')} exchanged all agree"] if pairs else []),
    )
    others = (*alone, *(mount for pair in pairs for mount in pair))
    return Suspects(tuple(dict.fromkeys([name for _, name in differ.values()] or others)), reasons)


def distance_findings(axis_inertias: AxisInertias, moved: Moved) -> tuple[Finding, ...]:
    """Compare the inertias about the centre of mass that swings about parallel axes at different distances give."""
    found = axis_inertias.evaluate(axis_inertias.values)
    findings = []
    for i, j in combinations(range(len(axis_inertias.swings)), 2):
        parallel = abs(float(found.direction[i] @ found.direction[j])) > _PARALLEL
        near, far = sorted((found.distance_m[i], found.distance_m[j]))
        std = float(np.linalg.norm(moved.about_centre[i] - moved.about_centre[j]))
        if not parallel or far < _OTHER_DISTANCE * near or std == 0:
            continue
        apart = abs(float(found.about_centre_kg_m2[i] - found.about_centre_kg_m2[j])) / std
        if apart > DISTANCES_APART_STD:
            names = [axis_inertias.swings[k].axis for k in (i, j)]
            text = (
                f"{names[0]} and {names[1]} lie along one axis, {1e3 * near:.1f} and {1e3 * far:.1f} mm from the "
                f"centre of mass, and their inertias differ by {apart:.1f} standard uncertainties (limit "
                f"{DISTANCES_APART_STD:g}). Likely causes: a cable's stiffness, a wrong distance or centre of mass, a "
                "neglected fixture."
            )
            resting = (f"inertia.*_kg_m2.{name}" for name in names)
            findings.append(rejection("inertia-distances-differ", text, MATRIX, *resting))
    return tuple(findings)


def _swings_of(axis_inertias: AxisInertias, fit: InertiaFit) -> "_Swings":
    found = axis_inertias.evaluate(axis_inertias.values)
    return _Swings(matrix_rows(found.direction), found.about_centre_kg_m2, fit.moved)


class _Swings(NamedTuple):
    """Rows (n, 6), inertias about the centre (n,) and the effects of inputs on them; any subset can be solved."""

    rows: Array
    about_centre_kg_m2: Array
    moved: Moved

    def without(self, i: int) -> "_Swings":
        kept = np.arange(len(self.rows)) != i
        moved = Moved(*(part[kept] for part in self.moved))
        return _Swings(self.rows[kept], self.about_centre_kg_m2[kept], moved)

    def agreed(self) -> Array | None:
        """Return the entries (6,) that these swings give; None where they contradict each other, or all bodies."""
        solved = solve(self.rows, self.about_centre_kg_m2, self.moved)
        if contradictory(solved.chi_squared, len(self.rows) - UNKNOWNS):
            return None
        possible = solved.possible()
        return None if deviation(possible - solved.entries, solved.covariance) > BEYOND_STD else possible


def _exchanges(axis_inertias: AxisInertias, swings: _Swings) -> Iterator[tuple[tuple[str, str], Array]]:
    """Yield each pair of swings that, once exchanged, contradict nothing, and the entries that they then give.

    The uncertainties are taken from the swings as they stand. Where a gyro showed the axis of a swing, no exchange with
    another direction passes.
    """
    directions = axis_inertias.evaluate(axis_inertias.values).direction
    for i, j in combinations(range(len(axis_inertias.swings)), 2):
        one, other = axis_inertias.swings[i], axis_inertias.swings[j]
        if one.axis == other.axis or one.known or other.known:
            continue
        if (one.seen or other.seen) and abs(float(directions[i] @ directions[j])) < _ALIKE:
            continue
        exchanged = list(axis_inertias.swings)
        exchanged[i], exchanged[j] = replace(other, axis=one.axis), replace(one, axis=other.axis)
        case = AxisInertias(exchanged, axis_inertias.body, axis_inertias.surroundings)
        inertias = case.evaluate(case.values).about_centre_kg_m2
        entries = swings._replace(about_centre_kg_m2=inertias).agreed()
        if entries is not None:
            yield (one.axis, other.axis), entries


def _superfluous(axis_inertias: AxisInertias, swings: _Swings) -> list[str]:
    """Return the mounts of those swings without which the others agree."""
    count = len(swings.rows)
    return [
        axis_inertias.swings[i].axis
        for i in range(count)
        if count > UNKNOWNS + 1
        and np.linalg.matrix_rank(swings.without(i).rows, tol=1e-6) == UNKNOWNS
        and swings.without(i).agreed() is not None
    ]


def _suspects_finding(found: Suspects) -> Finding:
    if found.reasons:
        text = f"suspects: {'; '.join(found.reasons)}. Repeat these swings, and check their labels and mounts."
    else:
        text = (
            "no single swing and no exchange of two explains the contradiction. Check the mass, the centre of mass and "
            "the mounts; swing about more axes."
        )
    return rejection("inertia-suspects", text, MATRIX)


def _unlike_repeats(swings: Sequence[MountedSwing]) -> dict[str, tuple[str, str]]:
    """Return, for each mount whose swings differ by more than their fits allow, by how much, and which one is suspect.

    The two swings that lie furthest apart count. The suspect is the one recording without which the others agree, else
    the mount.
    """
    differ = {}
    for mount in dict.fromkeys(swing.axis for swing in swings if not swing.known):
        same = [swing for swing in swings if swing.axis == mount and not swing.known]
        if not _differ(same):
            continue
        low, high = _extremes(same)
        text = (
            f"swings about {mount} differ by {100 * (high.value / low.value - 1):.2g} % in frequency squared (std "
            f"{100 * math.hypot(low.std, high.std) / low.value:.2g} %)"
        )
        suspect, wrong = (
            mount,
            [swing.name for swing in (low, high) if not _differ([other for other in same if other is not swing])],
        )
        if len(same) > 2 and len(wrong) == 1:
            suspect = wrong[0]
            text += f", and agree without {suspect}"
        differ[mount] = text, suspect
    return differ


def _extremes(swings: Sequence[MountedSwing]) -> tuple[MountedSwing, MountedSwing]:
    return min(swings, key=lambda swing: swing.value), max(swings, key=lambda swing: swing.value)


def _differ(swings: Sequence[MountedSwing]) -> bool:
    low, high = _extremes(swings)
    return high.value - low.value > BEYOND_STD * math.hypot(low.std, high.std)


def _unchecked(axis_inertias: AxisInertias, swings: _Swings, fit: InertiaFit) -> tuple[Finding, ...]:
    """Return a finding that asks for a seventh mount where there are six, and names the exchanges that would pass."""
    entries = entries_of(fit.matrix_kg_m2)
    unseen = [
        " and ".join(pair)
        for pair, others in _exchanges(axis_inertias, swings)
        if deviation(others - entries, fit.covariance) > BEYOND_STD
    ]
    mounts = list(dict.fromkeys(swing.axis for swing in axis_inertias.swings))
    if len(mounts) > UNKNOWNS and not unseen:
        return ()
    unsure = "distance" if all(swing.seen for swing in axis_inertias.swings) else "distance or direction"
    first = [next(i for i, swing in enumerate(axis_inertias.swings) if swing.axis == mount) for mount in mounts]
    x, y, z = checking_axis(axis_inertias.evaluate(axis_inertias.values).direction[first])
    passing = [
        *([f"exchanged files of {_listed(list(dict.fromkeys(unseen)), 'or')}"] if unseen else []),
        *([f"a wrong {unsure} of a mount"] if len(mounts) <= UNKNOWNS else []),
    ]
    text = (
        f"{len(mounts)} mounts do not check each other: {' and '.join(passing)} would pass. Swing each mount twice, "
        f"and about one more axis, best along ({x:g}, {y:g}, {z:g}); an eighth names the wrong swing. No swing finds a "
        "wrong mass, which scales all inertias: weigh twice."
    )
    if unseen:
        return (warning("inertia-seventh-swing", text, MATRIX),)
    return (note("inertia-seventh-swing", text, MATRIX),)


def _listed(names: Sequence[str], conjunction: str) -> str:
    """Return names as text for a sentence, only a few of many."""
    if len(names) > _NAMED:
        return f"{', '.join(names[:_NAMED])} {conjunction} {len(names) - _NAMED} more"
    return f" {conjunction} ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
