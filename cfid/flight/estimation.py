"""Thrust, lag and moments together: the errors of predicting each sensor's next row are least squares.

What a rotor's command does not explain, wind, vibration and the sensors' noise, is correlated with itself and, by the
autopilot, with later commands. An autoregression in each equation takes the part of it that its past foretells; what
is left is independent of everything before, and so of what the commands did (L. Ljung, System Identification, 2nd ed.,
1999, sections 7.3 and 13.4: the direct method in a closed loop). The condition is that these errors have nothing in
common with what the commands did: an equation in which no side is that of a dependent variable.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares

from cfid.errors import FitError
from cfid.estimate.blocks import block_means
from cfid.estimate.linear import gain_of, sandwich, std_of
from cfid.flight.model import AXES, Block, Flight, Lag, blocks_of, segments

Array = npt.NDArray[np.float64]

_QUICKEST_S, _SLOWEST_S = 5e-3, 1.0
_STARTS_S = (0.02, 0.04, 0.07, 0.12)
_PAST = 16  # rows that foretell the next: 0.16 s
_ROUNDS = 3  # in which noise and parameters are estimated in turn
_FEWEST = 500  # rows: 5 s
_SMOOTH = 10  # rows over which noise is averaged before judging how much is explained
_PART = 500  # rows: 5 s, in which a flight's manoeuvres change
_OLDER = 2  # rows, so that no row of an error's difference is in an instrument's
_LAGS = 4  # parameters before those of the thrust
_THRUST = slice(4, 7)
_TURNS = 7  # the first parameter of the moments


@dataclass(frozen=True, kw_only=True, eq=False)
class FlightFit:
    """Time constants in s, thrust over mass (3,) in powers of the drive, in m/s^2, and lever times mass over moment.

    `values` (8,) are these in order, `covariance` (8, 8) theirs. `drive` is the mean in flight, in V if `in_volts`, and
    `drive_range` its quantiles of 1 and 99 %. `explained` is the part of the variance of the vertical force, in means
    over 0.1 s, that the rotors explain, `excitation` by equation the root mean square of what they did there: m/s^2
    vertically, rad/s^2 about an axis. `feedback` (3,) is how much older torques would change the moments, relatively,
    beyond what noise explains; the covariance contains it. `blocks` are the equations at the solution, each with what
    the rotors do in it.
    """

    values: Array
    covariance: Array
    in_volts: bool
    drive: float
    drive_range: tuple[float, float]
    explained: float
    excitation: dict[str, float]
    feedback: Array
    rows: int
    blocks: tuple[tuple[Block, Array], ...]

    @property
    def lag(self) -> Lag:
        """The time constants of rising and falling drives."""
        return Lag(float(self.values[0]), float(self.values[1]))

    @property
    def thrust(self) -> Array:
        """The coefficients (3,) of one rotor's thrust over the vehicle's mass, lowest power first."""
        return self.values[_THRUST]

    @property
    def std(self) -> Array:
        """The standard uncertainties (8,)."""
        return std_of(self.covariance)


def fit_flights(flights: Sequence[Flight]) -> FlightFit:
    """Fit one vehicle to its flights. Raises FitError for less than 5 s in which all rotors were driven."""
    flown = [flight for flight in flights if segments(flight.driven)]
    rows = sum(one.stop - one.start for flight in flown for one in segments(flight.driven))
    if rows < _FEWEST:
        raise FitError(
            f"{rows / 100:.1f} s in the air with every motor within its range (limit {_FEWEST / 100:g} s): the vehicle "
            "has to fly for longer, or lower its thrust."
        )
    latest: dict[tuple[float, ...], list[Block]] = {}  # most columns of a Jacobian have the same lag

    def of_lag(p: Array) -> list[Block]:
        key = tuple(map(float, p[:_LAGS]))
        if key not in latest:
            if len(latest) > 2:
                latest.clear()
            latest[key] = [one for flight in flown for one in blocks_of(flight, Lag(*key[:2]), key[2:])]
        return latest[key]

    found = _start(of_lag)
    white: list[_White] = []
    result = OptimizeResult()
    for _ in range(_ROUNDS):
        white = [_whitening(block, _left(block, found)) for block in of_lag(found)]
        result = least_squares(
            partial(_residual, of_lag=of_lag, white=white),
            found,
            bounds=(
                [_QUICKEST_S, _QUICKEST_S, -0.02, -0.02, *[-np.inf] * 6],
                [_SLOWEST_S, _SLOWEST_S, 0.05, 0.05, *[np.inf] * 6],
            ),
            x_scale=_scales(found),
            diff_step=1e-4,
            xtol=1e-5,
            ftol=1e-7,
            max_nfev=20,
        )
        found = np.asarray(result.x)
    blocks = of_lag(found)
    lengths = [len(one.basis) for one in white]
    jacobian, residual = np.asarray(result.jac), np.asarray(result.fun)
    covariance = _covariance(jacobian, residual, lengths)
    excess = _excess_of_older_torques(jacobian, residual, white)
    covariance[_TURNS:, _TURNS:] += np.diag((excess / math.sqrt(3)) ** 2)
    fitted = tuple((block, _fitted(block, found)) for block in blocks)
    drives = np.concatenate([flight.row_drives[flight.driven] for flight in flown])
    return FlightFit(
        values=found,
        covariance=covariance,
        in_volts=flown[0].in_volts,
        drive=float(np.mean(drives)),
        drive_range=(float(np.quantile(drives, 0.01)), float(np.quantile(drives, 0.99))),
        explained=_explained(fitted),
        excitation=_excitation(fitted),
        feedback=excess / np.maximum(np.abs(found[_TURNS:]), 1e-300),
        rows=rows,
        blocks=fitted,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class DragFit:
    """How fast air brakes along one axis, in 1/s, with its standard uncertainty, and the part that it explains.

    `speed` is the root mean square of the velocity's changes in m/s. `velocity` and `force` (n,) are what was compared.
    """

    rate: float
    std: float
    explained: float
    speed: float
    velocity: Array
    force: Array


def fit_drag(flights: Sequence[Flight], *, axis: int) -> DragFit | None:
    """Fit specific force = -rate * velocity + a constant of each flight along an axis across the thrust, 0 or 1.

    Returns None where less than 5 s have a velocity.
    """
    blocks = []
    for flight in flights:
        parts = [] if flight.velocity is None else segments(flight.airborne)
        if flight.velocity is None or not parts:
            continue
        at = np.concatenate([np.arange(one.start, one.stop) for one in parts])
        lengths = tuple(one.stop - one.start for one in parts)
        terms = -flight.velocity[at, axis : axis + 1]
        blocks.append(Block(axis, flight.force[at, axis], terms, np.ones((len(at), 1)), lengths))
    if sum(map(len, (block.shown for block in blocks))) < _FEWEST:
        return None
    found = np.zeros(1)
    rows, shown = np.zeros((0, 1)), np.zeros(0)
    for _ in range(_ROUNDS):
        each = []
        for block in blocks:
            left = _without(block.shown - block.terms @ found, block.others)
            white = _whitening(block, left)
            each.append((white.of(block.terms), white.of(block.shown[:, np.newaxis])[:, 0]))
        rows, shown = np.concatenate([one[0] for one in each]), np.concatenate([one[1] for one in each])
        found = gain_of(rows) @ shown
    covariance = sandwich(rows, shown - rows @ found, longest=len(shown) // (8 * len(blocks)))
    velocity = np.concatenate([-_without(block.terms[:, 0], np.ones((len(block.shown), 1))) for block in blocks])
    force = np.concatenate([_without(block.shown, block.others) for block in blocks])
    slow = [block_means(values, length=_SMOOTH) for values in (force + found[0] * velocity, force)]
    return DragFit(
        rate=float(found[0]),
        std=math.sqrt(float(covariance[0, 0])),
        explained=float(1 - np.var(slow[0]) / np.var(slow[1])),
        speed=float(np.std(velocity)),
        velocity=velocity,
        force=force,
    )


@dataclass(frozen=True, eq=False)
class _White:
    """What takes the predictable part of an equation's errors away, and its other terms, to a variance of one."""

    filter: Array
    lengths: tuple[int, ...]
    basis: Array  # (k, q), of the whitened other terms
    size: float

    def of(self, columns: Array) -> Array:
        """Return columns (n, p) whitened, without each segment's first rows and without what other terms explain."""
        white = _filtered(columns, self.filter, self.lengths)
        return np.asarray((white - self.basis @ (self.basis.T @ white)) / self.size)


