"""One likelihood for a rotor's model, its map, its delay and everything that is only nearly known about a recording.

Output error: what the model shows is compared with the speeds. Beside the rotor's own parameters, nuisance parameters
have priors: how late each command came, how far the speed of each command that rests is off the map, with which power
of its voltage speeds go, and how the map drifts. Noise is autoregressive, outliers weigh little (Cauchy's
loss), and the covariance is a sandwich of what the residuals show. Parameters of single changes, of which a log has
thousands, are eliminated from the equations; they affect few samples each.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz
from scipy.sparse import csc_array, diags_array, eye_array, hstack
from scipy.sparse.linalg import SuperLU, splu

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.linear import gain_of, sandwich, std_of
from cfid.estimate.signals import block_means
from cfid.motors.rotor.model import (
    RESTS_S,
    Course,
    Indices,
    Mask,
    Rates,
    RotorRecord,
    follow,
    held,
    lasting,
    pass_time,
    windows,
)

Array = npt.NDArray[np.float64]

RISE, RISE_SHARE, FALL, FALL_SHARE, DELAY, C0, C1, C2, POWER, WHOLE, LATE, START, STOP, D1, D2, D3 = range(16)
_SUPPLY, _DRIFTS, _WAYS = [POWER, WHOLE, LATE], [D1, D2, D3], ((RISE, RISE_SHARE, START), (FALL, FALL_SHARE, STOP))

# Rates of 1/20 to 1000 1/s, none of which is negative; delays of half a second; and what supplies there are.
_LEAST, _MOST = np.full(16, -np.inf), np.full(16, np.inf)
_LEAST[[RISE, FALL, RISE_SHARE, FALL_SHARE, DELAY, *_SUPPLY]] = -3.0, -3.0, 0.0, 0.0, -0.3, 0.0, 0.0, 0.0
_MOST[[RISE, FALL, RISE_SHARE, FALL_SHARE, DELAY, *_SUPPLY]] = 7.0, 7.0, 1.0, 1.0, 0.5, 1.3, 1.0, 1.0

_FEWEST = 20  # speeds
_FINEST_S, _ROUNDED = 2e-3, 1e-6  # more frequent samples are averaged; part of a row that rounded times may be off
_FEWEST_BETWEEN = 3  # changes between speeds that way: from then on, standstill may have a rate of its own
_SLOWER, _SURE = math.log(1.2), 4.0  # where it is another: by this factor, and standard uncertainties
_LATE_S, _LEAST_LATE_S = 2e-3, 1e-5  # how late single commands come at first, and at least
_OFF_MAP, _DRIFT = 0.03, 0.05  # of the fastest speed: a command's speed beside the map, and a drift of the map
_OUTLIER = 6.0  # standard deviations at which Cauchy's loss halves a weight
_QUIETEST = 1e-4  # of the fastest speed: the least noise
_ORDER, _MOST_CORRELATED = 10, 0.999  # of the noise's autoregression, and its largest decay from sample to sample
_LEAST_VOLTS = 0.05  # of the usual
_ROUNDS, _MOST_STEPS, _CLOSE = 6, 25, 1e-5  # of weights; of each solution; of its cost
_ALIKE = 0.7  # of the fastest: speeds above that are rounded alike
_TAUS_S, _DELAYS_S = (0.015, 0.04, 0.1, 0.25), (0.0, 0.02, 0.06)  # of the coarse start
_MEDIAN_SQUARE = 0.4549  # of a normal variable of size 1
_SMOOTH = 0.25  # time constants over which noise is averaged before judging how much is explained


@dataclass(frozen=True, kw_only=True, eq=False)
class RotorFit:
    """Parameters (16,) of a rotor with their covariance; rates are those at `at_rad_s`, in logarithms.

    `shared` (16, m) is the part of the covariance that all rotors of a recording have in common, one cause a column.
    `ways` are whether the recording has rising and falling speed, `own_start` whether starts from standstill differ
    from other rises, and `supply` whether the voltage is known. `shown` (n,) was compared with `measured` (n,) at
    `time_s` (n,), usually `interval_s` apart. `drift` is the relative change of the map from begin to end, `rms` that
    of the residual, `explained` r^2 over a quarter of a time constant.
    """

    values: Array
    covariance: Array
    shared: Array
    at_rad_s: float
    ways: tuple[bool, bool]
    own_start: bool
    supply: bool
    time_s: Array
    measured: Array
    shown: Array
    explained: float
    rms: float
    drift: float
    interval_s: float

    @property
    def std(self) -> Array:
        """The standard uncertainties (16,)."""
        return std_of(self.covariance)


class _Search(NamedTuple):
    """A recording to fit: its samples (n,), the intervals (m,) of its command, and what is expected of parameters.

    `joins` (n,) are the samples that follow the one before. `hold` (m,) numbers the commands, of which `rests` and
    `changes` (k,) have a speed and a time of their own; `late_s` is how much the latter scatter. `starting` and
    `stopping` (m,) begin or end at standstill. `loading` (m,) is the speed that loads the battery. `expected` and
    `spread` (16,) are of parameters, of which `free` are fitted; `top` is the fastest speed, `rounding` the step of
    speeds.
    """

    record: RotorRecord
    time_s: Array
    measured: Array
    joins: Mask
    begin_s: Array
    command: Array
    first: Mask
    hold: Indices
    rests: Indices
    changes: Indices
    starting: Mask
    stopping: Mask
    at_rad_s: float
    top: float
    rounding: float
    free: Indices
    expected: Array
    spread: Array
    late_s: float
    loading: Array

    @property
    def locals(self) -> tuple[Array, Array]:
        """Expected values and spreads of the parameters of single pieces, commands and changes (k,)."""
        counts = int(self.first.sum()), len(self.rests), len(self.changes)
        spreads = 10 * self.top, _OFF_MAP * self.top, self.late_s
        return np.zeros(sum(counts)), np.repeat(spreads, counts)


def fit_rotor(record: RotorRecord) -> RotorFit:
    """Fit the rotor model, map, delay and nuisances to a recording. Raises FitError for too few speeds or no change."""
    search = _search(record)
    fit = _fitted(search, _start(search))
    both = [way for way, flags in ((START, search.starting), (STOP, search.stopping)) if way in search.free]
    same = [way for way in both if not _differs(fit, way)]
    if same:
        search = search._replace(free=np.setdiff1d(search.free, same))
        begin = fit.values.copy()
        begin[same] = 0.0
        fit = _fitted(search, begin)
    return fit


def _differs(fit: RotorFit, way: int) -> bool:
    return bool(abs(fit.values[way]) > max(_SLOWER, _SURE * fit.std[way]))


def _search(record: RotorRecord) -> _Search:
    known = np.isfinite(record.speed_rad_s)
    if np.count_nonzero(known) < _FEWEST:
        raise FitError(f"{counted(int(known.sum()), 'speed')} while the rotor was driven (limit {_FEWEST}).")
    time_s, measured = record.time_s[known], record.speed_rad_s[known]
    length = max(int(_FINEST_S / np.median(np.diff(time_s)) + _ROUNDED), 1)
    time_s, measured = block_means(time_s, length=length), block_means(measured, length=length)
    interval_s = np.diff(time_s)
    first, command = record.first, record.command
    changed = np.append(True, (np.diff(command) != 0) | first[1:])
    hold = np.cumsum(changed) - 1
    begins = np.flatnonzero(changed)
    if len(begins) < 2 or not np.ptp(command):
        raise FitError("no step of the command: there is nothing that a rotor could have followed.")
    before = np.where(first[begins], np.nan, np.append(np.nan, command[begins[:-1]]))
    to = command[begins]
    held_s = np.diff(record.begin_s[begins], append=max(record.begin_s[-1], time_s[-1]))
    rests = np.flatnonzero(held_s > RESTS_S)
    changes = np.zeros(0, np.intp) if record.moving else np.flatnonzero(np.isfinite(before))
    rises, falls = to > before, to < before
    starts, stops = rises & (before == 0), falls & (to == 0)
    free = set(range(D3 + 1))
    free -= set() if record.volts is not None else set(_SUPPLY)
    for way, own, which in ((rises, starts, _WAYS[0]), (falls, stops, _WAYS[1])):
        if not way.any():
            free -= set(which)
        elif not own.any() or np.count_nonzero(way & ~own) < _FEWEST_BETWEEN:
            free -= {which[2]}
    top, turning = float(np.quantile(measured, 0.99)), measured[measured > 0]
    if not len(turning):
        raise FitError("no rotor turned: all speeds are 0.")
    expected, spread = np.zeros(D3 + 1), np.zeros(D3 + 1)
    expected[[RISE, FALL]], spread[[RISE, FALL]] = math.log(20.0), 3.0
    expected[[RISE_SHARE, FALL_SHARE]], spread[[RISE_SHARE, FALL_SHARE]] = 0.5, 1 / math.sqrt(12)
    spread[DELAY], spread[[C0, C1, C2]] = 0.1, 10 * top
    expected[_SUPPLY], spread[_SUPPLY] = (0.5, 0.0, 0.5), (0.5, 1.0, 0.5)
    spread[[START, STOP]], spread[_DRIFTS] = math.log(2.0), _DRIFT
    return _Search(
        record=record,
        time_s=time_s,
        measured=measured,
        joins=np.append(False, interval_s < 2.5 * np.median(interval_s)),
        begin_s=record.begin_s,
        command=command,
        first=first,
        hold=hold,
        rests=rests,
        changes=changes,
        starting=starts[hold],
        stopping=stops[hold],
        at_rad_s=float(np.median(turning)),
        top=top,
        rounding=_rounding(record.speed_rad_s[known]),
        free=np.array(sorted(free)),
        expected=expected,
        spread=spread,
        late_s=max(record.row_s / math.sqrt(12), _LATE_S),
        loading=np.interp(record.begin_s + np.append(np.diff(record.begin_s) / 2, 0.0), time_s, measured),
    )


def _rounding(speed: Array) -> float:
    """Return the step to which the faster of speeds (n,) are rounded, almost 0 where they are not."""
    sizes = np.unique(np.abs(speed))
    gaps = np.diff(sizes[sizes > _ALIKE * sizes[-1]])
    return float(min(gaps[gaps > 1e-9 * sizes[-1]], default=0.0))


def _rates(search: _Search, p: Array) -> Rates:
    ways = []
    for (rate, share, rest), flags in zip(_WAYS, (search.starting, search.stopping), strict=True):
        size = math.exp(p[rate]) * np.exp(p[rest] * flags)
        ways.append((size * (1 - p[share]), size * p[share] / (2 * search.at_rad_s)))
    return Rates(*ways)


def _target(search: _Search, p: Array, off: Array) -> Array:
    """Return the speed (m,) that each command leads to; `off` (k,) is how far those that rest are off the map."""
    drive, scale = search.command, 1.0
    if search.record.volts is not None:
        middle_s = search.begin_s + np.append(np.diff(search.begin_s) / 2, 0.0) + (1 - p[LATE]) * p[DELAY]
        volts = np.interp(middle_s, *search.record.volts) + search.record.sag_v * search.loading**2
        ratio = np.log(np.maximum(volts / search.record.at_v, _LEAST_VOLTS))
        drive = drive * np.exp(p[POWER] * (1 - p[WHOLE]) * ratio)
        scale = np.exp(p[POWER] * p[WHOLE] * ratio)
    own = np.zeros(search.hold[-1] + 1)
    own[search.rests] = off
    late = np.interp(search.begin_s, [search.begin_s[0], search.time_s[-1]], [-1.0, 1.0])
    mapped = scale * (p[C0] + drive * (p[C1] + drive * p[C2])) * (1 + p[D3] * late)
    mapped = np.where(search.command > 0, mapped + search.top * (p[D1] * late + p[D2] * (late**2 - 1 / 3)), 0.0)
    return np.asarray(np.maximum(mapped + own[search.hold], 0.0))


def _course(search: _Search, p: Array, local: Array) -> Course:
    begins, rests, changes = _split(search, local)
    late = np.zeros(search.hold[-1] + 1)
    late[search.changes] = changes
    begin_s = np.maximum.accumulate(search.begin_s + late[search.hold])
    return follow(begin_s, _target(search, p, rests), _rates(search, p), search.first, begins)


def _split(search: _Search, local: Array) -> tuple[Array, Array, Array]:
    pieces = int(search.first.sum())
    rests = pieces + len(search.rests)
    return local[:pieces], local[pieces:rests], local[rests:]


def _shown(search: _Search, p: Array, local: Array) -> Array:
    course = _course(search, p, local)
    speed = np.zeros(len(search.time_s))
    for time_s, weight in windows(search.time_s - p[DELAY], search.record.blur_s):
        speed += weight * course.at(time_s)[1].speed
    return speed


def _slopes(search: _Search, p: Array, local: Array) -> tuple[Array, csc_array]:
    """Return how the speeds (n,) change with the parameters (n, 16) and with those of single changes (n, k)."""
    course = _course(search, p, local)
    off = _split(search, local)[1]
    target = _target(search, p, off)
    by_map = np.zeros((len(target), len(p)))
    for place in (DELAY, C0, C1, C2, *_SUPPLY, *_DRIFTS):
        step = 1e-4 * search.top if place in (C0, C1, C2) else 1e-4
        moved = p.copy()
        moved[place] += step
        by_map[:, place] = (_target(search, moved, off) - target) / step
    own = _by_rates(search, p, course)
    whole = pass_time(course.speed, course.target, course.length_s, course.k1, course.k2)
    by_begin = course.summed(_added(whole.by_target, whole.by_k1, whole.by_k2, by_map, own))
    pieces, changes = np.flatnonzero(search.first), np.searchsorted(search.hold, search.changes)
    dense, sparse = np.zeros((len(search.time_s), len(p))), list[csc_array]()
    for time_s, weight in windows(search.time_s - p[DELAY], search.record.blur_s):
        at, passed = course.at(time_s)
        more = _added(passed.by_target, passed.by_k1, passed.by_k2, by_map[at], (own[0][at], own[1][at]))
        slopes = passed.by_speed[:, np.newaxis] * by_begin[at] + more
        slopes[:, DELAY] -= passed.by_time
        dense += weight * slopes
        families = [
            lasting(course, time_s, pieces, np.ones(len(pieces))),
            held(course, time_s, search.hold, search.rests),
            lasting(course, time_s, changes, course.jump[changes]),
        ]
        sparse.append(weight * csc_array(hstack(families)))
    return dense, csc_array(sum(sparse[1:], start=sparse[0]))


def _by_rates(search: _Search, p: Array, course: Course) -> tuple[Array, Array]:
    """Return how the rates k1 and k2 of each interval change with the parameters (m, 16)."""
    by_k1, by_k2 = np.zeros((2, len(course.target), len(p)))
    rises = course.target > course.speed
    for (rate, share, rest), way, flags in zip(_WAYS, (rises, ~rises), (search.starting, search.stopping), strict=True):
        size = np.where(way, course.k1 + 2 * search.at_rad_s * course.k2, 0.0)
        by_k1[:, rate], by_k2[:, rate] = course.k1 * way, course.k2 * way
        by_k1[:, rest], by_k2[:, rest] = course.k1 * way * flags, course.k2 * way * flags
        by_k1[:, share], by_k2[:, share] = -size, size / (2 * search.at_rad_s)
    return by_k1, by_k2


def _added(by_target: Array, by_k1: Array, by_k2: Array, target: Array, rates: tuple[Array, Array]) -> Array:
    each = zip((by_target, by_k1, by_k2), (target, *rates), strict=True)
    return np.asarray(sum(way[:, np.newaxis] * slopes for way, slopes in each))


class _Noise(NamedTuple):
    """The size of the noise, what it keeps of the samples before (p,), and the weights (n,) of samples.

    `trust` (n,) is how much of each sample, which may be an outlier, counts for those after it.
    """

    std: float
    kept: Array
    weights: Array
    trust: Array

    def white(self, search: _Search) -> csc_array:
        """Return the matrix (n, n) that makes residuals independent, of size 1, and outliers small."""
        count, joined = len(search.joins), np.ones(len(search.joins), bool)
        matrix = eye_array(count, format="csc")
        for lag, kept in enumerate(self.kept, start=1):
            joined[lag - 1 :] &= search.joins[: count - lag + 1] if lag > 1 else search.joins
            matrix = matrix - diags_array(
                np.where(joined[lag:], kept * self.trust[:-lag], 0.0), offsets=-lag, shape=(count, count)
            )
        return csc_array(diags_array(np.sqrt(self.weights) / self.std) @ matrix)


class _Solution(NamedTuple):
    """The equations at a solution: whitened slopes (n, p) and (n, k), residuals (n,), and the factors of the latter."""

    p: Array
    local: Array
    dense: Array
    sparse: csc_array
    residual: Array
    factors: SuperLU
    matrix: Array
    cost: float


def _solved(search: _Search, p: Array, local: Array, noise: _Noise) -> _Solution:
    """Return the solution with the least squares of whitened residuals and of deviations from what is expected."""
    white, free = noise.white(search), search.free
    usual, spread = search.locals
    prior, local_prior = 1 / search.spread[free] ** 2, 1 / spread**2

    def cost(p: Array, local: Array) -> tuple[float, Array]:
        left = white @ (search.measured - _shown(search, p, local))
        apart = (p - search.expected)[free] / search.spread[free], (local - usual) / spread
        return float(left @ left + sum(one @ one for one in apart)), left

    best, residual = cost(p, local)
    damping = 1e-3
    for _ in range(_MOST_STEPS):
        slopes, local_slopes = _slopes(search, p, local)
        dense, sparse = white @ slopes[:, free], csc_array(white @ local_slopes)
        factors = splu(csc_array(sparse.T @ sparse + diags_array(local_prior)))
        mixed = sparse.T @ dense
        to_local = sparse.T @ residual + local_prior * (usual - local)
        matrix = dense.T @ dense + np.diag(prior) - mixed.T @ factors.solve(mixed)
        right = dense.T @ residual + prior * (search.expected - p)[free] - mixed.T @ factors.solve(to_local)
        before = best
        while damping < 1e8:
            step = _step(matrix + damping * np.diag(np.diag(matrix)), right, (_LEAST - p)[free], (_MOST - p)[free])
            moved, moved_local = p.copy(), local + factors.solve(to_local - mixed @ step)
            moved[free] += step
            now, left = cost(moved, moved_local)
            if now <= best:
                p, local, best, residual, damping = moved, moved_local, now, left, damping / 10
                break
            damping *= 10
        if before - best <= _CLOSE * best:
            break
    return _Solution(p, local, dense, sparse, residual, factors, matrix, best)


def _step(matrix: Array, right: Array, least: Array, most: Array) -> Array:
    """Return the solution (p,) of equations (p, p) within bounds: parameters that would leave them stay there."""
    step, inside = np.zeros(len(right)), np.ones(len(right), bool)
    while True:
        rest = right[inside] - matrix[np.ix_(inside, ~inside)] @ step[~inside]
        size = np.sqrt(np.diag(matrix)[inside])
        step[inside] = np.linalg.solve(matrix[np.ix_(inside, inside)] / np.outer(size, size), rest / size) / size
        outside = inside & ((step < least) | (step > most))
        if not outside.any():
            return step
        step, inside = np.clip(step, least, most), inside & ~outside


def _start(search: _Search) -> Array:
    """Return the parameters (16,) at the best of three solutions, each from the best of a coarse grid at one delay."""
    local = _local_start(search)
    starts = [_coarse(search, local, delay_s) for delay_s in _DELAYS_S]
    weights = np.max([weights for _, weights in starts], axis=0)
    noise = _Noise(0.01 * search.top, np.zeros(0), weights, weights)
    solutions = [_solved(search, start, local, noise) for start, _ in starts]
    return min(solutions, key=lambda solution: solution.cost).p


def _coarse(search: _Search, local: Array, delay_s: float) -> tuple[Array, Array]:
    """Return the best map and equal rates for a delay (16,), by a grid, and the weights of samples (n,)."""
    p, best, found = search.expected.copy(), np.inf, (search.expected, np.ones(len(search.time_s)))
    p[[RISE_SHARE, FALL_SHARE]], p[DELAY] = 0.0, delay_s
    for tau_s in _TAUS_S:
        p[[RISE, FALL]], p[[C0, C1, C2]] = -math.log(tau_s), 0.0
        columns = []
        for place in (C0, C1, C2):
            p[place] = search.top
            columns.append(_shown(search, p, 0 * local))
            p[place] = 0.0
        still, weights = _shown(search, p, local), np.ones(len(search.measured))
        rows = np.column_stack(columns)
        for _ in range(3):
            values = gain_of(rows * weights[:, np.newaxis]) @ (weights * (search.measured - still))
            left = search.measured - still - rows @ values
            scale = max(1.4826 * float(np.median(np.abs(left))), _QUIETEST * search.top)
            weights = 1 / np.sqrt(1 + (left / (_OUTLIER * scale)) ** 2)
        cost = float(np.sum(np.log1p((left / (_OUTLIER * 0.01 * search.top)) ** 2)))
        if cost < best:
            start = p.copy()
            start[[C0, C1, C2]], start[[RISE_SHARE, FALL_SHARE]] = values * search.top, 0.5
            best, found = cost, (start, 1 / (1 + (left / (_OUTLIER * max(scale, 0.01 * search.top))) ** 2))
    return found


def _local_start(search: _Search) -> Array:
    """Return the parameters of single pieces, each of which begins with its first speeds, and of changes (k,)."""
    begins = search.begin_s[search.first]
    local, _ = search.locals
    at = np.minimum(np.searchsorted(search.time_s, begins), len(search.time_s) - 1)
    driven = search.command[search.first] > 0
    local[: len(begins)] = np.where(driven, search.measured[at], 0.0)
    return local


def _noise_of(search: _Search, residual: Array, transit: Array) -> _Noise:
    """Return the noise that residuals (n,) show, at least that of the samples in `transit` (n,) from speed to speed."""
    moving = transit > 0.2 * transit.max()
    least = max(search.rounding / math.sqrt(12), _QUIETEST * search.top)
    trust = 1 / (1 + (residual / (_OUTLIER * _size(residual, moving, least))) ** 2)
    clipped = residual * trust
    lags = np.arange(1, _ORDER + 1)
    whole, *shared = (float(clipped[lag:] @ clipped[: len(clipped) - lag]) for lag in range(_ORDER + 1))
    # White noise beside noise that decays: a fit takes from its residuals what correlates negatively.
    decay = np.clip(np.dot(shared[1:], shared[:-1]) / np.dot(shared[:-1], shared[:-1]), 0.0, _MOST_CORRELATED)
    shows = decay > 0 and shared[0] > 2 * whole / math.sqrt(len(residual))
    part = np.clip(shared[0] / (decay * whole), 0.0, 1.0) if shows else 0.0
    kept = solve_toeplitz(np.append(1.0, part * decay ** lags[:-1]), part * decay**lags)
    white = _Noise(1.0, kept, np.ones(len(residual)), trust).white(search) @ residual
    std = _size(white, moving, least)
    return _Noise(std, kept, 1 / (1 + (white / (_OUTLIER * std)) ** 2), trust)


def _size(residual: Array, moving: Mask, least: float) -> float:
    """Return the size of residuals (n,), at least that of those while the speed changes (n,), without outliers."""
    each = [1.4826 * float(np.median(np.abs(residual[flags]))) for flags in (moving, ~moving) if flags.any()]
    return max(*each, least)


def _fitted(search: _Search, begin: Array) -> RotorFit:
    p, local = begin, _local_start(search)
    noise = _noise_of(search, search.measured - _shown(search, p, local), np.ones(len(search.time_s)))
    for _ in range(_ROUNDS):
        solution = _solved(search, p, local, noise)
        change = np.abs(solution.p - p)
        p, local = solution.p, solution.local
        slopes, _ = _slopes(search, p, local)
        transit = np.abs(slopes[:, [RISE, FALL]]).max(axis=1)
        now = _noise_of(search, search.measured - _shown(search, p, local), transit)
        still = abs(math.log(now.std / noise.std)) < 0.02 and np.all(
            change <= 0.02 * np.sqrt(np.diag(np.linalg.pinv(solution.matrix))).max()
        )
        noise, search = now, search._replace(late_s=_lateness(search, solution), loading=_loading(search, p, local))
        if still:
            break
    return _judged(search, _solved(search, p, local, noise), noise)


def _loading(search: _Search, p: Array, local: Array) -> Array:
    """Return the speeds (m,) in the middle of each interval, with which the rotor loads its battery."""
    middle_s = search.begin_s + np.append(np.diff(search.begin_s) / 2, 0.0)
    return _course(search, p, local).at(middle_s)[1].speed


def _lateness(search: _Search, solution: _Solution) -> float:
    """Return how much the times of single commands scatter, as the speeds show them."""
    late = _split(search, solution.local)[2]
    if not len(late):
        return search.late_s
    seen = np.maximum(np.asarray(solution.sparse.power(2).sum(axis=0)).ravel()[-len(late) :], 1e-300)
    shows = seen * search.late_s**2 > 1
    if not shows.any():
        return search.late_s
    times = (late * (1 + 1 / (seen * search.late_s**2)))[shows]  # as if nothing had been expected of them
    variance = max(float(np.median(times**2)) / _MEDIAN_SQUARE - float(np.median(1 / seen[shows])), 0.0)
    return max(math.sqrt(variance), _LEAST_LATE_S)


def _judged(search: _Search, solution: _Solution, noise: _Noise) -> RotorFit:
    """Return the solution with its covariance."""
    free, p, local = search.free, solution.p, solution.local
    usual, spread = search.locals
    elimination = solution.factors.solve(solution.sparse.T @ solution.dense)
    own = np.vstack([solution.dense - solution.sparse @ elimination, -elimination / spread[:, np.newaxis]])
    inverse = np.linalg.pinv(solution.matrix, hermitian=True)
    leverage, count = np.einsum("ij,jk,ik->i", own, inverse, own), len(solution.residual)
    squares = solution.sparse.power(2)
    taken = squares @ (1 / (squares.sum(axis=0) + 1 / spread**2))  # by single changes, nearly independent of each other
    seen = leverage[:count].copy()
    leverage[:count] += taken
    leverage = np.clip(leverage, 0.0, 0.9)
    left = np.append(solution.residual, (usual - local) / spread) / (1 - leverage)
    prior = np.diag(1 / search.spread[free])
    rows = np.vstack([own, prior])
    found = sandwich(rows, np.append(left, np.zeros(len(free))), longest=count // 4)
    shown_noise = float(seen @ solution.residual**2 / max(float(seen.sum()), 1e-300)) * noise.std**2
    unseen = max(search.rounding**2 / 12 - shown_noise, 0.0) / noise.std**2
    found += unseen * (inverse @ (own[:count].T @ own[:count]) @ inverse)
    # The slope of Cauchy's loss, 2 w^2 - w for a weight w, decides how a fit answers noise; the equations have w.
    found *= (noise.weights.mean() / np.mean(2 * noise.weights**2 - noise.weights)) ** 2
    effects = inverse @ prior
    covariance, shared = np.zeros((len(p), len(p))), np.zeros((len(p), len(p)))
    covariance[np.ix_(free, free)] = found + effects @ effects.T
    shared[np.ix_(free, free)] = effects
    shown = _shown(search, p, local)
    rest = noise.trust * (search.measured - shown)
    drift = 2 * (p[D1] * search.top / search.at_rad_s + p[D3])
    return RotorFit(
        values=p,
        covariance=covariance,
        shared=shared[:, _SUPPLY],
        at_rad_s=search.at_rad_s,
        ways=(RISE in free, FALL in free),
        own_start=START in free,
        supply=POWER in free,
        time_s=search.time_s,
        measured=search.measured,
        shown=shown,
        explained=_explained(search, rest, math.exp(-max(p[RISE], p[FALL]))),
        rms=float(np.sqrt(np.mean(rest**2))),
        drift=drift,
        interval_s=float(np.median(np.diff(search.time_s))),
    )


def _explained(search: _Search, residual: Array, tau_s: float) -> float:
    """Return the part of the variance (r^2) that is not in residuals (n,), over a quarter of a time constant."""
    length = max(round(_SMOOTH * tau_s / float(np.median(np.diff(search.time_s)))), 1)
    each = [block_means(one, length=length) for one in (residual, search.measured)]
    noise, signal = (float(np.var(one)) for one in each)
    return 1 - noise / signal if signal > 0 else 0.0
