"""Read a gyro as an angle: the axis about which it turned, its rate about that axis, and the integral of the rate.

The angle drifts with the remaining bias, and has the gyro's scale: it shows what happened, and where. Fits use the
rate.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.recordings.recording import Array, Column, Series
from cfid.recordings.stamps import stamped_times
from cfid.units import CRYSTAL_STD, split_unit

Marks = npt.NDArray[np.bool_]

GYRO = ("gyro.x", "gyro.y", "gyro.z")  # in deg/s, as the firmware logs it, where no unit is stated
RANGE_DPS = 2000.0  # of every gyro that a Crazyflie has had

# As for gyros of this kind (BMI088): sensitivity within 1 %, and 1 % of a rate about one axis on another.
SCALE_STD = 0.01
ALIGNMENT_STD_RAD = 0.01

_STAMP, _WRAP_MS = "vehicle_ms", 1 << 24
_LARGEST_SKEW = 3e-3  # with a margin for late arrivals; a timer that runs at 84/85 is off by 12e-3
_TILTING = 2.0  # times the jitter of arrivals, by which a line through them tilts in all; a step tilts it by 1.5
_REST_S = 0.25
_FLAT = 0.1  # of the fastest rate: below, noise may reverse it
_NARROW = 0.1  # of the widest half-swing
_FEWEST_MIDDLES = 4
_AT_THE_END = 0.999  # of the range
_ROUND = 1e-3  # of a range, within which a rate is at its end
_FEWEST_HALVES, _FEWEST_FLAT, _FLAT_SHARE = 2, 2, 0.06  # half-swings there, samples in one, their share


class Rates(NamedTuple):
    """The rate (n,) in rad/s about the unit vector `axis` (3,) of the body frame, and the share off that axis."""

    rate_rad_per_s: Array
    axis: Array
    off_axis: float


class Rotation(NamedTuple):
    """A gyro's recording: times (n,) since the first sample, the integral (n,) of its rates, and these."""

    time_s: Array
    angle_rad: Array
    rates: Rates
    time_scale_std: float


def gyro_series(series: Iterable[Series]) -> Series | None:
    """Return the first series that holds a gyro, with its rows of numbers; its columns without a unit are in deg/s."""
    named = (replace(one, columns=tuple(map(_of_gyro, one.columns))) for one in series)
    found = next((one for one in named if set(GYRO) <= set(one.names)), None)
    return None if found is None else found.complete(GYRO)


def _of_gyro(column: Column) -> Column:
    """Return a gyro's column with its unit, also one whose name in a run has it, as in `gyro.x_[rad/s]`."""
    name, unit = split_unit(column.name)
    name = name.rstrip("_")
    return replace(column, name=name, unit=column.unit or unit or "deg/s") if name in GYRO else column


def rotation_of(series: Series) -> Rotation:
    """Return the rotation that a gyro recorded. Raises DataError where it shows none, or where it left its range."""
    rates = np.column_stack([series.si(name, "rad/s") for name in GYRO])
    time_s, scale_std = _times(series)
    if len(time_s) < 2 or not np.all(np.diff(time_s) > 0):
        raise DataError(f"{series.path}: the times of its rows do not increase.", code="time-goes-back")
    fastest = np.degrees(rates[:, np.argmax(np.abs(rates).max(axis=0))])
    reached = float(np.abs(fastest).max())
    if reached > _AT_THE_END * RANGE_DPS or at_end_of_range(fastest, np.abs(fastest)).any():
        raise DataError(
            f"{series.path}: the gyro reached {reached:.0f} deg/s, the end of its range, and shows no more than that. "
            "Set a larger range, release lower, or drop a lighter weight.",
            code="gyro-at-end",
        )
    about_axis = about_one_axis(rates)
    angle, bias = integrated(time_s, about_axis.rate_rad_per_s)
    without_bias = about_axis._replace(rate_rad_per_s=about_axis.rate_rad_per_s - bias)
    return Rotation(time_s, angle, without_bias, scale_std)


def at_end_of_range(rate: Array, reached: Array) -> Marks:
    """Return the samples (n,) at which a rate (n,) is at an end of the gyro's range: the most that it `reached`.

    There are none unless several half-swings are flat there. A true peak is round: the samples of a cosine within
    1/1000 of its top take a thirty-fifth of a half-swing.
    """
    top = reached >= (1 - _ROUND) * reached.max()
    halves = np.split(top, np.flatnonzero(np.diff(np.signbit(rate))) + 1)
    flat = [half for half in halves if np.count_nonzero(half) > max(_FEWEST_FLAT, _FLAT_SHARE * len(half))]
    return top if len(flat) >= _FEWEST_HALVES else np.zeros(len(top), dtype=bool)