def _whitening(block: Block, left: Array) -> _White:
    past = np.concatenate(
        [
            np.column_stack([part[_PAST - k - 1 : len(part) - k - 1] for k in range(_PAST)])
            for part in _parts(left, block.lengths)
        ]
    )
    now = np.concatenate([part[_PAST:] for part in _parts(left, block.lengths)])
    coefficients = np.concatenate([[1.0], -(gain_of(past) @ now)])
    others = _filtered(block.others, coefficients, block.lengths)
    basis = np.zeros((len(now), 0)) if not others.shape[1] else np.linalg.qr(others / _lengths(others))[0]
    white = _filtered(left[:, np.newaxis], coefficients, block.lengths)[:, 0]
    return _White(coefficients, block.lengths, basis, max(float(np.std(white)), 1e-12))


def _lengths(columns: Array) -> Array:
    return np.asarray(np.maximum(np.linalg.norm(columns, axis=0), 1e-300))


def _filtered(columns: Array, coefficients: Array, lengths: Sequence[int]) -> Array:
    return np.concatenate(
        [
            sum((c * part[_PAST - k : len(part) - k] for k, c in enumerate(coefficients)), np.zeros((1, part.shape[1])))
            for part in _parts(columns, lengths)
        ]
    )


def _parts(columns: Array, lengths: Sequence[int]) -> list[Array]:
    return np.split(columns, np.cumsum(lengths)[:-1])


