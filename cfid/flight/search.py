"""Solve a flight's equations: from coarse lags on, update noise and parameters alternately until both converge."""

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares

from cfid.errors import FitError
from cfid.estimate.linear import gain_of
from cfid.estimate.signals import block_means
from cfid.flight.equations import DELAY_S, LAGS, THRUST, TURNS, Equations
from cfid.flight.likelihood import without
from cfid.flight.model import FlightEquation
from cfid.flight.rows import AXES

Array = npt.NDArray[np.float64]

_QUICKEST_S, _SLOWEST_S = 5e-3, 1.0  # limits of a lag
_EARLIEST_S, _LATEST_S = -0.02, 0.05  # limits of a delay
_STARTS_S = (0.02, 0.04, 0.07, 0.12)
# Delays of an accelerometer with a filter of 10 Hz, and the least gain in fit for them; usual accelerometers have 0.9
# to 1.1.
_LATE_S, _CLEARLY = (0.02, 0.035), 1.4
_MEAN_ROWS = 10  # 0.1 s, over which noise is averaged before judging how much is explained
_MOST_ROUNDS = 100  # in which noise and parameters are estimated alternately
_WHOLE_ROUNDS = 3  # at first, because single steps from far away can end elsewhere
_STEPS = 5  # evaluations in a round
_SETTLED = 0.05  # standard uncertainties: the largest change of a parameter in the last round


def first_parameters(equations: Equations) -> Array:
    """Return the best parameters (10,) of a coarse grid of lags, with the same lag for rising and falling drives.

    A much larger delay of the accelerometer than usual is chosen only if it clearly leaves less of the force
    unexplained: otherwise, lag and delay have nearly the same effect.
    """
    best, found = np.inf, np.zeros(TURNS.stop)
    for tau_s, of_force_s in itertools.product(_STARTS_S, (DELAY_S, *_LATE_S)):
        p = _start(tau_s, of_force_s, DELAY_S)
        blocks = equations.at(p)
        vertical = [block for block in blocks if block.axis is None]
        rows, shown = (np.concatenate(each) for each in zip(*((b.terms, b.shown) for b in vertical), strict=True))
        p[THRUST] = gain_of(rows) @ shown
        cost = float(np.sum((shown - rows @ p[THRUST]) ** 2)) * (1.0 if of_force_s == DELAY_S else _CLEARLY)
        for axis in range(len(AXES)):
            turning = [block for block in blocks if block.axis == axis]
            torque = np.concatenate([without(block.terms @ p[THRUST], block.others) for block in turning])
            spun = np.concatenate([without(block.shown, block.others) for block in turning])
            p[TURNS.start + axis] = float(torque @ spun) / max(float(torque @ torque), 1e-300)
        if cost < best:
            best, found = cost, p
    return found


def most_explained(equations: Equations, *, enough: float) -> float:
    """Return the largest part of the vertical force that thrusts of any powers explain, in means over 0.1 s.

    Coarse lags and delays are tried, the same for rising and falling drives, until one explains `enough`.
    """
    most = 0.0
    for delay_s in (DELAY_S, _EARLIEST_S, _LATEST_S):
        for tau_s in _STARTS_S:
            most = max(most, _explained(equations.at(_start(tau_s, delay_s, delay_s))))
            if most >= enough:
                return most
    return most


def _explained(blocks: Sequence[FlightEquation]) -> float:
    columns = [np.column_stack([block.shown, block.terms]) for block in blocks if block.axis is None]
    means = np.concatenate([block_means(one.T, length=_MEAN_ROWS).T for one in columns])
    shown, rows = means[:, 0], means[:, 1:]
    left = shown - rows @ (gain_of(rows) @ shown)
    return 1 - float(np.var(left)) / max(float(np.var(shown)), 1e-300)


def settled(equations: Equations, found: Array) -> tuple[Equations, OptimizeResult]:
    """Return the equations whitened by the noise that they leave, and their solution: each is found from the other.

    In calm air and with an instrument that is mostly noise, a round moves some parameters by many standard
    uncertainties at first. Away from the solution, past errors contain the effects of the rotors and absorb most of a
    parameter's change, so that a step goes too far: full steps can alternate forever between two states on either side
    of the solution. Where a step reverses the last one, the likeliest share of it is taken. Raises FitError where the
    parameters do not converge.
    """
    last = np.zeros(TURNS.stop - 1)
    for place in range(_MOST_ROUNDS):
        equations = equations.whitened(found)
        begin = _without_constant(found)
        result = _improved(equations, begin, _without_constant(_scales(found)), whole=place < _WHOLE_ROUNDS)
        step, std = np.asarray(result.x) - begin, np.linalg.norm(gain_of(np.asarray(result.jac)), axis=1)
        if np.all(np.abs(step) <= _SETTLED * std):
            return equations, result
        moved = step / np.maximum(std, 1e-300)
        turned_back = float(moved @ last) < 0
        share = equations.likeliest(found, with_constant(step)) if turned_back else 1.0
        found, last = with_constant(begin + share * step), share * moved
    raise FitError(
        f"noise and parameters, found in turn, do not come to rest in {_MOST_ROUNDS} rounds: the flight's noise "
        "changes, or it does not tell lag, delays and moments apart. Fit a part of it (`from_s`, `to_s`), or fly "
        "quicker manoeuvres."
    )


def _improved(equations: Equations, begin: Array, scales: Array, *, whole: bool) -> OptimizeResult:
    """Return better parameters (9,) than `begin` (9,): the least-squares solution for a `whole` round, else one step.

    The whitening changes after each round, so near the solution more than one step per round is of no use. A step that
    does not reduce the errors is shortened.
    """
    for most in (_STEPS,) if whole else (2, _STEPS):  # evaluations, one of them at the start
        result = least_squares(
            lambda free: equations.residual(with_constant(free)),
            begin,
            lambda free: _without_constant(equations.jacobian(with_constant(free))),
            bounds=(
                [_QUICKEST_S, _QUICKEST_S, _EARLIEST_S, _EARLIEST_S, *[-np.inf] * 5],
                [_SLOWEST_S, _SLOWEST_S, _LATEST_S, _LATEST_S, *[np.inf] * 5],
            ),
            x_scale=scales,
            xtol=1e-5,
            ftol=1e-7,
            max_nfev=most,
        )
        if result.status != 0 or np.any(result.x != begin):
            break
    return result


def _start(tau_s: float, of_force_s: float, of_rates_s: float) -> Array:
    """Return parameters (10,) with this lag for rising and falling drives, these delays, and no thrust."""
    return np.concatenate([[tau_s, tau_s, of_force_s, of_rates_s], np.zeros(6)])


def _scales(p: Array) -> Array:
    """Return the scales of the parameters (10,)."""
    thrust = np.full(3, max(float(np.max(np.abs(p[THRUST]))), 1e-6))
    return np.concatenate([p[LAGS], [DELAY_S, DELAY_S], thrust, np.maximum(np.abs(p[TURNS]), 1e-3)])


def with_constant(free: npt.ArrayLike) -> Array:
    """Return parameters (10,) with a zero constant of thrust: the mean force alone gives it, after the others."""
    return np.insert(np.asarray(free, dtype=np.float64), THRUST.start, 0.0)


def _without_constant(columns: Array) -> Array:
    """Return parameters (10,), or slopes over them (n, 10), without the thrust's constant."""
    return np.delete(columns, THRUST.start, axis=-1)
