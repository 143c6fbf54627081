"""One rotor for steps, staircases, logs and stands: dw/dt = k1 (c - w) + k2 (c^2 - w^2), fitted by output error.

c = c0 + c1 u + c2 u^2 of the drive u = command (V / V0)^power, 0 at command 0; k is (k1, k2) of rising where c > w and
of falling elsewhere; all of it comes `delay_s` after the command. Rows show a command up to one interval late: its mean
is corrected, its scatter is a nuisance parameter of each change, with the prior row/sqrt(12). Noise is autoregressive
of order one, its outliers weigh little (soft L1), slow drifts are projected out, and the covariance is a sandwich.

A peer of `cfid fit dynamics` in tests, of which it shares no code but linear algebra: one likelihood for steps and for
commands that change in every row, where the fit has one for each. It has no levels of each step's own, and takes one
rate for a start from standstill.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dtbtrs
from scipy.optimize import least_squares
from scipy.sparse import csc_array, diags_array, eye_array
from scipy.sparse.linalg import splu

from cfid.estimate.linear import gain_of, sandwich

Array = npt.NDArray[np.float64]

NAMES = ("c0", "c1", "c2", "rising k1", "rising k2", "falling k1", "falling k2", "delay_s", "power", "late")
_ROUNDS = 6  # of weights, correlation and lateness; each begins where the one before ended
_POWER = (0.5, 0.5)  # prior of the voltage's power: 1 for a chopped voltage, 0 for a regulated speed
_POWERS = (0.0, 0.5, 1.0)  # from which the search begins: a curved map and a sag look alike
_LATE = (0.5, 0.5)  # prior of the share of the delay with which the voltage acts, too
_FIRST_S = 0.01  # at the beginning of a recording, whose speeds show where the rotor begins
_OUTLIER = 2.0  # standard deviations from which soft L1 gives a sample less weight
_FORGOTTEN = 12.0  # time constants after which a change's lateness no longer shows
_VOLTS_S = 0.02  # a held command is cut into intervals of this length where the voltage is known
_TAUS_S, _DELAYS_S = (0.015, 0.04, 0.1, 0.25), (0.0, 0.02, 0.06)  # of the coarse start


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Speeds (n,) at times (n,) without gaps of command; commands (m,) of 0 to 1 that hold from times (m,) on.

    `volts` (k,) at times (k,) are relative to the usual voltage. Rows show commands up to `row_s` late (0: exact
    times), and readings up to `age_s` late. Each speed is a mean over `blur_s`. Speeds before `settled_s` are not
    compared.
    """

    time_s: Array
    speed: Array
    command_s: Array
    command: Array
    volts: tuple[Array, Array] | None = None
    row_s: float = 0.0
    age_s: float = 0.0
    blur_s: float = 0.0
    settled_s: float = -math.inf

    @property
    def changes(self) -> npt.NDArray[np.bool_]:
        return np.append(False, np.diff(self.command) != 0)

    def first(self, target: Array) -> float:
        """Return the speed at the beginning: that of the first rows, or of the first target where these show none."""
        begin = self.speed[: np.searchsorted(self.time_s, self.time_s[0] + _FIRST_S) + 1]
        return float(np.nanmean(begin)) if np.isfinite(begin).any() else float(target[0])

    @property
    def compared(self) -> npt.NDArray[np.bool_]:
        return np.isfinite(self.speed) & (self.time_s >= self.settled_s)


def recording(
    *,
    time_s: Array,
    speed: Array,
    command_s: Array,
    command: Array,
    volts: tuple[Array, Array] | None = None,
    **more: float,
) -> Recording:
    """Return a recording whose commands are cut where the voltage, relative to its mean, may have changed."""
    kept = np.append(True, np.diff(command) != 0)
    at_s, held = command_s[kept], command[kept]
    relative = None
    if volts is not None:
        fine_s = np.arange(at_s[0], time_s[-1], _VOLTS_S)
        cut_s = np.union1d(at_s, fine_s)
        held = held[np.searchsorted(at_s, cut_s, side="right") - 1]
        usual = float(np.mean(np.interp(cut_s, *volts)[held > 0]))
        relative, at_s = (volts[0], volts[1] / usual), cut_s
    return Recording(time_s=time_s, speed=speed, command_s=at_s, command=held, volts=relative, **more)