def about_one_axis(rates_rad_per_s: Array) -> Rates:
    """Return the axis along which rates (n, 3) in rad/s lie, its largest component positive, and the rate about it.

    Each gyro adds a constant of its own, the bias, so the axis is found from what changes.
    """
    changing = rates_rad_per_s - rates_rad_per_s.mean(axis=0)
    _, sizes, axes = np.linalg.svd(changing, full_matrices=False)
    axis = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
    off = float(np.hypot(sizes[1], sizes[2]) / sizes[0]) if sizes[0] else 0.0
    return Rates(rates_rad_per_s @ axis, axis, off)


def integrated(time_s: Array, rate_rad_per_s: Array) -> tuple[Array, float]:
    """Return the integral (n,) of a rate (n,) as an angle, and the constant that was subtracted from the rate first.

    A swing returns to its rest angle, so its constant is the one that keeps the middles of the half-swings in place.
    Any other motion begins or ends at rest, where a gyro shows its bias.
    """
    steps = np.diff(time_s) * (rate_rad_per_s[1:] + rate_rad_per_s[:-1]) / 2  # numpy alone: scipy.stats loads for long
    angle = np.concatenate([[0.0], np.cumsum(steps)])
    turns = _extremes(rate_rad_per_s - np.median(rate_rad_per_s))
    at_s, middle = _middles(time_s[turns], angle[turns])
    if len(at_s) >= _FEWEST_MIDDLES:
        before, after = np.triu_indices(len(at_s), k=1)
        bias = float(np.median((middle[after] - middle[before]) / (at_s[after] - at_s[before])))  # Theil and Sen's
        return angle - bias * time_s - float(np.median(middle - bias * at_s)), bias
    bias = _at_rest(time_s, rate_rad_per_s)
    return angle - bias * (time_s - time_s[0]), bias


def _times(series: Series) -> tuple[Array, float]:
    """Return times since the first row by the vehicle's clock, and their scale's uncertainty.

    The scale is that of this computer's clock where arrivals show it better than two crystals agree. An imported log
    has only the vehicle's times. Raises DataError where the stamps are not milliseconds.
    """
    arrival_s = np.zeros(0) if series.time_s is None else series.time_s
    if _STAMP not in series.names:
        return arrival_s - arrival_s[:1], CRYSTAL_STD
    steps_ms = np.diff(series.column(_STAMP).values) % _WRAP_MS
    device_s = 1e-3 * np.concatenate([[0.0], np.cumsum(steps_ms)])
    times = stamped_times(arrival_s, 1e6 * device_s)
    if times is not None and times.scale_std < CRYSTAL_STD:
        return times.time_s - times.time_s[0], times.scale_std
    pace, begin_s = np.polyfit(device_s, arrival_s, 1).tolist() if device_s[-1] > 0 else (0.0, 0.0)
    # Arrivals that are 6 ms late on a busy computer tilt the line by 0.6 % in a second.
    jitter_s = float(np.ptp(arrival_s - (begin_s + pace * device_s)))
    if abs(pace - 1) * device_s[-1] > _LARGEST_SKEW * device_s[-1] + _TILTING * jitter_s:
        raise DataError(
            f"{series.path}: in a second of the vehicle's stamps {pace:.4f} s pass on this computer: they are no "
            "milliseconds, or the vehicle was restarted. Record it again.",
            code="vehicle-clock",
        )
    return device_s, CRYSTAL_STD


def _extremes(rate: Array) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the samples at which a rate (n,) changes its sign between two fast parts."""
    side = np.where(np.abs(rate) > _FLAT * np.abs(rate).max(), np.sign(rate), 0)
    fast = np.flatnonzero(side)
    ends = np.flatnonzero(np.diff(side[fast]))
    return np.array([fast[i] + int(np.argmin(np.abs(rate[fast[i] : fast[i + 1] + 1]))) for i in ends], dtype=np.intp)


def _middles(time_s: Array, angle_rad: Array) -> tuple[Array, Array]:
    """Return times and middles of the wide half-swings between extremes (n,), from three in a row: a decay cancels."""
    swept = np.abs(np.diff(angle_rad))
    wide = np.minimum(swept[:-1], swept[1:]) > _NARROW * swept.max(initial=0.0)  # a hand's tremor is not wide
    middle = (angle_rad[:-2] + 2 * angle_rad[1:-1] + angle_rad[2:]) / 4
    return time_s[1:-1][wide], middle[wide]


def _at_rest(time_s: Array, rate: Array) -> float:
    """Return the mean rate of the quarter of a second in which it is smallest."""
    count = max(int(time_s[-1] / _REST_S), 1)
    means = [float(part.mean()) for part in np.array_split(rate, count)]
    return min(means, key=abs)
