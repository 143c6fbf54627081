"""One rotor model of four coefficients for all steps of the command, fitted at once."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares, nnls

from cfid.findings import Finding, rejection, texts
from cfid.motors.steps.checks import EXPLAINED
from cfid.motors.steps.estimation import (
    SMOOTH,
    StepFit,
    block_of,
    covariance_of,
    explained_part,
    fit_each,
    larger_sag,
    moved_by_sag,
)
from cfid.motors.steps.model import CommandStep, Lag, Part, Sag, StepData
from cfid.motors.steps.sag import LoggedBattery

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RotorModel:
    """The rotor model of four coefficients, fitted to all steps at once: see `fit_rotor_model`.

    `rising` and `falling` are (linear in 1/s, quadratic in 1/rad), NaN where no step went that way. A coefficient at
    its bound, zero, has no standard uncertainty (NaN). `covariance` (4, 4) is that of both, rising first, and zero
    where there is none. `rms` is that of the residuals, in rad/s.
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


def fit_rotor_model(
    *,
    time_s: Array,
    value: Array,
    steps: Sequence[CommandStep],
    blur_s: float = 0.0,
    command_row_s: float = 0.0,
    battery: LoggedBattery | None = None,
) -> RotorModel:
    """Fit the rotor model of four coefficients to all steps at once, by output error.

    With w the speed and c the one that the command leads to,

        dw/dt = k1 (c - w) + k2 (c^2 - w^2),

    where k is `rising` where c > w and `falling` elsewhere. In this order the coefficients are the `rotor_dyn_coef` of
    utiasDSL's drone-models (first_principles) and of crazyflow, where speeds are in RPM and k2 is 2 pi / 60 times ours.
    Free parameters are these four, none below zero, so that every speed is stable; a delay; and the speeds at which
    each step begins and to which it leads. Where commands are known in rows `command_row_s` apart, each step has its
    own delay, which differs from the common one by as much as a change within a row makes it. See `fit_steps`.
    """
    data = StepData(time_s, value, steps, blur_s)
    lags, noises = zip(*fit_each(data, battery), strict=True)
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
    more = moved_by_sag(fit, residual(fit.x, [larger_sag(lag.battery) for lag in lags]))
    covariance = covariance_of(fit, data.parts, [*noises, *np.reshape(noise_std**2, (-1, 1, 1))]) + np.outer(more, more)
    left = fit.fun[: len(measured)]
    std, found = np.sqrt(np.diag(covariance)), np.where(fit.active_mask != 0, 0.0, fit.x)
    for first, way in ((1, True), (3, False)):
        if not any(lag.rising == way for lag in lags):
            found[first : first + 2] = std[first : first + 2] = math.nan
    covariance[:, np.isnan(std)] = covariance[np.isnan(std)] = 0.0
    length = round(SMOOTH * lags[0].time_constant_s / data.parts[0].interval_s)
    explained = explained_part(left, np.concatenate([part.value - part.value.mean() for part in data.parts]), length)
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
    """Return the forward differences of the residuals of s steps; each step's `own` parameters change that step only.

    The residuals are those of the steps' values, then those of the expected values of each step's parameters, if any.
    The levels of all steps are moved at once, so hundreds of steps cost a few evaluations instead of two for each.
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


def _noise_std(parts: Sequence[Part], noises: Sequence[Array]) -> Array:
    """Return the standard deviation of single samples of each step (s,), from the covariances (m, m) of their noise."""
    each = zip(parts, noises, strict=True)
    return np.array([math.sqrt(block_of(part) * np.trace(noise) / len(noise)) for part, noise in each])
