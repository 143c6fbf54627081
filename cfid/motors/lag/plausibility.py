"""Speeds that no rotor had under its commands: those of a sensor that stands still, and those far off all commands."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.estimate.signals import block_means
from cfid.motors.lag.model import Signal

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_STILL_S = 1.0  # without the least change: telemetry may repeat a reading for some tenths of a second
_MOVES = 0.05  # of its mean: the standard deviation of a command that a speed would show
_SHOWN, _SHOWN_S = 0.003, 0.05  # of its mean: what changes less, in means of 50 ms, may be the noise of its reading
_BEYOND, _ODD = 0.25, 8.0  # of the range of speeds that the commands lead to, and standard deviations of the noise


def moves(drive: Signal, time_s: Array) -> bool:
    """Return whether a drive changes so much at times (n,), apart from a slow change, that a speed would show it."""
    return len(time_s) > 3 and _change(time_s, drive.held(time_s)) > _MOVES


def varies(volts: Signal) -> bool:
    """Return whether a battery's voltage changes so much, apart from a slow change, that speeds show its effect."""
    length = max(round(_SHOWN_S / np.median(np.diff(volts.time_s))), 1)
    time_s, means = (block_means(series, length=length) for series in volts)
    return len(time_s) > 3 and _change(time_s, means) > _SHOWN


def _change(time_s: Array, value: Array) -> float:
    """Return how much values (n,) at times (n,) change, apart from a slow change, relative to their mean."""
    trend = np.polynomial.Polynomial.fit(time_s, value, 2)(time_s)
    return float(np.std(value - trend) / max(abs(float(np.mean(value))), 1e-300))


def standing(drive: Signal, measured: Signal) -> Flags:
    """Return which measured values (n,) never changed for a second or longer while their drive moved."""
    time_s, value = measured
    found = np.zeros(len(value), bool)
    begins = np.flatnonzero(np.append(True, np.diff(value) != 0)[: len(value)])
    ends = np.append(begins[1:], len(value)) if len(value) else begins
    long = time_s[ends - 1] - time_s[begins] >= _STILL_S
    for first, last in zip(begins[long], ends[long], strict=True):
        found[first:last] = moves(drive, time_s[first:last])
    return found


def odd(measured: Array, shown: Array, *, noise: float) -> Flags:
    """Return which measured values (n,) lie, even with noise, far outside all that a lag shows (n,): no rotor's values.

    A lag never leaves the range of the speeds that its commands lead to.
    """
    low, high = float(shown.min()), float(shown.max())
    margin = _BEYOND * (high - low) + _ODD * noise
    return np.asarray((measured < low - margin) | (measured > high + margin))


def noise_of(residual: Array) -> float:
    """Return the standard deviation of most residuals (n,), which a few outliers do not change."""
    return float(1.4826 * np.median(np.abs(residual - np.median(residual))))


def clipped(measured: Array) -> Array:
    """Return measured values (n,), clipped to where noise about their median would put them, for a first guess."""
    middle, reach = float(np.median(measured)), _ODD / 2 * noise_of(measured)
    return np.asarray(np.clip(measured, middle - reach, middle + reach))


def any_far(residual: Array) -> bool:
    """Return whether any of the residuals (n,) lies far from most of them."""
    return bool(np.abs(residual - np.median(residual)).max() > _ODD * noise_of(residual))


def without(measured: Sequence[Signal], flags: Flags) -> list[Signal]:
    """Return signals without the values that flags (n,) mark; the flags cover all signals in turn."""
    each = zip(measured, np.split(~flags, np.cumsum([len(one.value) for one in measured])[:-1]), strict=True)
    return [Signal(one.time_s[kept], one.value[kept]) for one, kept in each]
