"""How rotors follow steps of the command: a first-order lag for each step, and one rotor model for all of them.

Takes speeds, as a tachometer, `rotor_speed` or the vehicle's own log gives them, or thrust.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares, nnls

from cfid.estimate.blocks import block_means
from cfid.estimate.correlated_noise import noise_covariance
from cfid.estimate.linear import gain_of
from cfid.findings import Finding, rejection, texts
from cfid.motors.steps.checks import EXPLAINED, rejections
from cfid.motors.steps.model import BEFORE, CommandStep, Lag, Part, Sag, StepData
from cfid.motors.steps.sag import LoggedBattery, sags

Array = npt.NDArray[np.float64]

_QUICKEST, _SLOWEST = 1e-3, 10.0  # time constants over the time a command holds
_SMOOTH = 0.25  # time constants over which noise is averaged before judging how much the lag explains
_MOST = 150  # means of a step's samples, whose covariance is taken for that of its noise


@dataclass(frozen=True, kw_only=True)
class StepFit:
    """A first-order lag from one speed to another; by the clocks given it begins `delay_s` after the command.

    Without a speed before the command the delay is unknown: 0, with the standard uncertainty NaN.
    `explained` is the part of the variance that the lag explains (r^2), averaged over a quarter of a time constant.
    `battery` is how far the speed that it leads to fell with the battery's voltage, None with a supply, see `sags`.
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
        """By which part of its final value the speed that the step leads to fell."""
        return 0.0 if self.battery is None else self.battery.part

    @property
    def lag(self) -> Lag:
        """The lag with a supply of constant voltage."""
        return Lag(self.delay_s, self.from_rad_per_s, self.to_rad_per_s, 1 / self.time_constant_s, 0.0)

    def speed_at(self, time_s: Array) -> Array:
        """Return the lag's speeds (n,) at times (n,) by the clock of the steps."""
        return self.lag.sagging(self.battery).speed(time_s - self.step.at_s)


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
    battery: LoggedBattery | None = None,
) -> tuple[StepFit, ...]:
    """Fit a first-order lag in speed to each step: from, to, time constant and delay, by least squares.

    `value` (n,) at times (n,) is the speed in rad/s (NaN where unknown), or with `thrust_per_speed_squared_n_s2` the
    thrust in N, whose root is what lags; with 1 in its place, speeds come out as roots of a newton. `blur_s` is the
    window that each speed was read from, as by `speed_ridge`. Uncertainties allow for correlated noise. With a
    `battery`, by the same clock, the time constants are those with a supply of constant voltage.

    Raises FitError when there is no step, or one with too few samples.
    """
    data = StepData(time_s, value, steps, thrust_per_speed_squared_n_s2, blur_s)
    return tuple(fit for fit, _ in _fit_each(data, battery))


