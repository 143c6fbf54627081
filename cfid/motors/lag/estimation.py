"""Lag and static map together, by output error: the response to a command that always changes, simulated and compared.

The fit is least squares of residuals from which the correlation of their noise with the sample before is removed (D.
Cochrane, G. H. Orcutt, Application of least squares regression to relationships containing auto-correlated error terms,
Journal of the American Statistical Association 44, 1949). The remaining correlation decides the uncertainties.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag
from scipy.optimize import OptimizeResult

from cfid.errors import FitError
from cfid.estimate.linear import gain_of, std_of
from cfid.estimate.signals import block_means
from cfid.findings import Finding, texts
from cfid.motors.lag.checks import EXPLAINED, rejections
from cfid.motors.lag.delay_scatter import Scatter, scattered
from cfid.motors.lag.gaps import without_after_gaps
from cfid.motors.lag.model import InputLag, LogSegment
from cfid.motors.lag.plausibility import any_far, clipped, moves, noise_of, odd, standing, without
from cfid.motors.lag.search import Search, search_of, start_of
from cfid.motors.lag.uncertainty import beside, correlation_of, covariances, drifts_of, whitened

Array = npt.NDArray[np.float64]

_SMOOTH = 0.25  # time constants over which noise is averaged before judging how much the lag explains
# Times the variance that a fit with drift leaves: below, no drift is fitted. Free to drift, a record on a battery that
# sags would give a power of the voltage and time constants that its noise decides.
_STEADY = 1.01
_SAG = 0.02  # of a time constant: a sag of 0.3 V of 4.1 V makes it 1.7 % too short, one of 0.15 V 0.8 %
_DRIFTED = 2.0  # times the variance that a fit with drift leaves: above, one without is no second view
# Share of the interval between rows of a command that moves in most rows, since its course in between is not known. On
# chirps and ramps at 50 Hz, time constants were off by up to this much beyond noise.
_BETWEEN_ROWS = 0.03
_SINGULAR = 1e-7  # of a Jacobian with columns of equal length


@dataclass(frozen=True, kw_only=True, eq=False)
class LagFit:
    """A lag, and the map that it follows, c0 + c1 u + c2 u^2 of the drive u, with the covariance (6, 6) of map and lag.

    `effects` (6, m) is the part of the covariance that comes from what is expected of the voltage, with one standard
    uncertainty in each column. `power` is the power of the voltage with which speeds change, and its standard
    uncertainty; None where the record does not show it. `late_s` is the further uncertainty of the delay, since rows
    show commands and readings late. The rotors and the parts of one log have both in common. `explained` is the part of
    the variance that the lag and a slow drift explain, averaged over a quarter of a time constant; `rms` is the
    residual, and `drift` the relative change from start to end at the same drives. `measured` and `shown` (n,), which
    contains the drift, were compared at `time_s`. `standing_s` and `odd_s` are the times of speeds that were left out,
    the former because a sensor stood still, the latter because no command leads to them.
    """

    lag: InputLag
    covariance: Array
    map: tuple[float, float, float]
    explained: float
    rms: float
    drift: float
    time_s: Array
    measured: Array
    shown: Array
    findings: tuple[Finding, ...]
    late_s: float = 0.0
    effects: Array = field(default_factory=lambda: np.zeros((6, 0)))
    power: tuple[float, float] | None = None
    standing_s: Array = field(default_factory=lambda: np.zeros(0))
    odd_s: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def std_s(self) -> InputLag:
        """The standard uncertainties of the lag."""
        rising_s, falling_s, delay_s = std_of(self.covariance)[3:].tolist()
        return InputLag(rising_s, falling_s, math.hypot(delay_s, self.late_s))

    @property
    def map_std(self) -> Array:
        """The standard uncertainties (3,) of the map."""
        return std_of(self.covariance)[:3]

    @property
    def accepted(self) -> bool:
        """Whether the record shows a first-order lag."""
        return not texts(self.findings, "rejection")


def unsure_of_sag(fit: LagFit) -> LagFit:
    """Return a fit whose uncertainty allows for the sag under load of a battery whose voltage is unknown.

    A rotor on such a battery settles early: its speed falls with the voltage that it draws down. The error is the same
    for all rotors of a log.
    """
    effect = np.zeros((6, 1))
    effect[3:5, 0] = _SAG * fit.lag.rising_s, _SAG * fit.lag.falling_s
    return replace(fit, covariance=fit.covariance + effect @ effect.T, effects=np.hstack([fit.effects, effect]))


def fit_lag(pieces: Sequence[LogSegment], *, row_s: float = 0.0, moving: bool = False, age_s: float = 0.0) -> LagFit:
    """Fit time constants of rising and falling speed, the delay behind the command, and the static map, all at once.

    The measured values are the speed in rad/s of one rotor. `row_s` is the interval between two rows of the command,
    which changed at any time within it before a row shows the change: the delay is too short by up to that. `moving`
    states that the command changes in most rows, which do not show its steps. A row may show a measured value up to
    `age_s` late, which makes the delay too long. Of both, the mean, half of it, is corrected.

    The map holds in the middle of the record: its level and slope may drift, as with a battery that sags. Where the
    segments have a voltage, the drive is multiplied by a power of it, which the record shows where the voltage changes
    enough. Speeds that no rotor had are left out, as are those after gaps of rows in which the drive changed. Raises
    FitError for fewer than 200 samples, and for a speed that stands still.
    """
    pieces, standing_s = _moving(pieces)
    if len(standing_s):
        fit = fit_lag(pieces, row_s=row_s, moving=moving, age_s=age_s)
        return replace(fit, standing_s=standing_s)
    search = search_of(pieces)
    plain = search.fitted(search.start, np.asarray)
    good, odd_s = _without_odd(search, plain)
    if len(odd_s):
        fit = fit_lag(good, row_s=row_s, moving=moving, age_s=age_s)
        return replace(fit, odd_s=np.sort(np.concatenate([fit.odd_s, odd_s])))
    if any(len(piece.gaps_s) for piece in search.pieces):
        pieces = without_after_gaps(search.pieces, InputLag(*plain.x[3:6].tolist()))
        return fit_lag(pieces, row_s=row_s, moving=moving, age_s=age_s)
    fit = _lag_fit(search, plain, row_s=row_s, moving=moving)
    lag = fit.lag._replace(delay_s=fit.lag.delay_s + (row_s - age_s) / 2)
    return replace(fit, lag=lag, late_s=math.hypot(row_s, age_s) / math.sqrt(12))


def _without_odd(search: Search, plain: OptimizeResult) -> tuple[list[LogSegment], Array]:
    """Return the pieces without speeds that no rotor had by a `plain` fit, none if all fit, and those speeds' times."""
    missing = plain.fun[: len(search.measured)]
    missed = np.var(missing) > (1 - EXPLAINED) * np.var(search.measured)
    if not (missed or any_far(missing)):
        return [], np.zeros(0)
    begin = start_of(search.pieces, clipped(search.measured))
    spread = max(noise_of(search.shown(begin) - search.measured), 1e-9)
    sturdy = search.shown(search.fitted(begin, np.asarray, loss="cauchy", f_scale=spread).x)
    flags = odd(search.measured, sturdy, noise=noise_of(sturdy - search.measured))
    left = without([piece.measured for piece in search.pieces], flags)
    good = [piece._replace(measured=one) for piece, one in zip(search.pieces, left, strict=True)]
    return good, np.concatenate([piece.measured.time_s for piece in search.pieces])[flags]


