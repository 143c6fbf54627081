"""Fit a swing by the default method: one model with every nuisance, its uncertainty, and checks of its waveform.

What a swing cannot separate is weighed by priors. A cable that pulls as a spring and a disc that stretches the angle
change the period's dependence on the angle alike. How large either is on a rig is unknown, even in its order of
magnitude: every size up to that of the worst rig counts, by how likely the record is with it.

The limits of the checks lie between the two public records that cfid is checked with: a good rig stays below each by a
factor of three or more, and a rig with a soft arm and a dragging cable exceeds that of the waveform.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc, erfcx, log_ndtr

from cfid.errors import FitError
from cfid.estimate.linear import gain_of
from cfid.estimate.signals import GRID_S, block_means, correlation_inflation
from cfid.findings import Finding, explained, note, rejection, texts, warning
from cfid.recordings.gyro import SCALE_STD
from cfid.swing.pendulum import (
    Coefficients,
    OutputError,
    Trajectory,
    first_guess,
    fit_output_error,
    motion_in_readings,
    on_another_grid,
)
from cfid.swing.window import FreeSwing

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MISFIT_LIMIT = 0.02
DISTORTION_LIMIT = 0.0015
DRIFT_LIMIT = 0.01
UNCERTAIN_LIMIT = 0.1  # of W: with more, the pendulum may have followed noise
UNUSUAL_STD = 4.0  # standard uncertainties that data sheets state, beyond which an instrument is rejected

# Standard deviations on the worst rig that works: a cable's stiffness over gravity's, of which twice is too much, and
# either amplitude of an encoder's error within a turn, for which data sheets state limits of 0.3 to 1.4 degrees.
CABLE_STD, DISC_STD_RAD = 0.015, math.radians(0.6)
_MOST_CABLE, _MOST_DISC_RAD = 2 * CABLE_STD, 5 * DISC_STD_RAD  # the latter is twice the worst data sheet's
_SHARES = np.logspace(-3, 0, 13)  # of the worst rig's, that a rig may have
_RARER = math.log10(5)  # a rig that is ten times worse is five times rarer
# The likelihood's exponent is divided by this: it is linear about one fit, and second-order terms of a disc or a cable
# of 1 % otherwise decide between the two where the record does not.
_TEMPERED = 3.0
_FRICTION_STD = 0.3  # of Coulomb friction: how much dry friction varies at low speed and over the angle
_LEAST_FRICTION_RAD = math.radians(0.02)  # the zero's shift by the least dry friction, for bearings that show none
_LEAST_STD = 1e-6  # of a cable or disc that the rig states to be perfect
_WIDER = 4.0  # than its priors, for the fit that a gyro's posterior starts from: its scale may be worse than usual
_ROUNDS = 2  # each with the noise of the last; the first noise contains what the nuisances explain
_SURE_STD = 4.0  # beyond, a spring is no chance

_LEAST_ROWS = 16
_PHASE_STEP = 0.08  # rad of the natural oscillation, the longest grid step: phase error 1e-7
_FINER_STEPS = (0.5, 0.7)
_PERIODS_A_WINDOW, _MOST_WINDOWS = 4, 8
_SCATTERED = 0.05  # probability that windows scatter as far by chance: below it, the model is wrong
_BLOCKS_A_PERIOD = 12
_SHARE_THAT_MATTERS = 1e-3  # of W: as the mass leaves uncertain, on scales that show 0.1 g
_LED_BY_HAND = 0.15  # of the release angle

# Places among a fit's values: coefficients, then the instrument's errors.
_FREQUENCY, _FRICTION, _ZERO, _CABLE, _SHAPES, _FIRST, _SECOND = 0, [1, 2, 3], 4, 5, [6, 7, 8], 9, 10
_ALL = "swing.*"


@dataclass(frozen=True, kw_only=True)
class SwingFit:
    """A swing's natural frequency squared and damping, each damping term divided by the axis inertia.

    `std` has the fields of `coefficients`; `start_std` belongs to the start angle and speed. `budget_s2` has the parts
    of W's standard uncertainty. `instrument` has the error of the readings as in `OutputError`, with standard
    uncertainties `instrument_std`; `predicted_rad` (n,) are the readings without residual.

    `misfit` is the rms of the residual's block means over the start angle. `distortion` is the same after each period's
    own amplitude, phase and zero have been removed, which leaves the waveform. `drift` is the relative change of W from
    the first to the second half of the window.
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
    misfit: float
    distortion: float
    distortion_limit: float
    drift: float
    drift_std: float
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
    # 4 ms as in the thesis, shorter for fast pendulums.
    step_s = min(GRID_S, _PHASE_STEP * swing.period_s / (2 * math.pi))
    guess, trajectory = first_guess(time, angle, start_s=swing.release_s, step_s=step_s)
    needed, nuisances, wider = [_FREQUENCY, _ZERO], [*_SHAPES, _CABLE, _FIRST, _SECOND], 1.0
    if swing.rate_rad_per_s is not None:
        trajectory = trajectory._replace(angle_rad=trajectory.angle_rad - guess.zero_rad)
        guess = guess._replace(zero_rad=0.0)
        needed, nuisances, wider = [_FREQUENCY, _SECOND], [*_SHAPES, _FIRST], _WIDER
    values = np.array([*guess, 0.0, 0.0])
    try:
        fit = _damped(swing, values, trajectory, _mask([*needed, *_FRICTION]))
        priors = _priors(swing, fit)
        for _ in range(_ROUNDS):
            pull = _noise_variance(fit) / (wider * priors) ** 2
            fit = _damped(swing, fit.values, fit.trajectory, fit.free | _mask(nuisances), pull)
        return _judged(swing, fit, _posterior(swing, fit, priors), _step_error(swing, fit, pull))
    except FitError:  # what a viscous pendulum misses shows why no pendulum follows
        fit = _damped(swing, values, trajectory, _mask([*needed, *_FRICTION[:1]]))
        judged = _judged(swing, fit, _posterior(swing, fit, _priors(swing, fit)), 0.0)
        if judged.accepted:
            raise
        return judged


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


