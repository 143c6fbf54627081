"""What a command does between two rows that are farther apart than its own steps: rows do not show it, rotors feel it.

Some speeds seem to rise that fall and the other way round, and each time constant comes out nearer to the other. The
mean of what a command at random does within a row has a variance of a twelfth of its mean squared change from row to
row; over the command's own variance that is about the share of the difference by which both move.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, note
from cfid.motors.delays import command_between_rows
from cfid.motors.lag.estimation import LagFit
from cfid.motors.lag.model import Signal
from cfid.motors.lag.part import SHOWN_S

Array = npt.NDArray[np.float64]

# Times the share: falling time constants of 80 ms were 1.2 times as much off at 100 Hz and 1.8 times at 50 Hz, rising
# ones of 50 ms less.
_TIMES = 1.5
_WITHIN_S = 1.0  # some time constants, over which a command varies


def mixed_share(command: Signal) -> float:
    """Return which share of their difference time constants lie nearer to each other for a command of rows (n,)."""
    time_s, value = command
    on = value > 0
    row_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    if row_s < SHOWN_S:
        return 0.0
    length = round(_WITHIN_S / row_s)
    driven = value[on][: np.count_nonzero(on) // length * length].reshape(-1, length)
    variance = float(np.mean(np.var(driven, axis=1))) if len(driven) else 0.0
    changes = np.diff(value)[on[1:] & on[:-1]]
    share = _TIMES * float(np.mean(changes**2)) / (12 * variance) if variance else 0.0
    return share / (1 - 2 * share)  # of the difference that is left


def unsure_between_rows(fit: LagFit, share: float) -> LagFit:
    """Return a fit whose lag's uncertainty contains that its time constants lie nearer to each other by a share."""
    apart_s = share * (fit.lag.falling_s - fit.lag.rising_s)
    effect = np.zeros((6, 1))
    effect[3:5, 0] = apart_s, -apart_s
    return replace(fit, covariance=fit.covariance + effect @ effect.T, effects=np.hstack([fit.effects, effect]))


def between_rows_finding(row_s: float, share: float) -> Finding:
    """Return a note on a command that rows show every `row_s`, and on what it does between them."""
    if not share:
        return note("lag-command-between-rows", command_between_rows(row_s), "dynamics.delay_s")
    text = (
        f"the command is known every {1e3 * row_s:.3g} ms, changes in most rows, and is taken as straight in between. "
        "Where it is held, the delay is too long by up to half of that: its standard uncertainty contains "
        f"{1e3 * row_s / 3**0.5:.2g} ms for what rows do not show. Time constants may lie nearer to each other by "
        f"{100 * share:.2g} % of their difference each, which their standard uncertainties contain."
    )
    return note("lag-command-between-rows", text, "dynamics.rising", "dynamics.falling", "dynamics.delay_s")
