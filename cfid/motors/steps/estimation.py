"""How rotors follow steps of the command: a first-order lag for each step, and one rotor model for all of them.

Takes speeds, as a tachometer, `rotor_speed` or the vehicle's own log gives them, or thrust.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares, nnls

from cfid.estimate.blocks import block_means
from cfid.estimate.linear import sandwich
from cfid.findings import Finding, rejection, texts
from cfid.motors.steps.model import BEFORE, CommandStep, Lag, Part, StepData

Array = npt.NDArray[np.float64]

_QUICKEST, _SLOWEST = 1e-3, 10.0  # time constants over the time a command holds
_SMOOTH = 0.25  # time constants over which noise is averaged before judging how much the lag explains
_EXPLAINED, _LOOSE = 0.95, 0.2  # r^2, and the deviation over the time constant
_HELD = 1.5  # time constants that a step needs to show where it leads


@dataclass(frozen=True, kw_only=True)
class StepFit:
    """A first-order lag from one speed to another; by the clocks given it begins `delay_s` after the command.

    Without a speed before the command the delay is unknown: 0, with the standard uncertainty NaN.
    `explained` is the part of the variance that the lag explains (r^2), averaged over a quarter of a time constant.
    """

    step: CommandStep
    from_rad_per_s: float
    to_rad_per_s: float
    time_constant_s: float
    time_constant_std_s: float
    delay_s: float
    delay_std_s: float
    explained: float
    findings: tuple[Finding, ...]

    @property
    def rising(self) -> bool:
        """Whether the rotor speeds up."""
        return self.to_rad_per_s > self.from_rad_per_s

    @property
    def accepted(self) -> bool:
        """Whether a first-order lag describes the step."""
        return not texts(self.findings, "rejection")

    def speed_at(self, time_s: Array) -> Array:
        """Return the lag's speeds (n,) at times (n,) by the clock of the steps."""
        lag = Lag(self.delay_s, self.from_rad_per_s, self.to_rad_per_s, 1 / self.time_constant_s, 0.0)
        return lag.speed(time_s - self.step.at_s)


@dataclass(frozen=True, kw_only=True)
class RotorModel:
    """The rotor model of four coefficients, fitted to all steps at once: see `fit_rotor_model`.

    `rising` and `falling` are (linear in 1/s, quadratic in 1/rad), NaN where no step went that way. A coefficient
    at its bound zero has no standard uncertainty (NaN). `covariance` (4, 4) is that of both, rising first, zero where
    there is none. `rms` is what is left, in the unit of what was fitted.
    """

    rising: tuple[float, float]
    falling: tuple[float, float]
    rising_std: tuple[float, float]
    falling_std: tuple[float, float]
    covariance: Array
    delay_s: float
    delay_std_s: float
    rms: float
    explained: float
    findings: tuple[Finding, ...]

    @property
    def accepted(self) -> bool:
        """Whether the model describes the steps."""
        return not texts(self.findings, "rejection")


def fit_steps(
    *,
    time_s: Array,
    value: Array,
    steps: Sequence[CommandStep],
    thrust_per_speed_squared_n_s2: float | None = None,
    blur_s: float = 0.0,
) -> tuple[StepFit, ...]:
    """Fit a first-order lag in speed to each step: from, to, time constant and delay, by least squares.

    `value` (n,) at times (n,) is the speed in rad/s (NaN where unknown), or with `thrust_per_speed_squared_n_s2` the
    thrust in N, whose root is what lags; with 1 in its place, speeds come out as roots of a newton. `blur_s` is the
    window that each speed was read from, as by `speed_ridge`. Uncertainties allow for correlated residuals.

    Raises FitError when there is no step, or one with too few samples.
    """
    data = StepData(time_s, value, steps, thrust_per_speed_squared_n_s2, blur_s)
    return tuple(_fit_step(data, part) for part in data.parts)


def fit_rotor_model(
    *,
    time_s: Array,
    value: Array,
    steps: Sequence[CommandStep],
    thrust_per_speed_squared_n_s2: float | None = None,
    blur_s: float = 0.0,
) -> RotorModel:
    """Fit the rotor model of four coefficients to all steps at once, by output error.

    With w the speed and c the one that the command leads to,

        dw/dt = k1 (c - w) + k2 (c^2 - w^2),

    k = `rising` where c > w and `falling` elsewhere: in this order the `rotor_dyn_coef` of utiasDSL's drone-models
    (first_principles) and crazyflow, where speeds are in RPM and k2 is 2 pi / 60 of ours. Free are these four, none
    below zero, so that every speed is stable; a delay; and where each step begins and leads. See `fit_steps`.
    """
    data = StepData(time_s, value, steps, thrust_per_speed_squared_n_s2, blur_s)
    lags = [_fit_step(data, part) for part in data.parts]
    measured = np.concatenate([part.value for part in data.parts])

    def residual(p: Array) -> Array:
        ways = [p[1:3] if lag.rising else p[3:5] for lag in lags]
        levels = p[5:].reshape(-1, 2)
        each = zip(data.parts, levels, ways, strict=True)
        shown = [data.shown(part, Lag(p[0], *level, *way)) for part, level, way in each]
        return np.asarray(np.concatenate(shown) - measured)

    start, least = _start(lags), np.array([-math.inf, 0.0, 0.0, 0.0, 0.0] + [-math.inf] * 2 * len(lags))
    fit = least_squares(residual, start, x_scale=np.maximum(np.abs(start), 1e-3), bounds=(least, math.inf))
    covariance = _covariance(fit)
    std, found = np.sqrt(np.diag(covariance)), np.where(fit.active_mask != 0, 0.0, fit.x)
    for first, way in ((1, True), (3, False)):
        if not any(lag.rising == way for lag in lags):
            found[first : first + 2] = std[first : first + 2] = math.nan
    covariance[:, np.isnan(std)] = covariance[np.isnan(std)] = 0.0
    length = round(_SMOOTH * lags[0].time_constant_s / data.parts[0].interval_s)
    explained = _explained(fit.fun, np.concatenate([part.value - part.value.mean() for part in data.parts]), length)
    text = f"the rotor model explains only {100 * explained:.0f} % of the steps (limit {100 * _EXPLAINED:.0f} %)."
    misfit = rejection("rotor-model-misfit", text, "dynamics.rising", "dynamics.falling")
    return RotorModel(
        rising=(float(found[1]), float(found[2])),
        falling=(float(found[3]), float(found[4])),
        rising_std=(float(std[1]), float(std[2])),
        falling_std=(float(std[3]), float(std[4])),
        covariance=covariance[1:5, 1:5],
        delay_s=float(found[0]),
        delay_std_s=float(std[0]),
        rms=float(np.sqrt(np.mean(fit.fun**2))),
        explained=explained,
        findings=(misfit,) if explained < _EXPLAINED else (),
    )


