"""Read motion capture in a flight's log, and find where it contradicts the vehicle's own sensors."""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from cfid.errors import DataError
from cfid.findings import Finding, rejection
from cfid.flight.rows import AXES, ROW_S, Flight, segments, turned_back
from cfid.recordings.crazyflie import si_values, times_in
from cfid.recordings.recording import Recording

Array = npt.NDArray[np.float64]

# In the world's axes: of motion capture, else as the Crazyflie estimates them.
_VELOCITIES = (
    (("vx", "vy", "vz"), ("qw", "qx", "qy", "qz")),
    (
        ("stateEstimate.vx", "stateEstimate.vy", "stateEstimate.vz"),
        ("stateEstimate.qw", "stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz"),
    ),
)

# Of means over 0.1 s, since an attitude's rows are noisy and may come at 30 Hz: the correlation from which two rates
# are alike (public logs have 0.7 to 0.9), its excess over that with the axis of the same name, and the ratio of rates.
_SMOOTHED_ROWS, _FEWEST_ROWS = 10, 500
_ALIKE, _MORE_ALIKE, _FASTER = 0.5, 0.2, 2.0
# Over half a second, the velocity changes by the integral of the specific force, turned to the world's axes, plus
# gravity. Public logs agree within 1.1 %, simulated flights that hover within 7 %. Smaller motion than this root mean
# square may be noise of the accelerometer.
_OVER_ROWS, _LARGEST, _MOVES_MPS = 50, 1.2, 0.3
_STUCK = 0.1  # of the gyro's rotation: an attitude that turns less is stuck


def motion_of(log: Recording, at_s: Array) -> tuple[Array | None, Array | None]:
    """Return velocity (m, 3) along the vehicle's axes and attitude (m, 4) as captured or estimated, None without these.

    The attitude is the quaternion that turns the vehicle's axes to the world's.
    """
    for (along, quaternion), series in itertools.product(_VELOCITIES, log.series.values()):
        if {*along, *quaternion} <= set(series.names):
            velocity = np.column_stack([si_values(series.column(name)) for name in along])
            attitude = np.column_stack([series.column(name).values for name in quaternion])
            # An empty or a zero quaternion is a row without an attitude.
            known = np.isfinite(velocity).all(axis=1) & (np.linalg.norm(attitude, axis=1) > 0)
            if not known.any():
                continue
            time_s, velocity, attitude = times_in(log, series)[known], velocity[known], attitude[known]
            velocity = np.column_stack([np.interp(at_s, time_s, column) for column in velocity.T])
            flips = np.cumprod(np.where(np.sum(attitude[1:] * attitude[:-1], axis=1) < 0, -1.0, 1.0))
            attitude[1:] *= flips[:, np.newaxis]
            attitude = np.column_stack([np.interp(at_s, time_s, column) for column in attitude.T])
            attitude /= np.linalg.norm(attitude, axis=1)[:, np.newaxis]
            return turned_back(attitude, velocity), attitude
    return None, None


def refuse_unlike_gyro(path: Path, flight: Flight) -> None:
    """Raise DataError where the gyro turns about other axes than the attitude, the opposite way, or not as fast."""
    gyro, shown = _rates_of_both(flight)
    sizes = [np.maximum(np.linalg.norm(rates, axis=0), 1e-12) for rates in (gyro, shown)]
    alike = gyro.T @ shown / np.outer(*sizes)
    faults = []
    for place, axis in enumerate(AXES):
        other = int(np.argmax(np.abs(alike[place])))
        if abs(alike[place, other]) > _ALIKE and abs(alike[place, other]) > alike[place, place] + _MORE_ALIKE:
            way = "as" if alike[place, other] > 0 else "against"
            faults.append(f"about {axis} {way} the attitude about {AXES[other]}")
        ratio = float(sizes[0][place] / sizes[1][place])
        if alike[place, place] > _ALIKE and not 1 / _FASTER < ratio < _FASTER:
            faults.append(f"about {axis} {ratio:.3g} times as fast as the attitude")
    if faults:
        raise DataError(
            f"{path}: the gyro turns {', '.join(faults)}: turn the axes of both to x forward, y left, z up, give the "
            "attitude from the vehicle to the world, and state the gyro's unit.",
            code="gyro-unlike-attitude",
        )


def velocity_findings(flight: Flight) -> list[Finding]:
    """Reject drag if velocities of motion capture do not change as accelerations, turned to the world, add up to.

    They are of another unit, or along other axes than the attitude's world, or the attitude is stuck.
    """
    parts = segments(flight.airborne)
    if flight.velocity is None or flight.attitude is None or not parts:
        return []
    to_world = flight.attitude * [1, -1, -1, -1]
    added = ROW_S * turned_back(to_world, flight.force)
    expected = _changes([np.cumsum(added[part], axis=0) for part in parts])
    velocity = turned_back(to_world, flight.velocity)
    shown = _changes([velocity[part] for part in parts])
    moved_mps = float(np.linalg.norm(expected)) / math.sqrt(len(expected))
    share = float(np.sum(shown * expected)) / max(float(np.sum(expected**2)), 1e-300)
    gyro, turned = (float(np.linalg.norm(rates)) for rates in _rates_of_both(flight))
    if share < _LARGEST and (share > 1 / _LARGEST or moved_mps < _MOVES_MPS) and turned >= _STUCK * gyro:
        return []
    text = (
        f"velocities show {share:.3g} of what accelerations, turned to the world by the attitude, add up to over 0.5 s "
        f"(limits {1 / _LARGEST:.2g} and {_LARGEST:g}), and the attitude turns {turned / max(gyro, 1e-300):.2g} times "
        f"as much as the gyro (at least {_STUCK:g}), and what rests on both is wrong: give accelerations along the "
        "vehicle's axes, vx, vy and vz in m/s along the world's axes of the attitude, z up, and check that it is "
        "tracked."
    )
    lost = "flight.drag*", "motor.thrust*", "flight.moment_per_velocity*"
    return [rejection("flight-velocity-unlike-force", text, *lost)]


def _rates_of_both(flight: Flight) -> tuple[Array, Array]:
    """Return smoothed rates (k, 3) of gyro and attitude in the air without their means, no rows for less than 5 s."""
    known = flight.airborne[1:] & flight.airborne[:-1]
    if flight.attitude is None or np.count_nonzero(known) < _FEWEST_ROWS:
        return np.zeros((0, 3)), np.zeros((0, 3))
    attitude = flight.attitude
    turned = attitude[1:] - attitude[:-1]
    w, vector = attitude[:-1, :1], attitude[:-1, 1:]
    # Twice the vector part of the quaternion's conjugate times its change is the rotation vector.
    of_attitude = 2 / ROW_S * (w * turned[:, 1:] - turned[:, :1] * vector - np.cross(vector, turned[:, 1:]))
    smooth = (
        uniform_filter1d(rates, _SMOOTHED_ROWS, axis=0)[known]
        for rates in ((flight.rates[1:] + flight.rates[:-1]) / 2, of_attitude)
    )
    gyro, shown = (rates - rates.mean(axis=0) for rates in smooth)
    return gyro, shown


def _changes(parts: Sequence[Array]) -> Array:
    """Return the changes (k, 3) of the columns of parts (n, 3) over half a second, without their mean."""
    changes = np.concatenate([part[_OVER_ROWS:] - part[:-_OVER_ROWS] for part in parts])
    return np.asarray(changes - changes.mean(axis=0))
