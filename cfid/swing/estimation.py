"""The default fit of a swing: damping terms chosen by the data, standard uncertainties, and checks.

It finds the natural frequency and the damping per inertia; `result` makes kg m^2 of them.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.linear import sandwich, std_of
from cfid.estimate.signals import GRID_S, correlation_inflation
from cfid.findings import Finding, note
from cfid.swing.checks import FitQuality, judge
from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import TERMS, Coefficients, OutputError, first_guess, fit_output_error

Array = npt.NDArray[np.float64]

PHASE_STEP = 0.08  # rad of the natural oscillation a grid step may span: phase error 1e-7
_SUBSETS = [subset for size in (1, 2) for subset in combinations(TERMS, size) if subset != ("viscous",)]
_HOPELESS_BIC = 100.0
_DAMPING = Coefficients._fields[1:4]
_FINER_STEPS = (0.5, 0.7)
_LED_BY_HAND = 0.15  # of the release angle
IDENTIFIABLE_BIC = 10.0  # [KR]: a difference below it is no strong evidence


@dataclass(frozen=True, kw_only=True)
class SwingFit:
    """A swing's natural frequency squared and damping, each damping term divided by the axis inertia.

    `std` has the fields of `coefficients`; `start_std` belongs to the start angle and speed. `split_bic` is
    the distance in BIC to the next best choice of damping terms.
    """

    output_error: OutputError
    terms: tuple[str, ...]
    coefficients: Coefficients
    std: Coefficients
    start_std: tuple[float, float]
    residual_rms_rad: float
    split_bic: float
    quality: FitQuality
    findings: tuple[Finding, ...]

    @property
    def accepted(self) -> bool:
        """Whether the model describes the data."""
        return not self.quality.findings


def fit_swing(swing: FreeSwing) -> SwingFit:
    """Fit the damped pendulum to a free swing, with the damping terms that the data supports.

    The subset of viscous, Coulomb and quadratic damping (all >= 0) with the least BIC is taken, samples
    counted by their effective number. W hardly depends on the choice.

    Raises FitError when no model converges.
    """
    time, angle = swing.hands_off
    step = grid_step(swing)
    coefficients, trajectory = first_guess(time, angle, start_s=swing.release_s, step_s=step)
    base = fit_output_error(time, angle, coefficients=coefficients, trajectory=trajectory, terms=("viscous",))
    full = _refit(base, time, angle, TERMS)
    promising = [terms for terms in _SUBSETS if not _hopeless(full, terms)]
    candidates = [base, full, *(_refit(base, time, angle, terms) for terms in promising)]
    physical = [fit for fit in candidates if _acceptable(fit)]
    if not physical:
        # Damping too weak to be distinguished from none comes out negative half of the time.
        physical = [fit for fit in [_refit(base, time, angle, ())] if _acceptable(fit)]
    if not physical:
        raise FitError("no damped pendulum follows this record: is it a free swing? Look at it with `cfid show`.")
    return _judged(swing, _ranked(physical))


def grid_step(swing: FreeSwing) -> float:
    """Return the collocation step: the thesis' 4 ms, finer for fast pendulums."""
    return min(GRID_S, PHASE_STEP * swing.period_s / (2 * math.pi))


def _refit(fit: OutputError, time: Array, angle: Array, terms: tuple[str, ...]) -> OutputError:
    dropped = {field: 0.0 for field, term in zip(_DAMPING, TERMS, strict=True) if term not in terms}
    start = fit.coefficients._replace(**dropped)
    return fit_output_error(time, angle, coefficients=start, trajectory=fit.trajectory, terms=terms)


def _hopeless(full: OutputError, terms: tuple[str, ...]) -> bool:
    """Return whether dropping all but `terms` from the full model would cost far too much, seen linearly.

    It saves the fits that take longest: those of models that cannot follow the record.
    """
    if not _acceptable(full):
        return False
    dropped = [1 + i for i, term in enumerate(TERMS) if term not in terms]
    inverse = np.linalg.pinv(full.jacobian.T @ full.jacobian, hermitian=True, rcond=1e-14)
    values = np.array(full.coefficients)[dropped]
    rise = float(values @ np.linalg.solve(inverse[np.ix_(dropped, dropped)], values))
    effective = len(full.residual_rad) / _inflation(full.residual_rad, full)
    return effective * math.log1p(rise / full.sum_of_squares_rad2) > _HOPELESS_BIC


def _acceptable(fit: OutputError) -> bool:
    frequency, *damping, _ = fit.coefficients
    return fit.converged and frequency > 0 and min(damping) >= 0


def _ranked(fits: list[OutputError]) -> list[tuple[float, OutputError]]:
    """Sort by BIC. The effective number of samples is that of the best-fitting model's residual."""
    closest = min(fits, key=lambda fit: fit.sum_of_squares_rad2)
    count = len(closest.residual_rad)
    effective = max(count / _inflation(closest.residual_rad, closest), len(TERMS) + 5)
    scored = [
        (effective * math.log(fit.sum_of_squares_rad2 / count) + sum(fit.free) * math.log(effective), i)
        for i, fit in enumerate(fits)
    ]
    return [(score, fits[i]) for score, i in sorted(scored)]


def _samples_a_period(fit: OutputError) -> int:
    period = 2 * math.pi / math.sqrt(fit.coefficients.natural_frequency_squared_s2)
    span = (len(fit.trajectory.angle_rad) - 1) * fit.trajectory.step_s
    return max(int(len(fit.residual_rad) * period / span), 8)


def _inflation(series: Array, fit: OutputError) -> float:
    return correlation_inflation(series, longest=_samples_a_period(fit))


