"""Fit a swing by the default method: damping terms chosen by the data, standard uncertainties, and checks.

It finds the natural frequency and the damping per inertia; `result` converts them to kg m^2.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.signals import GRID_S
from cfid.findings import Finding, joined, texts
from cfid.swing.checks import (
    FitQuality,
    eccentricity_finding,
    eccentricity_or_noise_finding,
    gyro_scale_finding,
    hand_finding,
    judge,
    split_finding,
    spring_finding,
    spring_or_friction_finding,
    uncertain_finding,
    unfinished_finding,
    varying_finding,
)
from cfid.swing.choice import Choice, chosen, ranked_by_bic, spread_of_choices
from cfid.swing.collocation import Coefficients
from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import (
    ECCENTRICITY,
    TERMS,
    OutputError,
    first_guess,
    fit_output_error,
)
from cfid.swing.uncertainty import (
    chosen_terms,
    drift_of_halves,
    friction_probes,
    inflation,
    moved_by_scale,
    moved_by_spring,
    scale_error,
    scatter_of_windows,
    shows_despite_friction,
    spring_beside,
    standard_uncertainties,
    step_error,
)

Array = npt.NDArray[np.float64]

PHASE_STEP = 0.08  # rad of the natural oscillation, the longest grid step: phase error 1e-7
_SUBSETS = [subset for size in (1, 2) for subset in combinations(TERMS, size) if subset != ("viscous",)]
_HOPELESS_BIC = 100.0
_DAMPING = Coefficients._fields[1:4]
_ECCENTRIC_RAD = 0.05  # more cannot be the eccentricity of a disc
_TRIED_ECCENTRIC = 2  # the number of best choices of damping that are tried with eccentricity
_SHOWN_STD = 3.0  # of a spring: with less, it does not contribute to the uncertainty of W
# Spring over gravity: friction resembles smaller springs; a larger one means that the model is wrong.
_LIKE_FRICTION = 0.1
_STIFFEST = 1.0  # spring over gravity: an angle in a wrong unit looks like a stiffer one
_LEAST_ROWS = 16
_CLEARLY_BETTER = 0.95  # ratio of the sums of squares
_VARIES_STD = 4.0  # of a probe of dry friction: swings on working rigs stay below
_VARIES_USUALLY = 0.25  # of the Coulomb friction, over the angle: assumed for a bearing that was not measured


@dataclass(frozen=True, kw_only=True)
class SwingFit:
    """A swing's natural frequency squared and damping, each damping term divided by the axis inertia.

    `std` has the fields of `coefficients`; `start_std` belongs to the start angle and speed. `split_bic` is the
    distance in BIC to the next best choice of terms, and `budget_s2` has the parts of W's standard uncertainty. W is
    that of `output_error`, corrected for the effect of dry friction that varies over the angle. A gyro's rates are
    taken as too large by `gyro_scale_error`; `predicted_rad` (n,) are the readings without residual.
    """

    output_error: OutputError
    terms: tuple[str, ...]
    coefficients: Coefficients
    std: Coefficients
    start_std: tuple[float, float]
    residual_rms_rad: float
    split_bic: float
    gyro_scale_error: float
    gyro_scale_std: float
    budget_s2: Mapping[str, float]
    predicted_rad: Array
    quality: FitQuality
    findings: tuple[Finding, ...]

    @property
    def accepted(self) -> bool:
        """Whether the model describes the data."""
        return not texts(self.findings, "rejection")


def fit_swing(swing: FreeSwing) -> SwingFit:
    """Fit the damped pendulum to a free swing, with the damping terms that the data supports.

    The subset of viscous, Coulomb and quadratic damping (all >= 0) with the least BIC is used, with samples counted by
    their effective number. W hardly depends on the choice.

    Raises FitError when no model converges, or too few rows of free swing remain.
    """
    time, angle = swing.hands_off
    if len(time) < _LEAST_ROWS:
        raise FitError(f"after the release {len(time)} rows of free swing are left: look at it with `cfid show`.")
    step = grid_step(swing)
    coefficients, trajectory = first_guess(time, angle, start_s=swing.release_s, step_s=step)
    if swing.rate_rad_per_s is not None:
        trajectory = trajectory._replace(angle_rad=trajectory.angle_rad - coefficients.zero_rad)
        coefficients = coefficients._replace(zero_rad=0.0)
    base = fit_output_error(
        time, swing.readings_rad, coefficients=coefficients, trajectory=trajectory, terms=("viscous",),
        setup=swing.setup,
    )  # fmt: skip
    full = _refit(base, time, swing.readings_rad, TERMS)
    usual_std = swing.rate_scale_std
    swing, scale, base, full = _scaled(swing, base, full)
    reading = swing.readings_rad
    promising = [terms for terms in _SUBSETS if not _hopeless(full, terms)]
    candidates = [base, full, *(_refit(base, time, reading, terms) for terms in promising)]
    physical = [fit for fit in candidates if _acceptable(fit)]
    if not physical:
        # Damping that is indistinguishable from zero comes out negative half of the time.
        physical = [fit for fit in [_refit(base, time, reading, ())] if _acceptable(fit)]
    if not physical:
        text = "no damped pendulum follows this record: is it a free swing? Look at it with `cfid show`."
        raise FitError(joined([text, *texts(swing.findings, "warning")]))
    likeliest = [fit for _, fit in ranked_by_bic(physical)[:_TRIED_ECCENTRIC]]
    if swing.rate_rad_per_s is None:
        eccentric = [_refit(fit, time, reading, (*chosen_terms(fit), ECCENTRICITY)) for fit in likeliest]
        sound = [fit for fit in eccentric if _acceptable(fit)]
        physical += sound
        if any(_sprung(swing, fit, rounds=1) for fit in (*likeliest, *sound)):
            physical += [one for fit in physical for one in _sprung(swing, fit)]
    choice = chosen(swing, physical)
    return _judged(swing, choice, _unfinished(choice.ranked[0][1], candidates), scale, usual_std)


def _scaled(
    swing: FreeSwing, base: OutputError, full: OutputError
) -> tuple[FreeSwing, float, OutputError, OutputError]:
    """Remove the scale error from a gyro's rates, refined once; return the swing, the error, and both fits repeated."""
    corrected, error = swing, 0.0
    if swing.rate_rad_per_s is None:
        return swing, error, base, full
    for _ in range(2):
        usual = replace(corrected, rate_scale_std=swing.rate_scale_std)
        error, std = scale_error(usual, full if full.converged else base, error)
        corrected = replace(swing, rate_rad_per_s=swing.rate_rad_per_s / (1 + error), rate_scale_std=std)
        base, full = (
            _refit(fit, swing.hands_off[0], corrected.readings_rad, chosen_terms(fit)) for fit in (base, full)
        )
    return corrected, error, base, full