def _priors(swing: FreeSwing, fit: OutputError) -> Array:
    """Return standard deviations (11,) of a fit's values about zero on the worst rig, infinite where nothing is known.

    These are the priors of a cable and an encoder, or of a gyro, and of dry friction that varies. What the rig states
    of its cable and disc holds for it and no other.
    """
    frequency, coulomb = fit.coefficients.natural_frequency_squared_s2, fit.coefficients.coulomb_per_s2
    varies = _FRICTION_STD * max(coulomb, _LEAST_FRICTION_RAD * frequency)
    gyro = swing.rate_rad_per_s is not None
    cable, disc_deg = swing.encoder.cable_std, swing.encoder.disc_std_deg
    cable_std = CABLE_STD if cable is None else max(cable, _LEAST_STD)
    disc_rad = DISC_STD_RAD if disc_deg is None else math.radians(max(disc_deg, _LEAST_STD))
    of_instrument = (swing.rate_scale_std, math.inf) if gyro else (disc_rad, disc_rad)
    return np.array([*[math.inf] * _CABLE, cable_std * frequency, *[varies] * 3, *of_instrument])


class _Posterior(NamedTuple):
    """What a record and the priors give: changes of a fit's free values, then of its start (p,), and variances (p,).

    `least_variance` is W's on the best rig; `pull_std` is the cable's pull on the worst rig, in standard deviations,
    without the knowledge that a cable does not push.
    """

    change: Array
    variance: Array
    least_variance: float
    pull_std: float