@dataclass(frozen=True, kw_only=True, eq=False)
class RotorFit:
    """Parameters as in NAMES, with their covariance; NaN std where a parameter is at its bound or not shown."""

    values: Array
    covariance: Array
    noise: float
    correlation: float
    explained: float
    late_std_s: float
    shown: Sequence[Array] = field(default_factory=tuple)

    @property
    def std(self) -> Array:
        return np.sqrt(np.diag(self.covariance))

    def time_constant(self, speed: float, *, rising: bool) -> tuple[float, float]:
        """Return the time constant near a speed, and its standard uncertainty."""
        first = 3 if rising else 5
        at = np.array([1.0, 2 * speed])
        rate = float(at @ self.values[first : first + 2])
        own = np.nan_to_num(self.covariance[first : first + 2, first : first + 2])
        return 1 / rate, math.sqrt(at @ own @ at) / rate**2


def _passed(gap: Array, target: Array, held_s: Array, k: Array) -> tuple[Array, Array]:
    """Return the gap to the target after a time, by the exact solution, and its derivative by the gap before."""
    k1, k2 = np.where(gap > 0, k[0], k[2]), np.where(gap > 0, k[1], k[3])
    rate = np.maximum(k1 + 2 * k2 * target, 1e-6)
    left = np.exp(-rate * held_s)
    bend = np.maximum(1 - k2 * gap * (1 - left) / rate, 0.25)
    return left * gap / bend, left / bend**2


def follow(target: Array, held_s: Array, k: Array, first: float) -> tuple[Array, Array]:
    """Return the speed (m,) when each target (m,) begins, from a first one on, and what a change before keeps (m - 1,).

    Newton's method over all intervals at once: the equations of neighbours are linear once the slopes are known.
    """
    speed = np.append(first, target[:-1])
    while True:
        gap, slope = _passed(target[:-1] - speed[:-1], target[:-1], held_s, k)
        right = np.append(first, target[:-1] - gap - slope * speed[:-1])
        band = np.asfortranarray(np.vstack([np.ones(len(target)), np.append(-slope, 0.0)]))
        found = dtbtrs(band, right[:, np.newaxis], uplo="L", diag="U")[0][:, 0]
        if np.abs(found - speed).max() <= 1e-9 * np.abs(target).max():
            return found, slope
        speed = found


def _target(rec: Recording, p: Array) -> Array:
    drive = rec.command
    if rec.volts is not None:  # it acts at once where the command is late, and late as all where the speeds are
        middle_s = rec.command_s + np.diff(rec.command_s, append=rec.command_s[-1] + _VOLTS_S) / 2
        drive = drive * np.interp(middle_s + (1 - p[9]) * p[7], *rec.volts) ** p[8]
    return np.where(rec.command > 0, p[0] + drive * (p[1] + drive * p[2]), 0.0)


def shown(rec: Recording, p: Array, late_s: Array) -> Array:
    """Return the speeds (n,) at the recording's times, whose changes of command came later by `late_s` (m,)."""
    at_s, target = rec.command_s + late_s, _target(rec, p)
    begin, _ = follow(target, np.maximum(np.diff(at_s), 1e-6), p[3:7], rec.first(target))
    nodes = np.array([-0.387, 0.0, 0.387]) if rec.blur_s else np.zeros(1)  # Gauss' of a mean over the blur
    weights = np.array([5.0, 8, 5]) / 18 if rec.blur_s else np.ones(1)
    speed = np.zeros(len(rec.time_s))
    for node, weight in zip(nodes, weights, strict=True):
        time_s = rec.time_s - p[7] + node * rec.blur_s
        place = np.maximum(np.searchsorted(at_s, time_s, side="right") - 1, 0)
        gap, _ = _passed(target[place] - begin[place], target[place], np.maximum(time_s - at_s[place], 0.0), p[3:7])
        speed += weight * (target[place] - gap)
    return speed