def _sprung(swing: FreeSwing, fit: OutputError, rounds: int = 3) -> list[OutputError]:
    """Return a fit with the spring that the record shows in addition to it, refined in rounds; none without one."""
    for _ in range(rounds):
        size, std, moved = spring_beside(swing, fit)
        setup = fit.setup._replace(spring_per_s2=fit.setup.spring_per_s2 + size)
        frequency = fit.coefficients.natural_frequency_squared_s2 + moved
        if not _SHOWN_STD * std <= setup.spring_per_s2 < _STIFFEST * frequency:
            return []
        start = replace(
            fit, setup=setup, coefficients=fit.coefficients._replace(natural_frequency_squared_s2=frequency)
        )
        fit = _refit(start, swing.hands_off[0], swing.readings_rad, chosen_terms(fit))
        if not _acceptable(fit):
            return []
    return [fit] if shows_despite_friction(swing, fit, least_std=_SHOWN_STD) else []


def grid_step(swing: FreeSwing) -> float:
    """Return the collocation step: 4 ms as in the thesis, shorter for fast pendulums."""
    return min(GRID_S, PHASE_STEP * swing.period_s / (2 * math.pi))


def _refit(fit: OutputError, time: Array, reading: Array, terms: tuple[str, ...]) -> OutputError:
    """Fit with other terms, starting from a fit's result; continue once if it does not converge."""
    dropped = {field: 0.0 for field, term in zip(_DAMPING, TERMS, strict=True) if term not in terms}
    start = fit.coefficients._replace(**dropped)
    found = fit_output_error(time, reading, coefficients=start, trajectory=fit.trajectory, terms=terms, setup=fit.setup)
    if found.converged or not np.all(np.isfinite(found.residual_rad)):
        return found
    return fit_output_error(
        time, reading, coefficients=found.coefficients, trajectory=found.trajectory, terms=terms,
        eccentricity=found.eccentricity, setup=fit.setup,
    )  # fmt: skip


def _hopeless(full: OutputError, terms: tuple[str, ...]) -> bool:
    """Return whether dropping all but `terms` from the full model would raise BIC far too much, by linearisation.

    This skips the fits that take longest: those of models that cannot follow the record.
    """
    if not _acceptable(full):
        return False
    dropped = [1 + i for i, term in enumerate(TERMS) if term not in terms]
    inverse = np.linalg.pinv(full.jacobian.T @ full.jacobian, hermitian=True, rcond=1e-14)
    values = np.array(full.coefficients)[dropped]
    rise = float(values @ np.linalg.solve(inverse[np.ix_(dropped, dropped)], values))
    effective = len(full.residual_rad) / inflation(full.residual_rad, full)
    return effective * math.log1p(rise / full.sum_of_squares_rad2) > _HOPELESS_BIC


def _acceptable(fit: OutputError) -> bool:
    return fit.converged and _physical(fit)


def _physical(fit: OutputError) -> bool:
    frequency, *damping, _ = fit.coefficients
    centred = math.hypot(*fit.eccentricity) < _ECCENTRIC_RAD
    return centred and frequency > 0 and min(damping) >= 0 and fit.setup.spring_per_s2 < _STIFFEST * frequency