def _posterior(swing: FreeSwing, fit: OutputError, worst_std: Array) -> _Posterior:
    """Average over all rigs [HMRV]: the values on each count by how likely the record is with it."""
    stated = {_CABLE: swing.encoder.cable_std, _FIRST: swing.encoder.disc_std_deg}
    gyro = swing.rate_rad_per_s is not None
    of_rig = [place for place, std in stated.items() if std is None and not gyro]
    size, noise = np.linalg.norm(fit.jacobian, axis=0), _noise_variance(fit)
    rows = fit.jacobian / size
    shares = np.array(list(product(_SHARES, repeat=len(of_rig))))
    std = np.tile(worst_std, (len(shares), 1))
    std[:, of_rig] *= shares
    std = np.append(std[:, fit.free], np.full((len(shares), 2), math.inf), axis=1) * size
    values, weight = np.append(fit.values[fit.free], [0.0, 0.0]) * size, 1 / std**2
    covariance = np.linalg.inv(rows.T @ rows / noise + weight[:, None] * np.eye(len(size)))
    pulled = rows.T @ fit.residual_rad / noise - weight * values
    change = np.einsum("rij,rj->ri", covariance, pulled)
    # Rounding of a nearly singular inverse may leave less than what each value alone would have.
    variance = np.maximum(np.einsum("rii->ri", covariance), 1 / (1 / noise + weight))
    score = np.sum(pulled * change - weight * values**2, axis=1) / _TEMPERED + np.linalg.slogdet(covariance)[1]
    score = score / 2 - (1 + _RARER) * np.log(shares).sum(axis=1)
    pull_std = 0.0
    if fit.free[_CABLE]:  # a cable does not push: its stiffness has a normal distribution without its negative part
        cable = int(np.sum(fit.free[:_CABLE]))
        spread = np.sqrt(variance[:, cable])
        mean = (values[cable] + change[:, cable]) / spread
        score += log_ndtr(mean)
        higher = math.sqrt(2 / math.pi) / erfcx(-mean / math.sqrt(2))
        moved = covariance[:, cable] / spread[:, None]
        change += higher[:, None] * moved
        variance -= np.minimum(higher * (higher + mean), 1)[:, None] * moved**2
        pull_std = float(mean[-1])
    likely = np.exp(score - score.max())
    likely /= likely.sum()
    together = likely @ change
    return _Posterior(
        change=together / size,
        variance=likely @ (variance + (change - together) ** 2) / size**2,
        least_variance=float(variance[0, 0] / size[0] ** 2),
        pull_std=pull_std,
    )


def _judged(swing: FreeSwing, fit: OutputError, known: _Posterior, step_error: float) -> SwingFit:
    """Return the fit with all parts of its uncertainty, and what its checks report."""
    time, count = swing.hands_off[0], len(Coefficients._fields)
    change, variance = np.zeros(len(fit.free)), np.zeros(len(fit.free))
    change[fit.free], variance[fit.free] = known.change[:-2], known.variance[:-2]
    values = fit.values + change
    frequency = float(values[0])
    spring_s2 = fit.coefficients.spring_per_s2 if abs(known.pull_std) > _SURE_STD else 0.0
    shares = {
        "noise and friction": math.sqrt(known.least_variance),
        # What the fits with and without a sure spring state for W, as the ends of an interval: an arm that flexes and
        # a disc's second harmonic resemble one.
        "cable or encoder": math.sqrt(max(variance[0] - known.least_variance, 0.0) + spring_s2**2 / 3),
        "cable that a gyro does not show": frequency * swing.unseen_cable_std,
        "grid": step_error,
        f"clock of the {swing.timed_by}": 2 * frequency * swing.time_scale_std,
        "scatter between windows": _scatter_of_windows(fit, time, swing.period_s),
    }
    std = np.sqrt(variance)
    std[0] = math.hypot(*shares.values())
    halves, variances = _windows(fit, time, 2)
    drift = float((halves[1] - halves[0]) / fit.coefficients.natural_frequency_squared_s2)
    drift_std = float(math.sqrt(variances.sum()) / fit.coefficients.natural_frequency_squared_s2)
    misfit, distortion, distortion_limit = waveform(fit, time, resolution_rad=swing.resolution_rad)
    findings = (
        *swing.findings,
        *_over_limits((misfit, distortion, distortion_limit), (drift, drift_std), std[0] / frequency),
        *_led_by_hand(swing, fit),
    )
    if swing.rate_rad_per_s is None:
        findings += _cable_or_encoder(
            (spring_s2 or values[_CABLE]) / frequency, math.hypot(*values[count:]),
            shares["cable or encoder"] / frequency,
        )  # fmt: skip
    elif abs(values[_FIRST]) > UNUSUAL_STD * SCALE_STD:
        text = (
            f"the gyro's scale is {_percent(values[_FIRST])} off, by how the period depends on the angle (usual: "
            f"{_percent(SCALE_STD)}, limit {_percent(UNUSUAL_STD * SCALE_STD)}): another range or unit than the log "
            "states, or no pendulum. Compare with a swing from another angle."
        )
        findings += (rejection("swing-gyro-scale", text, _ALL),)
    return SwingFit(
        output_error=fit,
        coefficients=Coefficients(*map(float, values[:count])),
        std=Coefficients(*map(float, std[:count])),
        instrument=tuple(map(float, values[count:])),
        instrument_std=tuple(map(float, std[count:])),
        start_std=tuple(map(float, np.sqrt(known.variance[-2:]))),
        residual_rms_rad=_rms(fit.residual_rad),
        budget_s2={name: share for name, share in shares.items() if share > 0},
        predicted_rad=swing.readings_rad - fit.residual_rad,
        misfit=misfit,
        distortion=distortion,
        distortion_limit=distortion_limit,
        drift=drift,
        drift_std=drift_std,
        findings=findings,
    )