def _lateness(rec: Recording, p: Array, late_s: Array) -> csc_array:
    """Return how the compared speeds (n,) move with the lateness of each change (k,) of the command, in rad/s^2."""
    at_s, target, k = rec.command_s + late_s, _target(rec, p), p[3:7]
    begin, slope = follow(target, np.maximum(np.diff(at_s), 1e-6), k, rec.first(target))
    passed = np.append(0.0, np.cumsum(-np.log(np.maximum(slope, 1e-300))))

    def rate(to: Array, now: Array) -> Array:
        up = to > now
        return np.asarray(np.where(up, k[0], k[2]) * (to - now) + np.where(up, k[1], k[3]) * (to**2 - now**2))

    jump = rate(np.append(target[0], target[:-1]), begin) - rate(target, begin)
    time_s = rec.time_s[rec.compared] - p[7]
    place = np.maximum(np.searchsorted(at_s, time_s, side="right") - 1, 0)
    _, own = _passed(target[place] - begin[place], target[place], np.maximum(time_s - at_s[place], 0.0), k)
    seen = passed[place] - np.log(np.maximum(own, 1e-300))
    columns = np.flatnonzero(rec.changes)
    first = np.searchsorted(time_s, at_s[columns])
    last = np.maximum(np.searchsorted(seen, passed[columns] + _FORGOTTEN), first)
    rows = [np.arange(a, b) for a, b in zip(first, last, strict=True)]
    values = [jump[c] * np.exp(passed[c] - seen[r]) for c, r in zip(columns, rows, strict=True)]
    ends = np.append(0, np.cumsum([len(r) for r in rows]))
    return csc_array(
        (np.concatenate([*values, []]), np.concatenate([*rows, []]).astype(int), ends),
        shape=(len(time_s), len(columns)),
    )


class _Whitener:
    """Residuals of a recording without what neighbours share, lateness and drifts, in units of the noise."""

    def __init__(
        self,
        rec: Recording,
        p: Array,
        late_s: Array,
        *,
        correlation: float,
        noise: float,
        weights: Array,
        late_std_s: float,
    ) -> None:
        time_s = rec.time_s[rec.compared]
        step_s = np.diff(time_s)
        self._kept = np.append(0.0, correlation ** (step_s / np.median(step_s)))  # of the residual before
        self._scale = weights / np.sqrt(1 - self._kept**2 * (self._kept > 0)) / noise
        self._scale[0] = weights[0] / noise
        self._scale = self._scale * math.sqrt(1 - correlation**2)
        self._rec, self._late = rec, late_s[rec.changes]
        self._std = late_std_s
        late = time_s - time_s.mean()
        now = shown(rec, p, late_s)[rec.compared]
        drifts = np.column_stack([late, late**2 - np.mean(late**2), late * (now - now.mean())])
        self._factor = None
        if late_std_s > 0 and rec.changes.any():
            columns = _lateness(rec, p, late_s)
            first = np.minimum(np.searchsorted(time_s - p[7], (rec.command_s + late_s)[rec.changes]), len(time_s))
            size = len(time_s)
            white = diags_array([np.ones(size), -self._kept[1:]], offsets=[0, -1], shape=(size, size))
            self._columns = csc_array(diags_array(self._scale) @ white @ columns)
            self._square = csc_array(self._columns.T @ self._columns + eye_array(columns.shape[1]) / late_std_s**2)
            self._factor = splu(self._square)
            self._order = np.argsort(np.append(np.arange(size), first - 0.5), kind="stable")
        self._basis, _ = np.linalg.qr(np.column_stack([self._eliminated(self.white(d), prior=False) for d in drifts.T]))

    def white(self, residual: Array) -> Array:
        return np.asarray(self._scale * (residual - self._kept * np.append(0.0, residual[:-1])))

    def more(self, white: Array, *, prior: bool = True) -> Array:
        """Return how much later still each change came."""
        assert self._factor is not None
        return np.asarray(-self._factor.solve(self._columns.T @ white + prior * self._late / self._std**2))

    def known(self) -> Array:
        return np.asarray(1 / self._square.diagonal())

    def _eliminated(self, white: Array, *, prior: bool = True) -> Array:
        if self._factor is None:
            return white
        more = self.more(white, prior=prior)
        total = (prior * self._late + more) / self._std
        return np.append(white + self._columns @ more, total)[self._order]

    def __call__(self, residual: Array) -> Array:
        rest = self._eliminated(self.white(residual))
        return rest - self._basis @ (self._basis.T @ rest)