def _excess_of_older_torques(jacobian: Array, residual: Array, white: Sequence["_White"]) -> Array:
    """Return by how much the last three parameters change if torques of two rows before are instruments, less noise.

    An autopilot that answers to the gyro's noise within a row, or rotors that are no first-order lag, make the two
    differ. Less two standard uncertainties of the difference, so that noise alone changes nothing.
    """
    older = np.zeros((len(residual), len(AXES)))
    begin = 0
    for one in white:
        for length in one.lengths:
            end = begin + length - _PAST
            older[begin + _OLDER : end] = jacobian[begin : end - _OLDER, _TURNS:]
            begin = end
    excess = np.zeros(len(AXES))
    for axis, (now, before) in enumerate(zip(jacobian[:, _TURNS:].T, older.T, strict=True)):
        if abs(float(before @ now)) > 0:
            influence = (before / float(before @ now) - now / float(now @ now)) * residual
            excess[axis] = max(abs(float(np.sum(influence))) - 2 * math.sqrt(float(influence @ influence)), 0.0)
    return excess


def _covariance(jacobian: Array, residual: Array, lengths: Sequence[int]) -> Array:
    """Return the covariance (p, p) of a fit to blocks of rows, wider where parts of 5 s scatter more than it allows.

    A model that is not quite right errs otherwise in each manoeuvre: parts then differ by more than noise explains.
    """
    covariance = sandwich(jacobian, residual, longest=max(len(residual) // (8 * len(lengths)), 10))
    influence = gain_of(jacobian).T * residual[:, np.newaxis]
    ends = [end for one in lengths for end in [*range(0, one - _PART // 2, _PART)]]
    starts = np.repeat(np.cumsum([0, *lengths[:-1]]), [len(range(0, one - _PART // 2, _PART)) for one in lengths])
    sums = np.add.reduceat(influence, starts + np.array(ends, dtype=int), axis=0)
    scatter = np.sum(sums**2, axis=0)
    wider = np.sqrt(np.maximum(scatter / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return np.asarray(covariance * np.outer(wider, wider))


def _start(of_lag: Callable[[Array], list[Block]]) -> Array:
    """Return the best parameters (8,) of a coarse grid of lags, as fast upwards as downwards."""
    best, found = np.inf, np.zeros(10)
    for tau_s in _STARTS_S:
        p = np.concatenate([[tau_s, tau_s, 0.005, 0.005], np.zeros(6)])
        blocks = of_lag(p)
        vertical = [block for block in blocks if block.axis is None]
        rows, shown = (np.concatenate(each) for each in zip(*((b.terms, b.shown) for b in vertical), strict=True))
        p[_THRUST] = gain_of(rows) @ shown
        cost = float(np.sum((shown - rows @ p[_THRUST]) ** 2))
        for axis in range(len(AXES)):
            turning = [block for block in blocks if block.axis == axis]
            torque = np.concatenate([_without(block.terms @ p[_THRUST], block.others) for block in turning])
            spun = np.concatenate([_without(block.shown, block.others) for block in turning])
            p[_TURNS + axis] = float(torque @ spun) / max(float(torque @ torque), 1e-300)
        if cost < best:
            best, found = cost, p
    return found


def _without(values: Array, others: Array) -> Array:
    """Return values (n,) without what other terms (n, q) explain."""
    return np.asarray(values - others @ (gain_of(others) @ values)) if others.shape[1] else values


def _scales(p: Array) -> Array:
    """Return the sizes of the parameters (8,)."""
    thrust = np.full(3, max(float(np.max(np.abs(p[_THRUST]))), 1e-6))
    return np.concatenate([p[:2], [0.01, 0.01], thrust, np.maximum(np.abs(p[_TURNS:]), 1e-3)])


def _fitted(block: Block, p: Array) -> Array:
    """Return what the rotors do (k,) in an equation."""
    gain = 1.0 if block.axis is None else float(p[_TURNS + block.axis])
    return np.asarray(gain * (block.terms @ p[_THRUST]))


def _left(block: Block, p: Array) -> Array:
    """Return an equation's errors (k,), before they are whitened."""
    return _without(block.shown - _fitted(block, p), block.others)


def _residual(p: Array, *, of_lag: Callable[[Array], list[Block]], white: Sequence[_White]) -> Array:
    each = zip(of_lag(p), white, strict=True)
    return np.concatenate([one.of((block.shown - _fitted(block, p))[:, np.newaxis])[:, 0] for block, one in each])


def _explained(fitted: Sequence[tuple[Block, Array]]) -> float:
    """Return the part of the variance of the vertical force's means over 0.1 s that the rotors explain."""
    vertical = [(block, thrusts) for block, thrusts in fitted if block.axis is None]
    left = np.concatenate([block_means(block.shown - thrusts, length=_SMOOTH) for block, thrusts in vertical])
    whole = np.concatenate([block_means(block.shown, length=_SMOOTH) for block, _ in vertical])
    return float(1 - np.var(left) / max(float(np.var(whole)), 1e-300))


def _excitation(fitted: Sequence[tuple[Block, Array]]) -> dict[str, float]:
    found: dict[str, list[Array]] = {}
    for block, thrusts in fitted:
        name = "vertical" if block.axis is None else AXES[block.axis]
        found.setdefault(name, []).append(_without(thrusts, np.ones((len(thrusts), 1))))
    return {name: float(np.std(np.concatenate(each))) for name, each in found.items()}
