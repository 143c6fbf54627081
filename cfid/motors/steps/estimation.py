"""How rotors follow steps of the command: a first-order lag for each step."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares

from cfid.estimate.linear import gain_of, noise_covariance
from cfid.estimate.signals import block_means
from cfid.findings import Finding, texts
from cfid.motors.steps.checks import rejections
from cfid.motors.steps.model import BEFORE, CommandStep, Lag, Part, Sag, StepData
from cfid.motors.steps.rounding import rounding_covariance
from cfid.motors.steps.sag import LoggedBattery, sags

Array = npt.NDArray[np.float64]

_QUICKEST, _SLOWEST = 1e-3, 10.0  # time constants relative to the time for which a command holds
SMOOTH = 0.25  # time constants over which noise is averaged before judging how much the lag explains
_MOST = 150  # most means of a step's samples, whose covariance is estimated as that of its noise


@dataclass(frozen=True, kw_only=True)
class StepFit:
    """A first-order lag from one speed to another, which begins `delay_s` after the command by the clocks given.

    Without a speed before the command the delay is unknown: it is 0, with NaN as its standard uncertainty. `explained`
    is the part of the variance that the lag explains (r^2), averaged over a quarter of a time constant. `battery` is
    how far the speed to which the step leads fell with the battery's voltage, None with a supply; see `sags`.
    """

    step: CommandStep
    from_rad_per_s: float
    to_rad_per_s: float
    time_constant_s: float
    time_constant_std_s: float
    delay_s: float
    delay_std_s: float
    explained: float
    battery: Sag | None
    findings: tuple[Finding, ...]

    @property
    def rising(self) -> bool:
        """Whether the rotor speeds up."""
        return self.to_rad_per_s > self.from_rad_per_s

    @property
    def accepted(self) -> bool:
        """Whether a first-order lag describes the step."""
        return not texts(self.findings, "rejection")

    @property
    def sag(self) -> float:
        """The part of its final value by which the speed that the step leads to fell."""
        return 0.0 if self.battery is None else self.battery.part

    @property
    def lag(self) -> Lag:
        """The lag with a supply of constant voltage."""
        return Lag(self.delay_s, self.from_rad_per_s, self.to_rad_per_s, 1 / self.time_constant_s, 0.0)

    def speed_at(self, time_s: Array) -> Array:
        """Return the lag's speeds (n,) at times (n,) by the clock of the steps."""
        return self.lag.sagging(self.battery).speed(time_s - self.step.at_s)


def fit_steps(
    *,
    time_s: Array,
    value: Array,
    steps: Sequence[CommandStep],
    blur_s: float = 0.0,
    battery: LoggedBattery | None = None,
) -> tuple[StepFit, ...]:
    """Fit a first-order lag in speed to each step: from, to, time constant and delay, by least squares.

    `value` (n,) at times (n,) is the speed in rad/s (NaN where unknown). `blur_s` is the window from which each speed
    was read, as by `speed_ridge`. Uncertainties allow for correlated noise. With a `battery`, by the same clock, the
    time constants are those with a supply of constant voltage.

    Raises FitError when there is no step, or one with too few samples.
    """
    data = StepData(time_s, value, steps, blur_s)
    return tuple(fit for fit, _ in fit_each(data, battery))


def fit_each(data: StepData, battery: LoggedBattery | None) -> list[tuple[StepFit, Array]]:
    """Fit a lag to each step; return it with the covariance (m, m) of the noise in the means of `_thinned`."""
    fits = [_solve(data, part, None) for part in data.parts]
    ends = [_end_std(data, part, fit) for part, fit in zip(data.parts, fits, strict=True)]
    found = sags(battery, [part.step for part in data.parts], [_lag_of(fit.x) for fit in fits], np.array(ends))
    fits = [_solve(data, part, sag) if sag else fit for part, sag, fit in zip(data.parts, found, fits, strict=True)]
    return [_judged(data, part, sag, fit) for part, sag, fit in zip(data.parts, found, fits, strict=True)]


def _end_std(data: StepData, part: Part, fit: OptimizeResult) -> float:
    """Return the standard uncertainty of the speed that a step leads to, from white noise and one error of rounding."""
    gain = gain_of(fit.jac)[1]
    rounding = data.rounding_step(part) / math.sqrt(12) * float(gain.sum())
    return math.hypot(math.sqrt(np.mean(fit.fun**2)) * float(np.linalg.norm(gain)), rounding)