def _standard_uncertainties(fit: OutputError) -> Array:
    """Return the standard uncertainty of each Jacobian column's estimate, inflated by each estimate's correlation."""
    return std_of(sandwich(fit.jacobian, fit.residual_rad, longest=_samples_a_period(fit)))


def _spread_of_choices(ranked: list[tuple[float, OutputError]]) -> float:
    """Return how far W scatters over the choices of damping, each as likely as its BIC says [HMRV]."""
    likely = np.exp(-0.5 * np.array([score - ranked[0][0] for score, _ in ranked]))
    frequencies = np.array([fit.coefficients.natural_frequency_squared_s2 for _, fit in ranked])
    return float(np.sqrt(likely @ (frequencies - frequencies[0]) ** 2 / likely.sum()))


def _step_error(swing: FreeSwing, fit: OutputError) -> float:
    """Return by how much the grid's step moves W where dry friction jumps: twice the change on two finer grids.

    How a turning point falls between two nodes is a matter of luck, hence two. Without dry friction the grid's
    error is of fourth order and far below anything else.
    """
    if fit.coefficients.coulomb_per_s2 == 0:
        return 0.0
    time, angle = swing.hands_off
    changes = [0.0]
    for share in _FINER_STEPS:
        step = share * fit.trajectory.step_s
        _, trajectory = first_guess(time, angle, start_s=fit.trajectory.start_s, step_s=step)
        finer = fit_output_error(time, angle, coefficients=fit.coefficients, trajectory=trajectory, terms=_terms(fit))
        if finer.converged:
            changes.append(abs(finer.coefficients[0] - fit.coefficients[0]))
    return 2 * max(changes)


def _terms(fit: OutputError) -> tuple[str, ...]:
    return tuple(term for term, free in zip(TERMS, fit.free[1:4], strict=True) if free)


def _judged(swing: FreeSwing, ranked: list[tuple[float, OutputError]]) -> SwingFit:
    fit = ranked[0][1]
    split_bic = ranked[1][0] - ranked[0][0] if len(ranked) > 1 else math.inf
    std = _standard_uncertainties(fit)
    std[0] = math.hypot(std[0], _spread_of_choices(ranked), _step_error(swing, fit))
    per_coefficient = np.zeros(len(fit.free))
    per_coefficient[np.flatnonzero(fit.free)] = std[:-2]
    drift, drift_std = _drift(swing, fit)
    frequency, frequency_std = fit.coefficients.natural_frequency_squared_s2, per_coefficient[0]
    if abs(drift) > 3 * drift_std:
        # The halves disagree by more than noise: the truth lies between them as likely as anywhere else.
        per_coefficient[0] = math.hypot(frequency_std, frequency * abs(drift) / math.sqrt(12))
    terms = _terms(fit)
    quality = judge(fit, swing.hands_off[0], resolution_rad=swing.resolution_rad, drift=drift, drift_std=drift_std)
    return SwingFit(
        output_error=fit,
        terms=terms,
        coefficients=fit.coefficients,
        std=Coefficients(*map(float, per_coefficient)),
        start_std=(float(std[-2]), float(std[-1])),
        residual_rms_rad=float(np.sqrt(np.mean(fit.residual_rad**2))),
        split_bic=split_bic,
        quality=quality,
        findings=(*swing.findings, *quality.findings, *_split_finding(terms, split_bic), *_hand_finding(swing, fit)),
    )


def _drift(swing: FreeSwing, fit: OutputError) -> tuple[float, float]:
    """Fit both halves of the window with the damping held, and compare their W."""
    time, angle = swing.hands_off
    halves = np.searchsorted(time, (time[0] + time[-1]) / 2)
    values, variances = [], []
    for part in (slice(None, halves), slice(halves, None)):
        start, step = float(time[part][0]), fit.trajectory.step_s
        _, trajectory = first_guess(time[part], angle[part], start_s=start, step_s=step)
        half = fit_output_error(time[part], angle[part], coefficients=fit.coefficients, trajectory=trajectory, terms=())
        values.append(half.coefficients.natural_frequency_squared_s2)
        variances.append(_standard_uncertainties(half)[0] ** 2)
    frequency = fit.coefficients.natural_frequency_squared_s2
    return float((values[1] - values[0]) / frequency), float(math.sqrt(sum(variances)) / frequency)


def _split_finding(terms: tuple[str, ...], split_bic: float) -> tuple[Finding, ...]:
    if split_bic >= IDENTIFIABLE_BIC:
        return ()
    chosen = ", ".join(terms) or "none"
    text = (
        f"the damping terms ({chosen}) are not identifiable: another choice is as likely "
        f"(BIC {split_bic:.1f} apart). The inertia does not depend on it."
    )
    damping = ("swing.viscous_nms_per_rad", "swing.coulomb_nm", "swing.quadratic_nms2_per_rad2")
    return (note("swing-damping-split-unresolved", text, *damping),)


def _hand_finding(swing: FreeSwing, fit: OutputError) -> tuple[Finding, ...]:
    """Report when the motion just after the release was not the pendulum's own."""
    measured = float(swing.angle_rad[swing.release])
    missed = abs(fit.start_angle_rad - measured)
    if swing.hand_gone == swing.release or missed < _LED_BY_HAND * abs(measured):
        return ()
    text = (
        f"between {swing.release_s:.2f} and {swing.time_s[swing.hand_gone]:.2f} s the body did not fall freely "
        f"(the pendulum would have started from {math.degrees(fit.start_angle_rad):.0f} degrees, "
        f"it stood at {math.degrees(measured):.0f}): this segment is left out. Release without a push."
    )
    return (note("swing-led-by-hand", text, "swing.start_angle_rad", "swing.start_speed_rad_per_s"),)
