"""Fit a swing by the default method: one model with every nuisance, standard uncertainties, and checks.

It finds the natural frequency and the damping per inertia; `result` converts them to kg m^2.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.signals import GRID_S
from cfid.findings import Finding, explained, texts
from cfid.swing.checks import FitQuality, findings_of, hand_finding, judge
from cfid.swing.collocation import Coefficients
from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import OutputError, Trajectory, first_guess, fit_output_error, on_another_grid
from cfid.swing.uncertainty import (
    FIRST,
    SECOND,
    SPRING,
    Posterior,
    Priors,
    drift_of_halves,
    noise_variance,
    posterior,
    scatter_of_windows,
)

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

PHASE_STEP = 0.08  # rad of the natural oscillation, the longest grid step: phase error 1e-7
_LEAST_ROWS = 16
_FINER_STEPS = (0.5, 0.7)
_WIDER = 4.0  # than its priors, for the fit that a gyro's posterior starts from: its scale may be worse than usual
_ROUNDS = 2  # each with the noise of the last; the first noise contains what the nuisances explain
_SURE_STD = 4.0  # beyond, a spring that pushes is no chance
_FREQUENCY, _FRICTION, _ZERO, _SHAPES = 0, [1, 2, 3], 4, [6, 7, 8]  # places among a fit's values


@dataclass(frozen=True, kw_only=True)
class SwingFit:
    """A swing's natural frequency squared and damping, each damping term divided by the axis inertia.

    `std` has the fields of `coefficients`; `start_std` belongs to the start angle and speed. `budget_s2` has the parts
    of W's standard uncertainty. `instrument` has the error of the readings as in `OutputError`, with standard
    uncertainties `instrument_std`; `predicted_rad` (n,) are the readings without residual. `push_s2` is the stiffness
    of a spring that pushes, which no cable does, where the record shows one, else 0.
    """

    output_error: OutputError
    coefficients: Coefficients
    std: Coefficients
    instrument: tuple[float, ...]
    instrument_std: tuple[float, ...]
    start_std: tuple[float, ...]
    residual_rms_rad: float
    budget_s2: Mapping[str, float]
    predicted_rad: Array
    quality: FitQuality
    push_s2: float = 0.0
    findings: tuple[Finding, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether the model describes the data."""
        return not texts(self.findings, "rejection")


def fit_swing(swing: FreeSwing) -> SwingFit:
    """Fit the damped pendulum with all its nuisances to a free swing.

    Viscous and Coulomb damping are >= 0. A cable, an eccentric disc, a gyro's scale and dry friction that
    varies are fitted with them, against their priors.

    Raises FitError when the fit does not converge, or too few rows of free swing remain.
    """
    time, angle = swing.hands_off
    if len(time) < _LEAST_ROWS:
        raise FitError(f"after the release {len(time)} rows of free swing are left: look at it with `cfid show`.")
    guess, trajectory = first_guess(time, angle, start_s=swing.release_s, step_s=grid_step(swing))
    needed, wider = [_FREQUENCY, _ZERO], 1.0
    nuisances = [*_SHAPES, SPRING, FIRST, SECOND]
    if swing.rate_rad_per_s is not None:
        trajectory = trajectory._replace(angle_rad=trajectory.angle_rad - guess.zero_rad)
        guess = guess._replace(zero_rad=0.0)
        needed, nuisances, wider = [_FREQUENCY, SECOND], [*_SHAPES, FIRST], _WIDER
    values = np.array([*guess, 0.0, 0.0])
    try:
        fit = _damped(swing, values, trajectory, _mask([*needed, *_FRICTION]))
        priors = Priors.usual(swing, fit)
        for _ in range(_ROUNDS):
            pull = noise_variance(fit) / (wider * priors.worst_std) ** 2
            fit = _damped(swing, fit.values, fit.trajectory, fit.free | _mask(nuisances), pull)
        return _judged(swing, fit, posterior(fit, priors), _step_error(swing, fit, pull))
    except FitError:  # what a viscous pendulum misses shows why no pendulum follows
        fit = _damped(swing, values, trajectory, _mask([*needed, *_FRICTION[:1]]))
        judged = _judged(swing, fit, posterior(fit, Priors.usual(swing, fit)), 0.0)
        if judged.accepted:
            raise
        return judged


def grid_step(swing: FreeSwing) -> float:
    """Return the collocation step: 4 ms as in the thesis, shorter for fast pendulums."""
    return min(GRID_S, PHASE_STEP * swing.period_s / (2 * math.pi))


