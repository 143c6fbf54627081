"""Whether motion capture moves as the sensors of the same log do: its velocities' unit, and an attitude that is stuck.

Over half a second the velocity changes by what the specific force, turned to the world's axes, adds up to beside
gravity. Public logs agree within 1.1 % with correlations of 0.98, simulated flights that hover within 7 %.
"""

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, rejection
from cfid.flight.model import ROW_S, Flight, segments, turned_back
from cfid.flight.turning import turning_of

Array = npt.NDArray[np.float64]

_OVER_ROWS = 50  # 0.5 s: the accelerometer's noise has averaged, a change of its bias has not added up
_ALIKE = 0.9  # of a correlation, below which other things than the unit decide
_LARGEST, _LEAST = 1.2, 1 / 1.2  # of the velocity over what the accelerometer shows
_UNITS = {"mm/s": 1000.0, "cm/s": 100.0, "km/h": 3.6}  # over m/s
_STUCK = 0.1  # of the gyro's turning
_TURNS_RAD_PER_S = 0.1  # root mean square, from which a turning attitude would show


def moving_findings(flight: Flight, *concerned: str) -> list[Finding]:
    """Reject quantities where velocity or attitude move otherwise than accelerometer and gyro; none without them."""
    return [one.at(flight.name) for one in _stuck(flight, concerned) or _other_unit(flight, concerned)]


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


def _other_unit(flight: Flight, concerned: tuple[str, ...]) -> list[Finding]:
    parts = segments(flight.airborne)
    if flight.velocity is None or flight.attitude is None or not parts:
        return []
    to_world = flight.attitude * [1, -1, -1, -1]
    added, velocity = ROW_S * turned_back(to_world, flight.force), turned_back(to_world, flight.velocity)
    shown = _changes([velocity[part] for part in parts])
    expected = _changes([np.cumsum(added[part], axis=0) for part in parts])
    sizes = [float(np.linalg.norm(one)) for one in (shown, expected)]
    if not min(sizes) > 0 or float(np.sum(shown * expected)) < _ALIKE * sizes[0] * sizes[1]:
        return []
    ratio = sizes[0] / sizes[1]
    if _LEAST < ratio < _LARGEST:
        return []
    unit = next((name for name, size in _UNITS.items() if _LEAST < ratio / size < _LARGEST), None)
    remedy = (
        f"are they in {unit}, not in m/s? Divide vx, vy and vz by {_UNITS[unit]:g}."
        if unit
        else "give vx, vy and vz in m/s, and see the accelerometer's unit."
    )
    text = (
        f"velocities change {ratio:.3g} times as much as accelerations add up to (limits {_LEAST:.2g} and "
        f"{_LARGEST:g}), and drag is wrong by as much: {remedy}"
    )
    return [rejection("flight-velocity-unlike-force", text, *concerned)]


def _changes(parts: list[Array]) -> Array:
    """Return by how much the columns of parts (n, 3) change over half a second, but for the mean change: (k, 3)."""
    changes = np.concatenate([one[_OVER_ROWS:] - one[:-_OVER_ROWS] for one in parts])
    return np.asarray(changes - changes.mean(axis=0))
