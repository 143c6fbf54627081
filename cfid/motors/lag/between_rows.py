"""What a command does between rows that are farther apart than its own steps: rotors follow it, but no row shows it.

The command is taken as straight from row to row, which is what a random command does on average: the rest correlates
with no row, and errors of that kind do not bias a linear fit (J. Berkson, Are there two regressions?, Journal of the
American Statistical Association 45, 1950). Noise of a command that lasts for one step of its controller is in its rows
but not in the mean from row to row; such errors make time constants too long. A fit to commands with as much noise
added again shows by how much (J. R. Cook, L. A. Stefanski, Simulation-extrapolation estimation in parametric
measurement error models, Journal of the American Statistical Association 89, 1994).

Some falling speeds are taken for rising ones and the other way round, so each time constant comes out nearer to the
other. What a random command does within a row has a mean whose variance is a twelfth of the command's mean squared
change from row to row. Relative to the command's own variance, that is about the share of their difference by which
both time constants move.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, note
from cfid.motors.delays import command_between_rows
from cfid.motors.lag.estimation import LagFit, fit_lag
from cfid.motors.lag.model import LogSegment, Signal
from cfid.motors.lag.part import moves

Array = npt.NDArray[np.float64]

_SHOWN_S = 3e-3  # rows that far apart show each step of a controller at 500 Hz
_SEED = 1
# Share of the interval between rows by which time constants of rotors were too long under a flight's commands, in rows
# of 5 to 20 ms.
_LONG = 0.1
# Factor on the share: falling time constants of 80 ms were off by 1.2 times as much at 100 Hz and by 1.8 times at
# 50 Hz, rising ones of 50 ms by less.
_TIMES = 1.5
_MOST = 0.4  # at a half, nothing is left of the difference
_WITHIN_S = 1.0  # some time constants: how long a command is looked at for its variance


def fit_rows(pieces: Sequence[LogSegment], *, row_s: float, moving: bool, age_s: float = 0.0) -> LagFit:
    """Return the fit of commands that rows show, allowing for what they do between rows.

    The uncertainty contains the effect of command noise that lasts for one step of the controller. Parameters and
    errors are those of `fit_lag`.
    """
    if not moving or row_s < _SHOWN_S:
        return fit_lag(pieces, row_s=row_s, moving=moving, age_s=age_s)
    rng = np.random.default_rng(_SEED)
    as_known, noisier = (
        [piece._replace(drive=_straight(piece.drive, each)) for piece in pieces] for each in (None, rng)
    )
    fit = fit_lag(as_known, row_s=row_s, moving=moving, age_s=age_s)
    other = fit_lag(noisier, row_s=row_s, moving=moving)
    effects = np.zeros((6, 2))
    effects[3:5, 0] = other.lag.rising_s - fit.lag.rising_s, other.lag.falling_s - fit.lag.falling_s
    effects[3:5, 1] = _LONG * row_s
    lag = fit.lag._replace(delay_s=fit.lag.delay_s - row_s / 2)  # a straight command changes in the middle, on average
    return _unsure(replace(fit, lag=lag), effects)


def _straight(drive: Signal, rng: np.random.Generator | None) -> Signal:
    if not moves(drive.value):
        return drive
    noise = 0.0 if rng is None else rng.normal(0, _noise_of(drive.value), len(drive.value))
    return Signal(drive.time_s, drive.value + noise).straight()


def _noise_of(command: Array) -> float:
    """Return the standard deviation of what lasts for less than a row, from the changes over one and over two rows."""
    one, two = (float(np.mean((command[by:] - command[:-by]) ** 2)) / 2 for by in (1, 2))
    return math.sqrt(max(2 * one - two, 0.0))


def _unsure(fit: LagFit, effects: Array) -> LagFit:
    return replace(fit, covariance=fit.covariance + effects @ effects.T, effects=np.hstack([fit.effects, effects]))


def mixed_share(command: Signal) -> float:
    """Return the share of their difference by which time constants approach each other, for a command in rows (n,)."""
    time_s, value = command
    on = value > 0
    row_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    if row_s < _SHOWN_S:
        return 0.0
    length = round(_WITHIN_S / row_s)
    driven = value[on][: np.count_nonzero(on) // length * length].reshape(-1, length)
    variance = float(np.mean(np.var(driven, axis=1))) if len(driven) else 0.0
    changes = np.diff(value)[on[1:] & on[:-1]]
    share = min(_TIMES * float(np.mean(changes**2)) / (12 * variance), _MOST) if variance else 0.0
    return share / (1 - 2 * share)  # of the difference that is left


def unsure_between_rows(fit: LagFit, share: float) -> LagFit:
    """Return a fit whose uncertainty allows for time constants that are too near to each other by a share."""
    apart_s = share * (fit.lag.falling_s - fit.lag.rising_s)
    effect = np.zeros((6, 1))
    effect[3:5, 0] = apart_s, -apart_s
    return _unsure(fit, effect)


def between_rows_finding(row_s: float, share: float) -> Finding:
    """Return a note on a command that rows show every `row_s`, and on what it does in between."""
    if not share:
        return note("lag-command-between-rows", command_between_rows(row_s), "dynamics.delay_s")
    text = (
        f"the command is known every {1e3 * row_s:.3g} ms, changes in most rows, and is taken as straight in between. "
        "Where it is held, the delay is too long by up to half of that: its standard uncertainty contains "
        f"{1e3 * row_s / 12**0.5:.2g} ms for what rows do not show. Noise in the commands may make time constants too "
        f"long, and what rows do not show may bring them nearer to each other by about {100 * share:.2g} % of their "
        "difference: their standard uncertainties contain both. Log at the rate of the controller."
    )
    return note("lag-command-between-rows", text, "dynamics.rising", "dynamics.falling", "dynamics.delay_s")
