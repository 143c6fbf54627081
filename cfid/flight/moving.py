"""Check that motion capture moves as the sensors of the same log do: its velocities' unit and axes, a stuck attitude.

Over half a second, the velocity changes by the integral of the specific force, turned to the world's axes, plus
gravity. Public logs agree within 1.1 % with correlations of 0.98, simulated flights that hover within 7 %.
"""

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, rejection
from cfid.flight.rows import ROW_S, Flight, segments, turned_back
from cfid.flight.turning import turning_of

Array = npt.NDArray[np.float64]

# Over 0.5 s, the accelerometer's noise averages out, and a change of its bias does not yet accumulate.
_OVER_ROWS = 50
_ALIKE = 0.9  # the least correlation: below it, the unit is not the cause
_LARGEST, _LEAST = 1.2, 1 / 1.2  # limits of the velocity's changes over the accelerometer's
_UNITS = {"mm/s": 1000.0, "cm/s": 100.0, "km/h": 3.6}  # over m/s
_STUCK = 0.1  # of the gyro's rotation: an attitude that turns less is stuck
_TURNS_RAD_PER_S = 0.1  # root mean square from which a turning attitude would show
_MOVES_MPS = 0.3  # root mean square of changes that accelerations show whatever their bias
_SHOWN = 0.5  # of these changes, the least that velocities show: their noise removes none of it
_CLEARER = 2.0  # the least ratio of what all other axes leave unexplained to what the best axes leave


def moving_findings(flight: Flight, *concerned: str) -> list[Finding]:
    """Reject quantities if velocity or attitude contradict accelerometer and gyro; none without these channels."""
    return [one.at(flight.name) for one in _stuck(flight, concerned) or _unlike_force(flight, concerned)]


def _stuck(flight: Flight, concerned: tuple[str, ...]) -> list[Finding]:
    both = turning_of(flight)
    if both is None:
        return []
    of_gyro, of_attitude = (float(np.sqrt(np.mean(np.sum(one**2, axis=1)))) for one in both)
    if of_gyro < _TURNS_RAD_PER_S or of_attitude > _STUCK * of_gyro:
        return []
    text = (
        f"the attitude turns by {of_attitude:.2g} rad/s rms, the gyro by {of_gyro:.2g}: the attitude of motion capture "
        "is stuck, or was not tracked. Velocities along the vehicle's axes need it."
    )
    return [rejection("flight-attitude-stuck", text, *concerned)]


def _unlike_force(flight: Flight, concerned: tuple[str, ...]) -> list[Finding]:
    parts = segments(flight.airborne)
    if flight.velocity is None or flight.attitude is None or not parts:
        return []
    to_world = flight.attitude * [1, -1, -1, -1]
    added = ROW_S * turned_back(to_world, flight.force)
    expected = _changes([np.cumsum(added[part], axis=0) for part in parts])
    if not np.any(expected):
        return []

    def shown(velocity: Array) -> Array:
        return _changes([velocity[part] for part in parts])

    velocity = turned_back(to_world, flight.velocity)
    text = _of_unit(shown(velocity), expected) or _of_axes(velocity, to_world, shown, expected)
    return [] if text is None else [rejection("flight-velocity-unlike-force", text, *concerned)]


def _of_unit(shown: Array, expected: Array) -> str | None:
    """Return a sentence on the unit of velocities whose changes (k, 3) differ from the expected ones in size alone."""
    ratio = float(np.linalg.norm(shown) / np.linalg.norm(expected))
    if _alike(shown, expected) < _ALIKE or _LEAST < ratio < _LARGEST:
        return None
    unit = next((name for name, size in _UNITS.items() if _LEAST < ratio / size < _LARGEST), None)
    remedy = (
        f"are they in {unit}, not in m/s? Divide vx, vy and vz by {_UNITS[unit]:g}."
        if unit
        else "give vx, vy and vz in m/s, and see the accelerometer's unit."
    )
    return (
        f"velocities change {ratio:.3g} times as much as accelerations add up to (limits {_LEAST:.2g} and "
        f"{_LARGEST:g}), and drag is wrong by as much: {remedy}"
    )


def _of_axes(velocity: Array, to_world: Array, shown: Callable[[Array], Array], expected: Array) -> str | None:
    """Return a sentence on the likely axes of velocities (m, 3) whose changes (k, 3), by `shown`, are unexpected."""
    here = shown(velocity)
    alike = _alike(here, expected)
    if alike >= _ALIKE:
        return None
    others = [(_alike(shown(turned), expected), words) for words, turned in _along_others(velocity, to_world)]
    (best, words), (second, _) = sorted(others, reverse=True)[:2]
    clear = best >= _ALIKE and 1 - second**2 > _CLEARER * (1 - best**2)
    moves = float(np.linalg.norm(expected)) / math.sqrt(len(expected)) >= _MOVES_MPS
    if not clear and not (moves and float(np.sum(here * expected)) < _SHOWN * float(np.sum(expected**2))):
        return None
    remedy = words if clear else "see the axes and the times of both; no exchanged or negated ones fit clearly."
    return (
        "velocities change unlike what accelerations, turned to the world by the attitude, add up to over 0.5 s: the "
        f"correlation is {alike:.2g} (at least {_ALIKE:g}), and drag is wrong: {remedy}"
    )


def _along_others(velocity: Array, to_world: Array) -> Iterator[tuple[str, Array]]:
    """Yield a sentence on each exchange or negation of the axes of velocities (m, 3), and the velocities along these.

    Each is yielded twice: along the world's axes, and along the vehicle's.
    """
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            names = [
                f"{'-' if sign < 0 else ''}{('vx', 'vy', 'vz')[place]}"
                for place, sign in zip(order, signs, strict=True)
            ]
            turned = velocity[:, order] * signs
            fit = f"they fit as {', '.join(names)}"
            yield f"{fit}. Give velocity and attitude along the same axes of the world, z up.", turned
            yield (
                f"{fit} along the vehicle's axes. Turn them to the world's by the attitude.",
                turned_back(to_world, turned),
            )


def _alike(shown: Array, expected: Array) -> float:
    """Return the correlation of two sets of changes (k, 3)."""
    size = float(np.linalg.norm(shown) * np.linalg.norm(expected))
    return float(np.sum(shown * expected)) / size if size > 0 else 0.0


def _changes(parts: list[Array]) -> Array:
    """Return the changes (k, 3) of the columns of parts (n, 3) over half a second, without their mean."""
    changes = np.concatenate([one[_OVER_ROWS:] - one[:-_OVER_ROWS] for one in parts])
    return np.asarray(changes - changes.mean(axis=0))