def fit_rotor_model(
    *,
    time_s: Array,
    value: Array,
    steps: Sequence[CommandStep],
    thrust_per_speed_squared_n_s2: float | None = None,
    blur_s: float = 0.0,
    command_row_s: float = 0.0,
    battery: LoggedBattery | None = None,
) -> RotorModel:
    """Fit the rotor model of four coefficients to all steps at once, by output error.

    With w the speed and c the one that the command leads to,

        dw/dt = k1 (c - w) + k2 (c^2 - w^2),

    k = `rising` where c > w and `falling` elsewhere: in this order the `rotor_dyn_coef` of utiasDSL's drone-models
    (first_principles) and crazyflow, where speeds are in RPM and k2 is 2 pi / 60 of ours. Free are these four, none
    below zero, so that every speed is stable; a delay; and where each step begins and leads. Where commands are known
    in rows `command_row_s` apart, each step has its own delay, about the common one as a change within a row makes it.
    See `fit_steps`.
    """
    data = StepData(time_s, value, steps, thrust_per_speed_squared_n_s2, blur_s)
    lags, noises = zip(*_fit_each(data, battery), strict=True)
    measured = np.concatenate([part.value for part in data.parts])
    noise_std = _noise_std(data.parts, noises) if command_row_s else np.empty(0)
    own = 3 if command_row_s else 2  # parameters of each step: begin, end, and how late its command was seen

    def shown(p: Array, batteries: Iterable[Sag | None]) -> Array:
        ways = [p[1:3] if lag.rising else p[3:5] for lag in lags]
        each = zip(data.parts, p[5:].reshape(-1, own), ways, batteries, strict=True)
        values = [
            data.shown(part, Lag(p[0] + sum(late), begin, end, *way).sagging(sag))
            for part, (begin, end, *late), way, sag in each
        ]
        return np.concatenate(values)

    def residual(p: Array, batteries: Iterable[Sag | None] = tuple(lag.battery for lag in lags)) -> Array:
        late = p[5:].reshape(-1, own)[:, 2:].ravel()
        usual_late = noise_std * late * math.sqrt(12) / command_row_s if command_row_s else late
        return np.concatenate([shown(p, batteries) - measured, usual_late])

    start = _start(lags, own)
    least = np.array([-math.inf, 0.0, 0.0, 0.0, 0.0] + [-math.inf] * own * len(lags))
    lengths = [len(part.value) for part in data.parts]
    fit = least_squares(
        residual,
        start,
        jac=lambda p: _slopes(residual, p, lengths, own),
        x_scale=np.maximum(np.abs(start), 1e-3),
        bounds=(least, math.inf),
    )
    more = _of_sag(fit, residual(fit.x, [_larger(lag.battery) for lag in lags]))
    covariance = _covariance(fit, data.parts, [*noises, *np.reshape(noise_std**2, (-1, 1, 1))]) + np.outer(more, more)
    left = fit.fun[: len(measured)]
    std, found = np.sqrt(np.diag(covariance)), np.where(fit.active_mask != 0, 0.0, fit.x)
    for first, way in ((1, True), (3, False)):
        if not any(lag.rising == way for lag in lags):
            found[first : first + 2] = std[first : first + 2] = math.nan
    covariance[:, np.isnan(std)] = covariance[np.isnan(std)] = 0.0
    length = round(_SMOOTH * lags[0].time_constant_s / data.parts[0].interval_s)
    explained = _explained(left, np.concatenate([part.value - part.value.mean() for part in data.parts]), length)
    text = f"the rotor model explains only {100 * explained:.0f} % of the steps (limit {100 * EXPLAINED:.0f} %)."
    misfit = rejection("rotor-model-misfit", text, "dynamics.rising", "dynamics.falling")
    return RotorModel(
        rising=(float(found[1]), float(found[2])),
        falling=(float(found[3]), float(found[4])),
        rising_std=(float(std[1]), float(std[2])),
        falling_std=(float(std[3]), float(std[4])),
        covariance=covariance[1:5, 1:5],
        delay_s=float(found[0]),
        delay_std_s=float(std[0]),
        rms=float(np.sqrt(np.mean(left**2))),
        explained=explained,
        findings=(misfit,) if explained < EXPLAINED else (),
    )


def _slopes(residual: Callable[[Array], Array], p: Array, lengths: Sequence[int], own: int) -> Array:
    """Return the forward differences of residuals of s steps, whose `own` parameters each change their own step only.

    The residuals are those of the steps' values, then of what each step's parameters are expected to be, if anything.
    All steps' levels are moved at once: hundreds of steps cost seven evaluations, not two for each.
    """
    moves = math.sqrt(np.finfo(float).eps) * np.maximum(1.0, np.abs(p)) * np.where(p < 0, -1.0, 1.0)
    now, numbers = residual(p), np.arange(len(lengths))
    slopes, steps = np.zeros((len(now), len(p))), np.append(np.repeat(numbers, lengths), numbers)[: len(now)]
    for place in range(5):
        moved = np.arange(len(p)) == place
        slopes[:, place] = (residual(p + moved * moves) - now) / moves[place]
    for level in range(5, 5 + own):
        columns = level + own * steps
        moved = np.isin(np.arange(len(p)), columns)
        slopes[np.arange(len(now)), columns] = (residual(p + moved * moves) - now) / moves[columns]
    return slopes


def _fit_each(data: StepData, battery: LoggedBattery | None) -> list[tuple[StepFit, Array]]:
    """Fit a lag to each step, with the covariance of its noise (m, m) in the means of `_thinned`."""
    fits = [_solve(data, part, None) for part in data.parts]
    ends = [math.sqrt(np.mean(fit.fun**2)) * np.linalg.norm(gain_of(fit.jac)[1]) for fit in fits]
    found = sags(battery, [part.step for part in data.parts], [_lag_of(fit.x) for fit in fits], np.array(ends))
    fits = [_solve(data, part, sag) if sag else fit for part, sag, fit in zip(data.parts, found, fits, strict=True)]
    return [_judged(data, part, sag, fit) for part, sag, fit in zip(data.parts, found, fits, strict=True)]


def _solve(data: StepData, part: Part, sag: Sag | None) -> OptimizeResult:
    """Fit begin, end, time constant and delay to a step; without a speed before it begin and delay are one."""
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


