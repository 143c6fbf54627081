"""One dropped weight: where the axis' speed is steady, and the fall up to there (sections 2.4.2, C.1.2)."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from cfid.errors import DataError
from cfid.estimate.linear import mean_of
from cfid.estimate.signals import GRID_S, check_dense, resample
from cfid.friction.turns import check_turns, counted_turns

Array = npt.NDArray[np.float64]

MEDIAN_SAMPLES = 7  # C.1.2, O_medfilt

_BLOCK_S = 0.05
_SHORTEST_S = 0.25
_STEADY = 0.03  # slope across the window and scatter within it, relative to the mean speed
# Seconds of a window, and after it, in which an impact is sought; seconds before an impact that are left out; and how
# many times as much as noise a bend must explain.
_BEND_S, _AFTER_S, _BESIDE_S, _CLEAR = 1.0, 0.5, 0.02, 30.0
_QUICK = 0.1  # of the rise at the release: the least slowing of the axis by an impact, as a line over half a second
_MOVING = 0.2  # of the highest speed
_BEFORE_S = 0.3
_NEAR = 0.25  # of the mean speed: if the speed tends to a value farther from it, the fall has not shown that value


@dataclass(frozen=True, kw_only=True)
class Drop:
    """One dropped weight: the unwrapped record (n,), its speed (n - 1,), the window and what follows from it.

    `speed_rad_per_s` is the mean in the window; `coefficient_nms_per_rad` = m g r / speed (eq. 2.14 at rest). Without a
    settled speed, both are the values of the best window found, and are not to be used. `terminal_rad_per_s` and
    `time_constant_s` are those of eq. 2.13 fitted from before the release to the window's end, and `model_rad` (m,) is
    that fit at `model_time_s` (m,). `speed_per_turn` is the change per turn of the axis in the speed that the fall
    tends to, relative to that speed, and `turns` is how many turns the fit covers.
    """

    weight_kg: float
    time_s: Array
    angle_rad: Array
    trace_rad_per_s: Array
    from_s: float
    to_s: float
    settled: bool
    speed_rad_per_s: float
    speed_std_rad_per_s: float
    ripple: float
    coefficient_nms_per_rad: float
    terminal_rad_per_s: float
    time_constant_s: float
    model_time_s: Array
    model_rad: Array
    speed_per_turn: float = 0.0
    turns: float = 0.0
    weight_std_kg: float = 0.0


def measure_drop(
    time_s: Array,
    angle_rad: Array,
    *,
    weight_kg: float,
    weight_std_kg: float = 0.0,
    radius_m: float,
    gravity_mps2: float,
    from_s: float | None = None,
    to_s: float | None = None,
) -> Drop:
    """Find where the falling weight's speed is steady, average it there and fit eq. 2.13 up to its end.

    `from_s` and `to_s` set the window by hand.

    Raises DataError when the axis does not turn, or when the samples are too few for the time that they span.
    """
    check_dense(time_s)
    counted, unclear = counted_turns(time_s - time_s[0], angle_rad)
    grid, angle = resample(time_s - time_s[0], counted, step_s=GRID_S)
    if np.ptp(angle) < 2 * np.pi:
        raise DataError(f"the axis turns by {np.ptp(angle):.2g} rad in all: no weight dropped, or the wrong unit.")
    angle = angle * math.copysign(1.0, angle[-1] - angle[0])
    speed = median_filter(np.diff(angle) / GRID_S, size=MEDIAN_SAMPLES, mode="nearest")
    moving = _moving(speed)
    window, ripple = _steady_window(speed, moving)
    if from_s is not None or to_s is not None:
        window = _by_hand(grid, from_s, to_s)
        ripple = _unsteadiness(_blocks(speed[window]))
    inside = speed[window]
    mean = float(inside.mean())
    if mean <= 0:
        raise DataError("the axis stands still in the window: choose another.")
    check_turns(time_s - time_s[0], counted, unclear, grid[moving.start], grid[window.stop - 1])
    begin, (terminal, tau), model = _fit_fall(grid, angle, moving.start, window.stop, mean)
    fall = slice(moving.start, window.stop)  # after it the weight may be on the floor
    return Drop(
        weight_kg=weight_kg,
        weight_std_kg=weight_std_kg,
        time_s=grid,
        angle_rad=angle,
        trace_rad_per_s=speed,
        from_s=float(grid[window.start]),
        to_s=float(grid[window.stop - 1]),
        settled=ripple <= _STEADY and abs(terminal / mean - 1) <= _NEAR,
        speed_rad_per_s=mean,
        speed_std_rad_per_s=_mean_std(inside),
        ripple=ripple,
        coefficient_nms_per_rad=weight_kg * gravity_mps2 * radius_m / mean,
        terminal_rad_per_s=terminal,
        time_constant_s=tau,
        model_time_s=grid[begin : window.stop],
        model_rad=model,
        speed_per_turn=_speed_per_turn(grid[fall], angle[fall], speed[fall], tau),
        turns=float(angle[window.stop] - angle[moving.start]) / (2 * math.pi),
    )


def _moving(speed: Array) -> slice:
    """Return the samples of the fall: from its first motion to the end of the longest fast segment."""
    fast = speed > _MOVING * np.quantile(speed, 0.98)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fast.astype(int), [0]])))
    starts, stops = edges[::2], edges[1::2]
    longest = int(np.argmax(stops - starts))
    return slice(int(starts[longest]), int(stops[longest]))


def _blocks(speed: Array) -> Array:
    length = max(round(_BLOCK_S / GRID_S), 1)
    count = max(len(speed) // length, 1)
    return np.array([part.mean() for part in np.array_split(speed, count)])


def _unsteadiness(blocks: Array) -> float:
    """Return the larger of the trend across a segment and its scatter, relative to its mean."""
    place, size = _across(len(blocks))
    trend = float(blocks @ place / size) if len(blocks) > 1 else 0.0
    return max(abs(trend), float(blocks.std())) / max(abs(float(blocks.mean())), 1e-12)


@cache
def _across(count: int) -> tuple[Array, float]:
    """Return places (count,) from one end of a segment, -0.5, to the other, 0.5, and the sum of their squares."""
    place = np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(1)
    return place, float(place @ place)


def _steady_window(speed: Array, moving: slice) -> tuple[slice, float]:
    """Return the longest steady segment of the fall (samples), or the steadiest short one, and its ripple.

    A segment counts as steady over two turns at least: friction that changes within a turn, as in the
    thesis' 10 g case, must not hide between two of its waves.
    """
    length = max(round(_BLOCK_S / GRID_S), 1)
    fall = speed[moving]
    blocks = _blocks(fall)
    best: tuple[int, float, int, int] | None = None
    for first in range(len(blocks)):
        for last in range(len(blocks), first, -1):
            seconds = (last - first) * _BLOCK_S
            turns = blocks[first:last].sum() * _BLOCK_S / (2 * math.pi)
            if seconds < _SHORTEST_S or turns < 2:
                break
            ripple = _unsteadiness(blocks[first:last])
            steady = ripple <= _STEADY
            key = (last - first if steady else 0, -ripple, first, last)
            if best is None or key[:2] > best[:2]:
                best = key
            if steady:
                break
    if best is None:
        return moving, math.inf
    start = moving.start + best[2] * length
    stop = min(moving.start + best[3] * length, moving.stop)
    return slice(start, _before_impact(speed, slice(start, stop), moving)), -best[1]


def _before_impact(speed: Array, window: slice, moving: slice) -> int:
    """Return the end of a steady window of the fall (samples) without what follows the weight's impact on the floor.

    After the impact, the axis lacks the torque that turned it: the speed bends down, about as quickly as it rose at the
    release, and ends below all of the window. Friction that changes within a turn also bends the speed, which then
    recovers; a line wound in layers bends it slowly.
    """
    start, stop = int(window.start), int(window.stop)
    begin, after = max(start, stop - round(_BEND_S / GRID_S)), min(stop + round(_AFTER_S / GRID_S), moving.stop)
    shown = speed[begin:after]
    place = np.arange(len(shown), dtype=np.float64)
    straight = np.stack([np.ones(len(shown)), place])
    left = float(np.sum((shown - straight.T @ np.linalg.lstsq(straight.T, shown, rcond=None)[0]) ** 2))
    best, bend = left, 0
    rising = max(int(np.argmax(speed[moving] > speed[window].mean() / 2)), 1)  # samples to half the speed
    least = _QUICK * float(speed[window].mean()) / 2 / rising
    for at in range(round(_SHORTEST_S / GRID_S), min(stop - begin, len(shown) - 2), MEDIAN_SAMPLES):
        rows = np.vstack([straight, np.maximum(place - at, 0.0)])
        found = np.linalg.lstsq(rows.T, shown, rcond=None)[0]
        error = float(np.sum((shown - rows.T @ found) ** 2))
        if found[1] + found[2] < -least and error < best:
            best, bend = error, at
    independent = len(shown) / MEDIAN_SAMPLES
    if not bend or left - best < _CLEAR * best / independent:
        return stop
    kept = begin + bend - round(_BESIDE_S / GRID_S)
    last = float(shown[-round(_BLOCK_S / GRID_S) :].mean())
    if kept - start < round(_SHORTEST_S / GRID_S) or last >= float(_blocks(speed[start:kept]).min()):
        return stop
    return kept


def _by_hand(grid: Array, from_s: float | None, to_s: float | None) -> slice:
    start = int(np.searchsorted(grid, from_s or 0.0))
    stop = len(grid) - 1 if to_s is None else int(np.searchsorted(grid, to_s, side="right"))
    stop = min(stop, len(grid) - 1)
    if stop - start < 2:
        raise DataError(f"no samples in the window requested; the record lasts {grid[-1]:.3g} s.")
    return slice(start, stop)


def _mean_std(inside: Array) -> float:
    blocks = _blocks(inside)
    return float(mean_of(blocks).std[0]) if len(blocks) > 1 else 0.0


def _fit_fall(grid: Array, angle: Array, start: int, stop: int, speed: float) -> tuple[int, tuple[float, float], Array]:
    """Fit eq. 2.13 from just before the release to the window's end; return terminal speed and time constant.

    The moment of release is a parameter, since it lies between two samples.
    """
    begin = max(start - round(_BEFORE_S / GRID_S), 0)
    time, turned = grid[begin:stop], angle[begin:stop]

    def model(p: Array) -> Array:
        level, terminal, tau, release = p
        fallen = np.maximum(time - release, 0.0)
        tau = max(tau, 1e-5)
        return np.asarray(level + terminal * (fallen + tau * np.expm1(-fallen / tau)))

    first = np.array([turned[0], speed, 0.05, grid[start]])
    scale = np.array([1.0, speed, 0.05, 0.05])
    found = least_squares(lambda p: model(p) - turned, first, x_scale=scale, max_nfev=200)
    return begin, (float(found.x[1]), float(found.x[2])), model(found.x)


def _speed_per_turn(time: Array, angle: Array, speed: Array, tau: float) -> float:
    """Return how much a fall's speed (n,) changes in a turn, relative to its mean, apart from its exponential start."""
    turned = (angle - angle[0]) / (2 * math.pi)
    start = np.exp(-(time - time[0]) / max(tau, GRID_S))
    rows = np.stack([np.ones(len(time)), turned - turned.mean(), start], axis=1)
    level, slope, _ = np.linalg.lstsq(rows, speed, rcond=None)[0]
    return float(slope / level) if level > 0 else 0.0