def _mask(places: list[int]) -> Mask:
    mask = np.zeros(len(Coefficients._fields) + 2, dtype=bool)
    mask[places] = True
    return mask


@np.errstate(over="ignore", invalid="ignore")  # of a diverged fit, which is refused
def _damped(
    swing: FreeSwing, values: Array, trajectory: Trajectory, free: Mask, pull: Array | float = 0.0
) -> OutputError:
    """Fit the free values, without viscous or Coulomb damping that comes out negative, one after the other.

    The quadratic term may be negative: it is how the friction of a bearing bends over the speed.
    """
    time, reading, setup = swing.hands_off[0], swing.readings_rad, swing.setup
    while True:
        fit = fit_output_error(time, reading, values=values, free=free, trajectory=trajectory, setup=setup, pull=pull)
        if not fit.converged:
            fit = fit_output_error(
                time, reading, values=fit.values, free=free, trajectory=fit.trajectory, setup=setup, pull=pull
            )
        effect = np.zeros(len(free))
        effect[free] = fit.values[free] * np.linalg.norm(fit.jacobian[:, : sum(free)], axis=0)
        worst = min(_FRICTION[:2], key=lambda place: float(effect[place]))
        if not effect[worst] < 0:
            break
        free = free & ~_mask([worst])
        values = np.where(free, values, 0.0)
    if not fit.converged or fit.coefficients.natural_frequency_squared_s2 <= 0:
        text = "no damped pendulum follows this record: is it a free swing? Look at it with `cfid show`."
        raise explained(FitError(text), swing.findings)
    return fit


def _step_error(swing: FreeSwing, fit: OutputError, pull: Array) -> float:
    """Return the effect of the grid's step on W where dry friction jumps: twice the largest change on two finer grids.

    Where a turning point falls between two nodes is a matter of chance, hence two grids. Without dry friction, the
    grid's error is of fourth order and far below every other error.
    """
    if fit.coefficients.coulomb_per_s2 == 0:
        return 0.0
    time, changes = swing.hands_off[0], [0.0]
    for share in _FINER_STEPS:
        finer = fit_output_error(
            time, swing.readings_rad, values=fit.values, free=fit.free,
            trajectory=on_another_grid(fit.trajectory, share * fit.trajectory.step_s), setup=swing.setup, pull=pull,
        )  # fmt: skip
        changes += [abs(finer.coefficients[0] - fit.coefficients[0])] * finer.converged
    return 2 * max(changes)


def _judged(swing: FreeSwing, fit: OutputError, found: Posterior, step_error: float) -> SwingFit:
    time, count = swing.hands_off[0], len(Coefficients._fields)
    change, variance = np.zeros(len(fit.free)), np.zeros(len(fit.free))
    change[fit.free], variance[fit.free] = found.change[:-2], found.variance[:-2]
    values = fit.values + change
    frequency = float(values[0])
    drift, drift_std = drift_of_halves(fit, time)
    push = max(-fit.coefficients.spring_per_s2, 0.0) if found.pull_std < -_SURE_STD else 0.0
    instrument = "encoder" if swing.rate_rad_per_s is None else "vehicle"
    shares = {
        "noise and friction": math.sqrt(found.least_variance),
        # What the fit without a cable and that with a spring that pushes state for W, as the ends of an interval.
        "cable or encoder": math.hypot(math.sqrt(max(variance[0] - found.least_variance, 0.0)), push / math.sqrt(3)),
        "grid": step_error,
        f"clock of the {instrument}": 2 * frequency * swing.time_scale_std,
        "scatter between windows": scatter_of_windows(fit, time, swing.period_s),
    }
    std = np.sqrt(variance)
    std[0] = math.hypot(*shares.values())
    quality = judge(fit, time, resolution_rad=swing.resolution_rad, drift=drift, drift_std=drift_std)
    known = SwingFit(
        output_error=fit,
        coefficients=Coefficients(*map(float, values[:count])),
        std=Coefficients(*map(float, std[:count])),
        instrument=tuple(map(float, values[count:])),
        instrument_std=tuple(map(float, std[count:])),
        start_std=tuple(map(float, np.sqrt(found.variance[-2:]))),
        residual_rms_rad=float(np.sqrt(np.mean(fit.residual_rad**2))),
        budget_s2={name: share for name, share in shares.items() if share > 0},
        predicted_rad=swing.readings_rad - fit.residual_rad,
        quality=quality,
        push_s2=push,
    )
    return replace(known, findings=(*swing.findings, *quality.findings, *hand_finding(swing, fit), *findings_of(known)))