def _start(recs: Sequence[Recording]) -> Array:
    """Return the best map, equal rates and delay on a coarse grid (10,)."""
    best, found = math.inf, np.zeros(10)
    measured = np.concatenate([rec.speed[rec.compared] for rec in recs])
    for tau_s in _TAUS_S:
        for delay_s in _DELAYS_S:
            rates = [1 / tau_s, 0, 1 / tau_s, 0, delay_s, _POWER[0], _LATE[0]]
            each = [
                np.concatenate(
                    [shown(rec, np.array([*unit, *rates]), np.zeros(len(rec.command)))[rec.compared] for rec in recs]
                )
                for unit in (np.zeros(3), *np.eye(3))
            ]
            rows, missing = (
                np.column_stack(each[1:]) - each[0][:, np.newaxis],
                measured - each[0],
            )  # of the first speeds
            values = gain_of(rows) @ missing
            cost = float(np.sum((missing - rows @ values) ** 2))
            if cost < best:
                mean = float(np.mean(measured[measured > 0]))
                half = [0.5 / tau_s, 0.25 / tau_s / mean]
                best, found = cost, np.array([*values, *half, *half, delay_s, _POWER[0], _LATE[0]])
    return found


def fit_rotor(recs: Sequence[Recording]) -> RotorFit:
    """Fit one rotor to recordings, all at once."""
    p = _start(recs)
    measured = [rec.speed[rec.compared] for rec in recs]
    top = max(float(np.max(values)) for values in measured)
    scale = np.array([top, top, top, p[3], p[4], p[5], p[6], 0.01, 0.3, 0.3])
    powered = any(rec.volts is not None for rec in recs)
    free = np.ones(10, bool)
    free[8:] = powered
    late = [np.zeros(len(rec.command)) for rec in recs]
    late_std_s = max(rec.row_s for rec in recs) / math.sqrt(12)
    weights = [np.ones(len(values)) for values in measured]
    correlation, noise = (
        0.0,
        _robust(np.concatenate([_residual(rec, p, lag) for rec, lag in zip(recs, late, strict=True)])),
    )

    def full(q: Array) -> Array:
        found = p.copy()
        found[free] = q
        return found

    least, most = (
        np.array([-np.inf] * 3 + [0.0] * 4 + [-0.3, -0.5, -1.0]),
        np.array([np.inf] * 3 + [1000.0, 1.0] * 2 + [0.5, 1.5, 2.0]),
    )
    for turn in range(_ROUNDS):
        whiten = [
            _Whitener(rec, p, lag, correlation=correlation, noise=noise, weights=own, late_std_s=late_std_s)
            for rec, lag, own in zip(recs, late, weights, strict=True)
        ]

        def rest(q: Array, whiten: Sequence[Callable[[Array], Array]] = whiten) -> Array:
            values = full(q)
            parts = [each(_residual(rec, values, lag)) for each, rec, lag in zip(whiten, recs, late, strict=True)]
            priors = [(values[8] - _POWER[0]) / _POWER[1] * powered, (values[9] - _LATE[0]) / _LATE[1] * powered]
            return np.append(np.concatenate(parts), priors)

        starts = (
            [np.concatenate([p[:8], [power, p[9]]])[free] for power in _POWERS] if powered and turn < 2 else [p[free]]
        )
        fits = [
            least_squares(
                rest, start, bounds=(least[free], most[free]), x_scale=scale[free], xtol=1e-6, ftol=1e-6, max_nfev=40
            )
            for start in starts
        ]
        fit = min(fits, key=lambda found: found.cost)
        p = full(fit.x)
        left = [_residual(rec, p, lag) for rec, lag in zip(recs, late, strict=True)]
        spread = []
        for at, (rec, own) in enumerate(zip(recs, whiten, strict=True)):
            if late_std_s and rec.changes.any():
                more = own.more(own.white(left[at]))
                late[at] = late[at].copy()
                total = np.clip(late[at][rec.changes] + more, -rec.row_s, rec.row_s)  # the delay has their mean
                late[at][rec.changes] = total
                spread.append(total**2 + own.known())
        if spread:
            late_std_s = math.sqrt(
                min(float(np.mean(np.concatenate(spread))), max(rec.row_s for rec in recs) ** 2 / 12)
            )
        left = [_beside_drifts(rec, p, lag) for rec, lag in zip(recs, late, strict=True)]
        correlation = float(
            np.clip(sum(r[1:] @ r[:-1] for r in left) / max(sum(r @ r for r in left), 1e-300), 0.0, 0.99)
        )
        white = [np.append(math.sqrt(1 - correlation**2) * r[:1], r[1:] - correlation * r[:-1]) for r in left]
        noise = max(_robust(np.concatenate(white)), 1e-6 * top)
        weights = [(1 + (w / (_OUTLIER * noise)) ** 2) ** -0.25 for w in white]
    at_bound = fit.active_mask != 0
    shown_by_all = _covariance(
        fit.jac[:, ~at_bound], fit.fun, np.concatenate(white) / (_OUTLIER * noise), powered=powered
    )
    places = np.flatnonzero(free)[~at_bound]
    covariance = np.full((10, 10), np.nan)
    covariance[np.ix_(places, places)] = shown_by_all
    row_s, age_s = max(rec.row_s for rec in recs), max(rec.age_s for rec in recs)
    p[7] += (row_s - age_s) / 2
    covariance[7, 7] += (row_s**2 + age_s**2) / 12
    rest_of_all = np.concatenate(left)
    return RotorFit(
        values=p,
        covariance=covariance,
        noise=noise,
        correlation=correlation,
        explained=float(1 - np.var(rest_of_all) / np.var(np.concatenate(measured))),
        late_std_s=late_std_s,
    )