def _unfinished(best: OutputError, candidates: list[OutputError]) -> OutputError | None:
    """Return the best model that did not converge but describes the record better than `best`, if there is one."""
    open_ones = [fit for fit in candidates if not fit.converged and np.all(np.isfinite(fit.residual_rad))]
    better = [
        fit
        for fit in open_ones
        if _physical(fit) and fit.sum_of_squares_rad2 < _CLEARLY_BETTER * best.sum_of_squares_rad2
    ]
    return min(better, key=lambda fit: fit.sum_of_squares_rad2, default=None)


def _judged(
    swing: FreeSwing,
    choice: Choice,
    unfinished: OutputError | None,
    scale: float,
    usual_std: float,
) -> SwingFit:
    ranked, with_spring, with_eccentricity = choice
    fit = ranked[0][1]
    split_bic = ranked[1][0] - ranked[0][0] if len(ranked) > 1 else math.inf
    noise = standard_uncertainties(fit)
    gyro, spring = moved_by_scale(swing, fit), moved_by_spring(swing, fit)
    std = np.sqrt(noise**2 + gyro**2 + spring**2)
    frequency = fit.coefficients.natural_frequency_squared_s2
    drift, drift_std = drift_of_halves(swing, fit)
    instrument = "encoder" if swing.rate_rad_per_s is None else "vehicle"
    shares = {
        "noise": float(noise[0]),
        "scale of the gyro": float(gyro[0]),
        "spring": float(spring[0]),
        "choice of terms": spread_of_choices(ranked),
        "grid": step_error(swing, fit),
        f"clock of the {instrument}": 2 * frequency * swing.time_scale_std,
        # Where the halves differ by more than noise, the true value is equally likely anywhere between them.
        "drift": frequency * abs(drift) / math.sqrt(12) if abs(drift) > 3 * drift_std else 0.0,
        "scatter between windows": scatter_of_windows(swing, fit),
    }
    *at_low_speed, over_angle = friction_probes(swing, fit)
    clearest = max((*at_low_speed, over_angle), key=lambda probe: probe.shown_std)
    varying = clearest if clearest.shown_std > _VARIES_STD else None
    if varying is not None and varying is not over_angle:
        shares["friction at low speed"] = abs(varying.moved_s2)
    moved, shares["friction over the angle"] = over_angle.expected(_VARIES_USUALLY * fit.coefficients.coulomb_per_s2)
    left_spring, left_std, left_moves = spring_beside(swing, fit) if swing.rate_rad_per_s is None else (0.0, 0.0, 0.0)
    open_spring = left_spring
    if with_spring is not None:
        open_spring = with_spring.setup.spring_per_s2
        shares["spring or friction"] = abs(with_spring.coefficients.natural_frequency_squared_s2 - frequency)
    elif _SHOWN_STD * left_std < left_spring < _LIKE_FRICTION * frequency:
        shares["spring or friction"] = abs(left_moves)
    may_be_off_deg = None
    if with_eccentricity is not None:
        may_be_off_deg = math.degrees(math.hypot(*with_eccentricity.eccentricity))
        moves = with_eccentricity.coefficients.natural_frequency_squared_s2 - frequency
        shares["eccentricity or noise"] = abs(moves)
    if unfinished is not None:
        shares["model that did not converge"] = abs(unfinished.coefficients.natural_frequency_squared_s2 - frequency)
    std[0] = math.hypot(*shares.values())
    per_coefficient = np.zeros(len(fit.free))
    per_coefficient[np.flatnonzero(fit.free)] = std[: sum(fit.free)]
    terms = chosen_terms(fit)
    quality = judge(fit, swing.hands_off[0], resolution_rad=swing.resolution_rad, drift=drift, drift_std=drift_std)
    return SwingFit(
        output_error=fit,
        terms=terms,
        coefficients=fit.coefficients._replace(natural_frequency_squared_s2=frequency + moved),
        std=Coefficients(*map(float, per_coefficient)),
        start_std=(float(std[-2]), float(std[-1])),
        residual_rms_rad=float(np.sqrt(np.mean(fit.residual_rad**2))),
        split_bic=split_bic,
        gyro_scale_error=scale,
        gyro_scale_std=swing.rate_scale_std,
        budget_s2={name: share for name, share in shares.items() if share > 0},
        predicted_rad=swing.readings_rad - fit.residual_rad,
        quality=quality,
        findings=(
            *swing.findings,
            *quality.findings,
            *uncertain_finding(fit, float(std[0])),
            *split_finding(terms, split_bic),
            *hand_finding(swing, fit),
            *eccentricity_finding(fit),
            *eccentricity_or_noise_finding(may_be_off_deg, shares.get("eccentricity or noise", 0.0) / frequency),
            *spring_finding(fit, shares["spring"], _SHOWN_STD * left_std),
            *spring_or_friction_finding(open_spring / frequency, shares.get("spring or friction", 0.0) / frequency),
            *unfinished_finding(unfinished, shares),
            *varying_finding(varying),
            *gyro_scale_finding(scale, usual_std),
        ),
    )
