"""One dropped weight: where the axis' speed is steady, and the fall up to there (sections 2.4.2, C.1.2)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from cfid.errors import DataError
from cfid.estimate.held_readings import once_each
from cfid.estimate.linear import mean_of
from cfid.estimate.signals import GRID_S, check_dense, resample
from cfid.findings import Finding, note

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
_JUMP_RAD = math.pi / 2  # largest difference between one step and the next: no axis turns like that
_EVEN = 1.5  # times the usual step: beyond, samples are missing
_BESIDE = 7  # samples on each side that show the speed
_LONGEST_S = 0.5  # longest time that a speed is known to last
_EDGES_SHARE = 0.95  # least share of one-count steps in rows of an encoder's edges
_FEW_LOST = 3.5  # counts between two such rows, as a few may be lost, in which the axis hardly turned
_APART_S = 5.0  # time that separates two recordings in one file
_BEGIN_S = 0.05  # by which a fall may begin before it is fast
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
    counted, unclear = _counted_turns(time_s - time_s[0], angle_rad)
    grid, angle = resample(time_s - time_s[0], counted, step_s=GRID_S)
    if np.ptp(angle) < 2 * np.pi:
        raise DataError(f"the axis turns by {np.ptp(angle):.2g} rad in all: no weight dropped, or the wrong unit.")
    angle = angle * math.copysign(1.0, angle[-1] - angle[0])
    speed = median_filter(np.diff(angle) / GRID_S, size=MEDIAN_SAMPLES, mode="nearest")
    moving = _moving(speed)
    window, ripple = _steady_window(speed, moving)
    if from_s is not None or to_s is not None:
        window = _by_hand(grid, from_s, to_s)
        ripple = float(_unsteadiness(_blocks(speed[window]))[-1])
    inside = speed[window]
    mean = float(inside.mean())
    if mean <= 0:
        raise DataError("the axis stands still in the window: choose another.")
    _check_turns(time_s - time_s[0], counted, unclear, grid[moving.start], grid[window.stop - 1])
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


def _unsteadiness(blocks: Array) -> Array:
    """Return for each first part (1 to n blocks) of a segment the larger of its trend and scatter, over its mean."""
    count = np.arange(1, len(blocks) + 1)
    total, moment, squares = (np.cumsum(blocks * weight) for weight in (1.0, count - 1, blocks))
    mean = total / count
    places = count * (count + 1) / 12  # squares of places from -0.5 to 0.5, times one less than their number
    trend = np.abs(moment - (count - 1) * total / 2) / places
    scatter = np.sqrt(np.maximum(squares / count - mean**2, 0.0))
    return np.asarray(np.maximum(trend, scatter) / np.maximum(np.abs(mean), 1e-12))


def _steady_window(speed: Array, moving: slice) -> tuple[slice, float]:
    """Return the longest steady segment of the fall (samples), or the steadiest short one, and its ripple.

    A segment counts as steady over two turns at least: friction that changes within a turn, as in the
    thesis' 10 g case, must not hide between two of its waves.
    """
    length = max(round(_BLOCK_S / GRID_S), 1)
    blocks = _blocks(speed[moving])
    best: tuple[int, float, int, int] | None = None
    for first in range(len(blocks)):
        ripple, turned = _unsteadiness(blocks[first:]), np.cumsum(blocks[first:]) * _BLOCK_S / (2 * math.pi)
        enough = (np.arange(1, len(ripple) + 1) * _BLOCK_S >= _SHORTEST_S) & (turned >= 2)
        if not enough.any():
            continue
        steady = np.flatnonzero(enough & (ripple <= _STEADY))
        place = int(steady[-1]) if len(steady) else int(np.argmin(np.where(enough, ripple, np.inf)))
        key = (place + 1 if len(steady) else 0, -float(ripple[place]), first, first + place + 1)
        if best is None or key[:2] > best[:2]:
            best = key
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


def read_once(time_s: Array, angle_rad: Array) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Return the times (m,) and angles (m,) of a record's rows (n,) with a new reading, and a note where others are.

    Rows that repeat a reading show an axis that stands still and then jumps. Angles are compared within a turn, where
    they show the sensor's steps; those over many turns of an even speed grow by steps that are not the sensor's. Where
    rows are an encoder's edges, a rest has none.
    """
    counts, readings = once_each(time_s, angle_rad % (2 * math.pi))
    if _count_of_edges(angle_rad) or not readings.age_s:
        return time_s, angle_rad, ()
    rate_hz, share = 1 / readings.row_s, readings.read / readings.rows
    text = (
        f"each reading of the angle is repeated in about {1 / share:.2g} rows: {rate_hz:.3g} rows a second show "
        f"{rate_hz * share:.3g} readings. The first row of each counts."
    )
    return time_s[counts], angle_rad[counts], (note("friction-angle-repeated", text, "friction.*"),)