def _noise_variance(fit: OutputError) -> float:
    """Return the variance of white noise that would leave as much uncertain as the residual, which is correlated."""
    residual, free = fit.residual_rad, fit.jacobian.shape[1]
    span = (len(fit.trajectory.angle_rad) - 1) * fit.trajectory.step_s
    samples_a_period = max(int(len(residual) * min(_period_s(fit), span) / span), 8)
    variance = float(residual @ residual) / max(len(residual) - free, 1)
    return float(variance * correlation_inflation(residual, longest=samples_a_period))


def _period_s(fit: OutputError) -> float:
    return 2 * math.pi / math.sqrt(max(fit.coefficients.natural_frequency_squared_s2, 1e-9))


def _scatter_of_windows(fit: OutputError, time_s: Array, period_s: float) -> float:
    """Return the uncertainty of W by its scatter between windows beyond noise, 0 where noise explains it.

    Friction that the model lacks changes W with the amplitude. The variance between the windows is that of DerSimonian
    and Laird [DL].
    """
    count = min(int((time_s[-1] - time_s[0]) / period_s / _PERIODS_A_WINDOW), _MOST_WINDOWS)
    if count < 3:
        return 0.0
    values, variances = _windows(fit, time_s, count)
    weights = 1 / variances
    mean = weights @ values / weights.sum()
    scatter = float(weights @ (values - mean) ** 2)
    if chdtrc(count - 1, scatter) > _SCATTERED:
        return 0.0
    between = (scatter - (count - 1)) / float(weights.sum() - weights @ weights / weights.sum())
    return math.sqrt(max(between, 0.0))


def _windows(fit: OutputError, time_s: Array, count: int) -> tuple[Array, Array]:
    """Return how far W lies off in windows of equal length, each with a start of its own, and the variances."""
    read, slope = motion_in_readings(fit, time_s)
    edges = np.searchsorted(time_s, np.linspace(time_s[0], time_s[-1], count + 1)[1:-1])
    noise, values, variances = _noise_variance(fit), [], []
    for part in np.split(np.arange(len(time_s)), edges):
        later = (time_s[part] - time_s[part].mean()) / (2 * fit.coefficients.natural_frequency_squared_s2)
        rows = np.stack([later * slope[part], slope[part], read[part], np.ones(len(part))], axis=1)
        gain = gain_of(rows)[0]
        values.append(gain @ fit.residual_rad[part])
        variances.append(noise * gain @ gain)
    return np.array(values), np.array(variances)


def waveform(fit: OutputError, time_s: Array, *, resolution_rad: float) -> tuple[float, float, float]:
    """Return misfit and distortion of a fit to samples at `time_s` (n,), and the limit of the distortion.

    The residual without its best fit in each period by the model's reading, its derivative and a constant is what
    distorts the waveform. Noise and the encoder's steps, `resolution_rad`, contribute to it as well.
    """
    start, period, residual = float(np.max(np.abs(fit.trajectory.angle_rad))), _period_s(fit), fit.residual_rad
    block = max(int(len(time_s) * period / (time_s[-1] - time_s[0])) // _BLOCKS_A_PERIOD, 1)
    reading, slope = motion_in_readings(fit, time_s)
    remainder = residual.copy()
    edges = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], period))
    for first, last in zip(edges, [*edges[1:], len(time_s)], strict=True):
        part = slice(first, last)
        local = np.stack([reading[part], slope[part], np.ones(last - first)], axis=1)
        if last - first > 2 * local.shape[1]:
            remainder[part] -= local @ np.linalg.lstsq(local, remainder[part], rcond=None)[0]
    noise_variance = float(np.mean(np.diff(residual) ** 2)) / 2
    allowed = (DISTORTION_LIMIT * start) ** 2 + 2 * noise_variance / block + resolution_rad**2 / 12
    misfit, distortion = (_rms(block_means(values, length=block)) / start for values in (residual, remainder))
    return misfit, distortion, math.sqrt(allowed) / start


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.2g} %"