def _fit_step(data: StepData, part: Part) -> StepFit:
    time, value = part.time_s, part.value
    hold_s = part.step.until_s - part.step.at_s
    after = value[time >= 0]
    begin, end = float(value[: max(sum(time < 0), 1)].mean()), float(after[-max(len(after) // 4, 1) :].mean())
    area_s = (end - after.mean()) / (end - begin) * hold_s if end != begin else hold_s
    tau_s = float(np.clip(area_s, 2 * _QUICKEST * hold_s, hold_s))
    start = [data.speed(begin), data.speed(end), tau_s, 0.0]
    scale = [max(abs(start[1] - start[0]), 1e-9)] * 2 + [tau_s] * 2
    least = [-math.inf, -math.inf, _QUICKEST * hold_s, -BEFORE * hold_s]
    most = [math.inf, math.inf, _SLOWEST * hold_s, hold_s / 2]
    free = 4 if np.any(time < 0) else 3  # the speed before determines the delay; else both are one

    def whole(p: Array, fixed: float) -> Array:
        return np.append(p, [fixed] * (4 - free))

    def residual(p: Array) -> Array:
        first, last, tau, delay = whole(p, 0.0)
        return data.shown(part, Lag(delay, first, last, 1 / tau, 0.0)) - value

    fit = least_squares(residual, start[:free], x_scale=scale[:free], bounds=(least[:free], most[:free]))
    found, std = whole(fit.x, 0.0), whole(_deviations(fit), math.nan)
    explained = _explained(fit.fun, value, round(_SMOOTH * fit.x[2] / part.interval_s))
    return StepFit(
        step=part.step,
        from_rad_per_s=float(found[0]),
        to_rad_per_s=float(found[1]),
        time_constant_s=float(found[2]),
        time_constant_std_s=float(std[2]),
        delay_s=float(found[3]),
        delay_std_s=float(std[3]),
        explained=explained,
        findings=_rejections(hold_s, fit.x[2], std[2], explained),
    )


def _rejections(hold_s: float, tau_s: float, std_s: float, explained: float) -> tuple[Finding, ...]:
    """Return why the time constant of a step, one of the rows of the key, is rejected."""
    key = "dynamics.time_constant_s"
    found = []
    if explained < _EXPLAINED:
        text = f"a first-order lag explains only {100 * explained:.0f} % of this step (limit {100 * _EXPLAINED:.0f} %)."
        found.append(rejection("step-lag-misfit", text, key))
    if hold_s < _HELD * tau_s:
        text = f"it held for only {hold_s / tau_s:.1f} time constants (limit {_HELD:g}): its final speed is not known."
        found.append(rejection("step-held-too-short", text, key))
    if not std_s < _LOOSE * tau_s:
        text = f"noise leaves the time constant open by {100 * std_s / tau_s:.0f} % (limit {100 * _LOOSE:.0f} %)."
        found.append(rejection("step-lag-noisy", text, key))
    return tuple(found)


def _start(lags: Sequence[StepFit]) -> Array:
    """Return a start from the lags of single steps: the inverse time constant is linear in the speed."""
    start = [float(np.median([lag.delay_s for lag in lags]))]
    for way in (True, False):
        own = [lag for lag in lags if lag.rising == way] or lags
        rows = np.array([[1.0, (lag.from_rad_per_s + 3 * lag.to_rad_per_s) / 2] for lag in own])
        start += (0.9 * nnls(rows, [1 / lag.time_constant_s for lag in own])[0] + 0.1 / rows.mean(axis=0)).tolist()
    return np.array(start + [level for lag in lags for level in (lag.from_rad_per_s, lag.to_rad_per_s)])


def _explained(residual: Array, value: Array, length: int) -> float:
    """Return the part of the variance (r^2) that is explained, 0 where nothing varies."""
    length = min(max(length, 1), len(value) // 2)  # a slow lag is longer than its step
    noise, signal = (block_means(series, length=length) for series in (residual, value))
    return float(1 - np.var(noise) / np.var(signal)) if np.var(signal) > 0 else 0.0


def _deviations(fit: OptimizeResult) -> Array:
    """Return one standard deviation per parameter (p,); see `_covariance`."""
    return np.asarray(np.sqrt(np.diag(_covariance(fit))))


def _covariance(fit: OptimizeResult) -> Array:
    """Return the parameters' covariance (p, p), residuals being as correlated as they are; NaN at a bound."""
    free = fit.active_mask == 0
    covariance = np.full((len(fit.x), len(fit.x)), math.nan)
    covariance[np.ix_(free, free)] = sandwich(fit.jac[:, free], fit.fun, longest=len(fit.fun) // 4)
    return covariance