def _lag_fit(search: Search, plain: OptimizeResult, *, row_s: float, moving: bool) -> LagFit:
    """Return the fit of errors freed from the correlation of their noise, which the errors of a `plain` fit show."""
    scatter = None
    if row_s and not moving and (found := scattered(search, plain.x, row_s=row_s)):
        search, scatter = found
        plain = search.fitted(search.start, np.asarray)
    measured, pieces = search.measured, search.pieces
    drifts = drifts_of(pieces, search.shown(plain.x))
    missing = plain.fun[: len(measured)]
    fit, other = _whitened(search, plain, drifts, scatter)
    off = search.shown(fit.x) - measured
    residual = beside(off, drifts)
    lag = InputLag(*fit.x[3:6].tolist())
    columns = fit.jac / np.maximum(np.linalg.norm(fit.jac, axis=0), 1e-300)
    singular = np.linalg.svd(columns, compute_uv=False)[-1] < _SINGULAR or bool(np.any(fit.active_mask[3:]))
    drifted = np.var(missing) > _DRIFTED * np.var(residual)
    covariance, effects = covariances(fit, other, search.expected, drifted=drifted, longest=len(measured) // 4)
    if scatter:
        covariance *= len(measured) / max(len(measured) - scatter.freedom, 1.0)
    covariance[[3, 4], [3, 4]] += (moving * _BETWEEN_ROWS * row_s) ** 2
    explained = _explained(pieces, residual, measured, min(lag.rising_s, lag.falling_s))
    return LagFit(
        lag=lag,
        covariance=np.full((6, 6), np.nan) if singular else covariance[:6, :6],
        effects=effects[:6],
        power=(float(fit.x[6]), float(std_of(covariance)[6])) if search.expected.fitted else None,
        map=(float(fit.x[0]), float(fit.x[1]), float(fit.x[2])),
        explained=explained,
        rms=float(np.sqrt(np.mean(residual**2))),
        drift=-float((gain_of(drifts) @ off)[0] * np.ptp(drifts[:, 0]) / np.mean(measured)),
        time_s=np.concatenate([piece.measured.time_s for piece in pieces]),
        measured=measured,
        shown=measured + residual,
        findings=rejections(
            lag,
            std_of(covariance)[3:6],
            explained,
            singular=singular,
            unseen_s=moving * row_s,
            moves=any(moves(piece.drive, piece.measured.time_s) for piece in pieces),
            levels=len(np.unique(np.concatenate([piece.drive.value for piece in pieces]))),
        ),
    )


def _whitened(
    search: Search, plain: OptimizeResult, drifts: Array, scatter: Scatter | None
) -> tuple[OptimizeResult, OptimizeResult]:
    """Return the fit with drifts (n, k), or without them where there are none, and the fit that it is compared with.

    A scatter of the times at which commands changed is fitted as well.
    """
    missing, lengths = plain.fun[: len(search.measured)], [len(piece.measured.value) for piece in search.pieces]
    left = beside(missing, drifts)
    correlation = correlation_of(left, lengths)
    white = partial(whitened, lengths=lengths, correlation=correlation)
    own = scatter and scatter.whitened(lengths, correlation)

    def rest(residual: Array) -> Array:
        return own.without(white(residual)) if own else white(residual)

    columns = [own.without(white(column), late=False) if own else white(column) for column in drifts.T]
    fit = search.fitted(plain.x, lambda residual: beside(rest(residual), np.column_stack(columns)))
    if search.expected.fitted and np.var(missing) < _STEADY * np.var(left):
        return search.fitted(plain.x, rest), fit
    return fit, plain


def joined(fits: Sequence[LagFit]) -> LagFit:
    """Return the mean of fits to parts of one record, weighted by their covariances, with the curves of the liveliest.

    Rejected parts are left out where others were accepted. The covariance is widened by as much as the parts differ.
    Errors that the parts have in common neither weigh them nor show in their differences, and no mean reduces them.
    """
    accepted = [fit for fit in fits if fit.accepted] or [max(fits, key=lambda fit: fit.explained)]
    if len(accepted) == 1:
        return accepted[0]
    covariance = block_diag(*(fit.covariance - fit.effects @ fit.effects.T for fit in accepted))
    values = np.array([[*fit.map, *fit.lag] for fit in accepted])
    gain = gain_of(np.tile(np.eye(6), (len(accepted), 1)), covariance=covariance)
    mean = gain @ values.ravel()
    effects = gain @ np.vstack([fit.effects for fit in accepted])
    apart = (values - mean).ravel()
    scatter = float(apart @ np.linalg.solve(covariance, apart)) / (len(apart) - 6)
    return replace(
        max(accepted, key=lambda fit: float(np.var(fit.shown))),
        lag=InputLag(*mean[3:].tolist()),
        map=(float(mean[0]), float(mean[1]), float(mean[2])),
        covariance=max(scatter, 1.0) * (gain @ covariance @ gain.T) + effects @ effects.T,
        effects=effects,
        power=min((fit.power for fit in accepted if fit.power), key=lambda power: power[1], default=None),
        explained=float(np.mean([fit.explained for fit in accepted])),
        rms=float(np.sqrt(np.mean([fit.rms**2 for fit in accepted]))),
        drift=max((fit.drift for fit in accepted), key=abs),
        late_s=max(fit.late_s for fit in accepted),
        standing_s=np.concatenate([fit.standing_s for fit in fits]),
        odd_s=np.concatenate([fit.odd_s for fit in fits]),
    )


def _moving(pieces: Sequence[LogSegment]) -> tuple[list[LogSegment], Array]:
    """Return pieces without the speeds of a sensor that stood still while its command moved, and these speeds' times.

    Raises FitError where most speeds are such.
    """
    found = [standing(piece.drive, piece.measured) for piece in pieces]
    each = [(piece, flags, np.isfinite(piece.measured.value)) for piece, flags in zip(pieces, found, strict=True)]
    still = np.concatenate([piece.measured.value[flags] for piece, flags, _ in each]) if each else np.zeros(0)
    if len(still) > sum(np.count_nonzero(known & ~flags) for _, flags, known in each):
        raise FitError(
            f"the speed stands still, at {still[0]:.0f} rad/s, while its command moves: {len(still)} readings do not "
            "change by the least. Is its sensor connected, and does the log refresh it?"
        )
    moving = [piece._replace(measured=without([piece.measured], flags)[0]) for piece, flags, _ in each]
    return moving, np.concatenate([piece.measured.time_s[flags] for piece, flags, _ in each] or [np.zeros(0)])


def _explained(pieces: Sequence[LogSegment], residual: Array, value: Array, tau_s: float) -> float:
    interval_s = float(np.median(np.diff(pieces[0].measured.time_s)))
    length = max(round(_SMOOTH * tau_s / interval_s), 1)
    noise, signal = (block_means(series, length=min(length, len(value) // 4)) for series in (residual, value))
    return float(1 - np.var(noise) / max(float(np.var(signal)), 1e-300))