def _counted_turns(time_s: Array, angle_rad: Array) -> tuple[Array, Sequence[int]]:
    """Return an angle (n,) with the turns that its speed shows where samples are missing, and the gaps that stay open.

    A reading within a turn does not show how many turns passed while none was taken. The speeds on both sides of the
    gap do, where they agree within half a turn; other gaps are returned by the index of the sample before them. Where
    an encoder writes a row at each of its counts, the axis hardly turned between two rows that are a few counts apart.
    Raises DataError for a gap that no recording of a fall has.
    """
    step_s, step = np.diff(time_s), np.diff(angle_rad)
    if step_s.max() > _APART_S:
        begin_s = time_s[int(np.argmax(step_s))]
        raise DataError(
            f"nothing was recorded for {step_s.max():.3g} s after the first {begin_s:.3g} s. Was the clock set? Fit a "
            "file of one part."
        )
    still_rad = _FEW_LOST * _count_of_edges(angle_rad)
    even = step_s < _EVEN * np.median(step_s)
    speed = np.where(even, step / step_s, np.nan)
    turns, unclear = np.zeros(len(step)), []
    for place in np.flatnonzero(~even).tolist():
        before, after = _usual(speed[max(place - _BESIDE, 0) : place]), _usual(speed[place + 1 :][:_BESIDE])
        if step_s[place] > _LONGEST_S or abs(after - before) * step_s[place] > math.pi:
            if abs(step[place]) > still_rad:
                unclear.append(place)
        else:
            turns[place] = np.rint(((before + after) / 2 * step_s[place] - step[place]) / (2 * math.pi))
    return angle_rad + 2 * math.pi * np.concatenate([[0.0], np.cumsum(turns)]), unclear


def _check_turns(time_s: Array, angle_rad: Array, unclear: Sequence[int], from_s: float, to_s: float) -> None:
    """Raise DataError where turns are miscounted between two times of a fall: the angle (n,) jumps or a gap is long."""
    late = [place for place in unclear if time_s[place] < to_s and time_s[place + 1] > from_s - _BEGIN_S]
    if late:
        begin, end = time_s[late[0]], time_s[late[0] + 1]
        raise DataError(
            f"samples are missing from {begin:.2f} to {end:.2f} s, within the fall: its turns cannot be counted. End "
            "what else keeps the computer busy."
        )
    fall = (time_s[1:-1] > from_s) & (time_s[1:-1] < to_s)
    step_s = np.diff(time_s)
    even = np.maximum(step_s[1:], step_s[:-1]) < _EVEN * np.median(step_s)
    jumps = np.flatnonzero(fall & even & (np.abs(np.diff(angle_rad, 2)) > _JUMP_RAD))
    if len(jumps):
        raise DataError(
            f"the angle jumps by more than a quarter of a turn at {time_s[jumps[0] + 1]:.2f} s, within the fall: its "
            "turns cannot be counted. See to the encoder's cable."
        )


def _count_of_edges(angle_rad: Array) -> float:
    """Return an encoder's count in radians where rows (n,) are its changes by one count; 0 where it is polled.

    A few rows may have been lost, or repeat a count where the axis turned back.
    """
    steps = np.abs(np.diff(angle_rad))
    count = float(np.median(steps))
    return count if np.mean(np.isclose(steps, count)) > _EDGES_SHARE else 0.0


def _usual(speed: Array) -> float:
    known = speed[np.isfinite(speed)]
    return float(np.median(known)) if len(known) else 0.0