def _covariance(jacobian: Array, residual: Array, outlying: Array, *, powered: bool) -> Array:
    """Return the covariance of a fit by soft L1; the last two rows are priors. `outlying` (n,) are whitened residuals.

    Soft L1 has weights squares**-0.5 and slopes squares**-1.5. Of few changes whose lateness is unknown, a sandwich of
    few large terms is too small: it is at least that of white noise.
    """
    squares, measured = 1 + outlying**2, residual.copy()
    measured[-2:] = 0.0
    weight, slope = np.mean(squares**-0.5), np.mean(squares**-1.5)
    own = sandwich(jacobian, measured, longest=len(measured) // 4) * weight**2 / slope**2
    gain = gain_of(jacobian)
    widening = np.sqrt(np.maximum(np.diag(gain @ gain.T * weight / slope) / np.diag(own), 1.0))
    own = own * np.outer(widening, widening)
    effects = gain[:, -2:] if powered else np.zeros((len(own), 2))  # of the priors' residuals, of unit variance
    return np.asarray(own + effects @ effects.T)


def _residual(rec: Recording, p: Array, late_s: Array) -> Array:
    return (shown(rec, p, late_s) - rec.speed)[rec.compared]


def _beside_drifts(rec: Recording, p: Array, late_s: Array) -> Array:
    residual, time_s = _residual(rec, p, late_s), rec.time_s[rec.compared]
    late, now = time_s - time_s.mean(), residual + rec.speed[rec.compared]
    columns = np.column_stack([late, late**2 - np.mean(late**2), late * (now - now.mean())])
    return np.asarray(residual - columns @ (gain_of(columns) @ residual))


def _robust(residual: Array) -> float:
    return float(1.4826 * np.median(np.abs(residual - np.median(residual))))