def _over_limits(
    shape: tuple[float, float, float], drifting: tuple[float, float], relative_std: float
) -> tuple[Finding, ...]:
    """Return a rejection for each exceeded limit of misfit, distortion, drift and W's relative uncertainty."""
    (misfit, distortion, distortion_limit), (drift, drift_std), findings = shape, drifting, []
    if not misfit <= MISFIT_LIMIT:
        text = (
            f"the best pendulum misses the record by {_percent(misfit)} of the start angle (limit "
            f"{_percent(MISFIT_LIMIT)}). Check the angle's unit, and that the body touched nothing."
        )
        findings.append(rejection("swing-misfit", text, _ALL))
    if not distortion <= distortion_limit:
        text = (
            f"within a period the motion differs from a pendulum's by {_percent(distortion)} of the start angle (limit "
            f"{_percent(distortion_limit)}). Likely causes: a soft arm, a cable, a loose mount, a hand, an "
            "encoder that froze; on threads, that they are not alike."
        )
        findings.append(rejection("swing-waveform-distorted", text, _ALL))
    if not abs(drift) <= max(DRIFT_LIMIT, UNUSUAL_STD * drift_std):
        text = (
            f"the natural frequency squared changes by {100 * drift:+.2g} % from the first half of the window to the "
            f"second (limit {_percent(DRIFT_LIMIT)}). Tighten the mount, or use fewer peaks."
        )
        findings.append(rejection("swing-frequency-drift", text, _ALL))
    if relative_std > UNCERTAIN_LIMIT:
        text = (
            f"the natural frequency squared is uncertain by {_percent(relative_std)} (limit "
            f"{_percent(UNCERTAIN_LIMIT)}): the record is too short or too noisy. Release higher, swing longer; look "
            "at it with `cfid show`."
        )
        findings.append(rejection("swing-uncertain", text, _ALL))
    return tuple(findings)


def _cable_or_encoder(stiffness: float, disc_rad: float, share: float) -> tuple[Finding, ...]:
    """Report a cable, or a spring that pushes, as a share of gravity's stiffness, and an eccentric disc.

    `share` is what they leave uncertain of W.
    """
    kind = "a spring that pushes with" if stiffness < 0 else "a cable of"
    spring = f"{kind} {_percent(abs(stiffness))} of gravity's stiffness"
    disc = f"an encoder that reads {math.degrees(disc_rad):.2g} degrees off within a turn"
    if beyond := [
        what for what, over in ((spring, abs(stiffness) > _MOST_CABLE), (disc, disc_rad > _MOST_DISC_RAD)) if over
    ]:
        text = (
            f"the period depends on the angle as with {' and '.join(beyond)} (limits {_percent(_MOST_CABLE)}, "
            f"{math.degrees(_MOST_DISC_RAD):.2g} degrees): check the angle's unit and the counts per turn; free the "
            "cable, centre the disc."
        )
        return (rejection("swing-no-gravity-pendulum", text, _ALL),)
    if share <= _SHARE_THAT_MATTERS:
        return ()
    text = (
        f"the period depends on the angle as with {spring} and {disc}: the record cannot separate the two, which "
        f"leaves the natural frequency squared uncertain by {_percent(share)}. Free the cable, centre the disc; "
        "release higher, swing longer."
    )
    return (warning("swing-cable-or-encoder", text, _ALL),)


def _led_by_hand(swing: FreeSwing, fit: OutputError) -> tuple[Finding, ...]:
    """Report motion just after the release that is not the pendulum's own."""
    measured = float(swing.angle_rad[swing.release])
    if swing.hand_gone == swing.release or abs(fit.start_angle_rad - measured) < _LED_BY_HAND * abs(measured):
        return ()
    text = (
        f"between {swing.release_s:.2f} and {swing.time_s[swing.hand_gone]:.2f} s the body did not fall freely "
        f"(the pendulum would have started from {math.degrees(fit.start_angle_rad):.0f} degrees, "
        f"it stood at {math.degrees(measured):.0f}): this segment is left out. Release without a push."
    )
    return (note("swing-led-by-hand", text, "swing.start_angle_rad", "swing.start_speed_rad_per_s"),)
