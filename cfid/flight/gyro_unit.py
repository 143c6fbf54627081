"""Check whether a gyro read in radians is in degrees, or the reverse: by the attitude, the range or the arm."""

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.flight.channels import unit_of_rates
from cfid.flight.equations import TURNS
from cfid.flight.estimation import FlightFit
from cfid.flight.rows import LEVER
from cfid.recordings.crazyflie import si_unit, si_values, times_in
from cfid.recordings.recording import Recording

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

OF_ARM = 0.08, 0.9  # the moment over mass times arm squared: published quadrocopters have 0.2 to 0.4

_FASTEST = 36.0  # rad/s, beyond 2000 deg/s, where the range of gyros ends
_SHARE = 0.02  # of the rows with running motors: public logs have none above `_FASTEST`, and 6 to 80 % if in degrees
_WINDOW_S = 0.05  # over which the rotations of an attitude and of a gyro are compared
_FEWEST = 100  # windows
_ALIKE = 0.7  # the least correlation of the two: wrong axes, noise and a stuck attitude have less
_TIMES = 2.5  # the largest factor between a ratio and that of degrees to radians
_JUMP_RAD = 1.0  # in a window: there, angles wrap around
# By the unit in which a gyro is read: the unit that it may have instead, and how many times as fast it then seems to
# turn.
_OTHER = {"rad/s": "deg/s", "deg/s": "rad/s"}
_TOO_FAST = {"rad/s": math.degrees(1), "deg/s": math.radians(1)}
_ATTITUDES = (
    ("stabilizer.roll", "stabilizer.pitch"),
    ("stateEstimate.roll", "stateEstimate.pitch"),
    ("roll", "pitch"),
)
_QUATERNIONS = (("qw", "qx", "qy", "qz"), tuple(f"stateEstimate.q{part}" for part in "wxyz"))


def refuse_other_unit(log: Recording, time_s: Array, rates: Array, running: Mask) -> None:
    """Raise DataError for rates (n, 3) in rad/s whose unit is wrong, judged by the log's attitude or by their size.

    `running` (n,) are the rows with running motors.
    """
    read = unit_of_rates(log)
    if read not in _TOO_FAST:
        return
    for names, angles_s, roll_pitch in _attitudes(log):
        ratio = _ratio(time_s, rates[:, :2], angles_s, roll_pitch)
        if ratio is not None and _TOO_FAST[read] / _TIMES < ratio < _TOO_FAST[read] * _TIMES:
            raise DataError(
                f"{log.path}: the gyro turns {ratio:.3g} times as fast as the attitude ({', '.join(names)}): "
                f"{remedy(read)}"
            )
    beyond = (np.abs(rates) > _FASTEST).any(axis=1) & running
    if np.count_nonzero(beyond) > _SHARE * np.count_nonzero(running):
        most = math.degrees(float(np.abs(rates[running]).max()))
        smaller = "is it in a smaller unit? Scale its columns to deg/s."
        raise DataError(
            f"{log.path}: the gyro turns by up to {most:.0f} deg/s while the motors run, and gyros end at 2000: "
            f"{remedy(read) if read == 'rad/s' else smaller}"
        )


def remedy(read: str) -> str:
    """Return what to do about a gyro that is read in one unit but is in the other."""
    return f"is it in {_OTHER[read]}, not in {read}? State it in the header of a table, as in gyro.x [{_OTHER[read]}]."


def unlike_arm(found: FlightFit, arm_m: float, read: str) -> str | None:
    """Return a sentence on roll and pitch moments that match an arm only with the gyro in its other unit.

    Returns None where they match it with the unit in which the gyro was `read`, or with neither.
    """
    shares = [LEVER / (gain * arm_m) for gain in map(float, found.values[TURNS][:2]) if gain > 0]
    others = [share * _TOO_FAST.get(read, 0.0) for share in shares]
    if len(shares) < 2 or not all(OF_ARM[0] < share < OF_ARM[1] for share in others):
        return None
    are, would_be = (" and ".join(f"{share:.2g}" for share in each) for each in (shares, others))
    return (
        f"moments about roll and pitch are {are} times mass times the square of an arm of {1e3 * arm_m:g} mm, where "
        f"quadrocopters have 0.2 to 0.4, and would be {would_be} with the gyro in {_OTHER[read]}: {remedy(read)}"
    )


def _attitudes(log: Recording) -> Iterator[tuple[tuple[str, ...], Array, Array]]:
    """Yield the names, times (n,) and angles (n, 2) about roll and pitch of each attitude of a log."""
    for series in log.series.values():
        for names in (*_ATTITUDES, *_QUATERNIONS):
            there = {column.name: si_unit(column)[0] for column in series.columns}
            if not all(there.get(name) == ("rad" if len(names) == 2 else "1") for name in names):
                continue
            values = np.column_stack([si_values(series.column(name)) for name in names])
            time_s, known = times_in(log, series), np.isfinite(values).all(axis=1)
            values, time_s = values[known], time_s[known]
            if len(names) == 4:
                w, x, y, z = values.T
                roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
                values = np.column_stack([roll, np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))])
            yield names, time_s, values


def _ratio(time_s: Array, rates: Array, angles_s: Array, angles: Array) -> float | None:
    """Return the ratio of rates (n, 2) to the rotation of angles (m, 2), None where the two do not correlate."""
    if min(len(time_s), len(angles_s)) < 2:
        return None
    edges = np.arange(max(time_s[0], angles_s[0]), min(time_s[-1], angles_s[-1]), _WINDOW_S)
    if len(edges) <= _FEWEST:
        return None
    summed = np.concatenate([np.zeros((1, 2)), np.cumsum(np.diff(time_s)[:, np.newaxis] * rates[1:], axis=0)])
    ratios = []
    for place in range(2):
        by_gyro = np.diff(np.interp(edges, time_s, summed[:, place]))
        by_angle = np.diff(np.interp(edges, angles_s, angles[:, place]))
        kept = np.abs(by_angle) < _JUMP_RAD
        by_gyro, by_angle = by_gyro[kept] - by_gyro[kept].mean(), by_angle[kept] - by_angle[kept].mean()
        sizes = float(np.linalg.norm(by_gyro)), float(np.linalg.norm(by_angle))
        if min(sizes) > 0 and abs(float(by_gyro @ by_angle)) > _ALIKE * sizes[0] * sizes[1]:
            ratios.append(sizes[0] / sizes[1])
    return min(ratios) if ratios and max(ratios) < _TIMES * min(ratios) else None