def _solve(data: StepData, part: Part, sag: Sag | None) -> OptimizeResult:
    """Fit begin, end, time constant and delay to a step; without a speed before it, there is no delay to fit."""
    time, value = part.time_s, part.value
    hold_s = part.step.until_s - part.step.at_s
    after = value[time >= 0]
    begin, end = float(value[: max(sum(time < 0), 1)].mean()), float(after[-max(len(after) // 4, 1) :].mean())
    area_s = (end - after.mean()) / (end - begin) * hold_s if end != begin else hold_s
    tau_s = float(np.clip(area_s, 2 * _QUICKEST * hold_s, hold_s))
    start = [begin, end, tau_s, 0.0]
    scale = [max(abs(start[1] - start[0]), 1e-9)] * 2 + [tau_s] * 2
    least = [-math.inf, -math.inf, _QUICKEST * hold_s, -BEFORE * hold_s]
    most = [math.inf, math.inf, _SLOWEST * hold_s, hold_s / 2]
    free = 4 if np.any(time < 0) else 3
    return least_squares(
        lambda p: data.shown(part, _lag_of(p).sagging(sag)) - value,
        start[:free],
        x_scale=scale[:free],
        bounds=(least[:free], most[:free]),
    )


def _lag_of(found: Array) -> Lag:
    """Return the lag of begin, end, time constant and, where it is known, delay."""
    begin, end, tau_s, *delay_s = found.tolist()
    return Lag(sum(delay_s), begin, end, 1 / tau_s, 0.0)


def larger_sag(sag: Sag | None) -> Sag | None:
    """Return a sag that is larger by its standard uncertainty."""
    return None if sag is None else sag._replace(part=sag.part + sag.part_std)


def moved_by_sag(fit: OptimizeResult, residual: Array) -> Array:
    """Return how far the parameters (p,) of a fit move where a larger sag leaves these residuals (n,); 0 at a bound."""
    free, change = fit.active_mask == 0, np.zeros(len(fit.x))
    change[free] = gain_of(fit.jac[:, free]) @ (fit.fun - residual)
    return change


def _judged(data: StepData, part: Part, sag: Sag | None, fit: OptimizeResult) -> tuple[StepFit, Array]:
    """Return the fit of a step with its uncertainties and the reasons to reject it, and the covariance of its noise."""
    noise, lag = _noise(data, part, fit), _lag_of(fit.x)
    more = moved_by_sag(fit, data.shown(part, lag.sagging(larger_sag(sag))) - part.value)
    std = np.sqrt(np.diag(covariance_of(fit, [part], [noise])) + more**2)
    explained = explained_part(fit.fun, part.value, round(SMOOTH * fit.x[2] / part.interval_s))
    found = StepFit(
        step=part.step,
        from_rad_per_s=lag.begin,
        to_rad_per_s=lag.end,
        time_constant_s=float(fit.x[2]),
        time_constant_std_s=float(std[2]),
        delay_s=lag.delay_s,
        delay_std_s=float(std[3]) if len(std) > 3 else math.nan,
        explained=explained,
        battery=sag,
        findings=rejections(part, fit.x[2], std[2], explained),
    )
    return found, noise


def explained_part(residual: Array, value: Array, length: int) -> float:
    """Return the part of the variance (r^2) that is explained, 0 where nothing varies."""
    length = min(max(length, 1), len(value) // 2)  # a slow lag is longer than its step
    noise, signal = (block_means(series, length=length) for series in (residual, value))
    return float(1 - np.var(noise) / np.var(signal)) if np.var(signal) > 0 else 0.0


def _noise(data: StepData, part: Part, fit: OptimizeResult) -> Array:
    """Return the covariance (m, m) of the noise in the means of a step's samples.

    Rounding hardly shows in the residuals of a rotor that has settled, so its covariance is calculated from the size of
    the rounding. The residuals beyond that are other noise.
    """
    time_s, residual = (_thinned(part, column) for column in (part.time_s, fit.fun))
    jacobian = _thinned(part, fit.jac.T).T
    rounding = rounding_covariance(
        part.value + fit.fun,
        step=data.rounding_step(part),
        scatter=math.sqrt(np.mean(fit.fun**2)),
        length=block_of(part),
    )
    left = np.eye(len(residual)) - jacobian @ gain_of(jacobian)
    explained = float(np.trace(left @ rounding @ left)) / max(float(residual @ residual), 1e-300)
    other = noise_covariance(jacobian, residual, data.correlations(time_s))
    return np.asarray(max(1 - explained, 0.0) * other + rounding)


def covariance_of(fit: OptimizeResult, parts: Sequence[Part], noises: Sequence[Array]) -> Array:
    """Return the parameters' covariance (p, p), NaN at a bound, from noise with a covariance (m, m) in each part.

    Residuals after those of the parts belong to the expected values of parameters, each with a covariance (1, 1).
    """
    free = fit.active_mask == 0
    lengths = [len(part.time_s) for part in parts] + [1] * (len(noises) - len(parts))
    jacobians = np.split(fit.jac[:, free], np.cumsum(lengths)[:-1])
    rows = [_thinned(part, own.T).T for part, own in zip(parts, jacobians, strict=False)] + jacobians[len(parts) :]
    blocks = [block_of(part) for part in parts] + [1] * (len(noises) - len(parts))
    weight = np.repeat(np.sqrt(blocks), [len(own) for own in rows])
    gain = gain_of(weight[:, np.newaxis] * np.vstack(rows)) * weight
    columns = np.split(gain, np.cumsum([len(own) for own in rows])[:-1], axis=1)
    found = sum(own @ noise @ own.T for own, noise in zip(columns, noises, strict=True))
    covariance = np.full((len(fit.x), len(fit.x)), math.nan)
    covariance[np.ix_(free, free)] = found
    return covariance


def _thinned(part: Part, value: Array) -> Array:
    """Return means (..., m) of neighbouring samples of a step (..., n)."""
    return block_means(value, length=block_of(part))


def block_of(part: Part) -> int:
    """Return how many neighbouring samples of a step are averaged before their noise is looked at."""
    return -(-len(part.time_s) // _MOST)