def _larger(sag: Sag | None) -> Sag | None:
    """Return a sag that is larger by its standard uncertainty."""
    return None if sag is None else sag._replace(part=sag.part + sag.part_std)


def _of_sag(fit: OptimizeResult, residual: Array) -> Array:
    """Return how far the parameters (p,) of a fit go where a larger sag leaves residuals (n,), 0 at a bound."""
    free, change = fit.active_mask == 0, np.zeros(len(fit.x))
    change[free] = gain_of(fit.jac[:, free]) @ (fit.fun - residual)
    return change


def _judged(data: StepData, part: Part, sag: Sag | None, fit: OptimizeResult) -> tuple[StepFit, Array]:
    """Return the fit of a step with its uncertainties and what speaks against it, and the covariance of its noise."""
    noise, lag = _noise(data, part, fit), _lag_of(fit.x)
    more = _of_sag(fit, data.shown(part, lag.sagging(_larger(sag))) - part.value)
    std = np.sqrt(np.diag(_covariance(fit, [part], [noise])) + more**2)
    explained = _explained(fit.fun, part.value, round(_SMOOTH * fit.x[2] / part.interval_s))
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


def _start(lags: Sequence[StepFit], own: int) -> Array:
    """Return a start from the lags of single steps: the inverse time constant is linear in the speed."""
    start = [float(np.median([lag.delay_s for lag in lags]))]
    for way in (True, False):
        these = [lag for lag in lags if lag.rising == way] or lags
        rows = np.array([[1.0, (lag.from_rad_per_s + 3 * lag.to_rad_per_s) / 2] for lag in these])
        usual = np.abs(rows).mean(axis=0)  # a noisy step may end below 0
        start += (0.9 * nnls(rows, [1 / lag.time_constant_s for lag in these])[0] + 0.1 / usual).tolist()
    each = [(lag.from_rad_per_s, lag.to_rad_per_s, 0.0)[:own] for lag in lags]
    return np.append(start, each)


def _explained(residual: Array, value: Array, length: int) -> float:
    """Return the part of the variance (r^2) that is explained, 0 where nothing varies."""
    length = min(max(length, 1), len(value) // 2)  # a slow lag is longer than its step
    noise, signal = (block_means(series, length=length) for series in (residual, value))
    return float(1 - np.var(noise) / np.var(signal)) if np.var(signal) > 0 else 0.0


def _noise(data: StepData, part: Part, fit: OptimizeResult) -> Array:
    """Return the covariance (m, m) of the noise in the means of a step's samples."""
    time_s, residual = (_thinned(part, column) for column in (part.time_s, fit.fun))
    return noise_covariance(_thinned(part, fit.jac.T).T, residual, data.correlations(time_s))


def _noise_std(parts: Sequence[Part], noises: Sequence[Array]) -> Array:
    """Return the standard deviation of single samples of each step (s,), of noise with covariances (m, m)."""
    each = zip(parts, noises, strict=True)
    return np.array([math.sqrt(_block(part) * np.trace(noise) / len(noise)) for part, noise in each])


def _covariance(fit: OptimizeResult, parts: Sequence[Part], noises: Sequence[Array]) -> Array:
    """Return the parameters' covariance (p, p), NaN at a bound, of noise with covariances (m, m) in each part.

    Residuals behind those of the parts are of what parameters are expected to be, each with a covariance (1, 1).
    """
    free = fit.active_mask == 0
    lengths = [len(part.time_s) for part in parts] + [1] * (len(noises) - len(parts))
    jacobians = np.split(fit.jac[:, free], np.cumsum(lengths)[:-1])
    rows = [_thinned(part, own.T).T for part, own in zip(parts, jacobians, strict=False)] + jacobians[len(parts) :]
    blocks = [_block(part) for part in parts] + [1] * (len(noises) - len(parts))
    weight = np.repeat(np.sqrt(blocks), [len(own) for own in rows])
    gain = gain_of(weight[:, np.newaxis] * np.vstack(rows)) * weight
    columns = np.split(gain, np.cumsum([len(own) for own in rows])[:-1], axis=1)
    found = sum(own @ noise @ own.T for own, noise in zip(columns, noises, strict=True))
    covariance = np.full((len(fit.x), len(fit.x)), math.nan)
    covariance[np.ix_(free, free)] = found
    return covariance


def _thinned(part: Part, value: Array) -> Array:
    """Return means (..., m) of neighbouring samples of a step (..., n)."""
    return block_means(value, length=_block(part))


def _block(part: Part) -> int:
    return -(-len(part.time_s) // _MOST)
