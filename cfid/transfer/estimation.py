"""Frequency responses to a transfer function with delay: maximum likelihood, orders compared, and a verdict.

The delay counts from the stamps of the commands and may be negative: these stamps come late by the radio, those of
the load cell by a network. It is never bounded.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.transfer.frequency_response import CUTOFF_HZ, SETTLE_S, Response, respond_all
from cfid.transfer.likelihood import (
    SHAPES,
    Found,
    Points,
    Shape,
    chi_squared_exceeds,
    covariance_of,
    dynamic_unknowns,
    dynamics_of,
    model_at,
    points_of,
    search,
    slopes,
    unknowns,
)
from cfid.transfer.model import Complex, Dynamics, Form
from cfid.transfer.sines.alignment import SineSeries

Array = npt.NDArray[np.float64]

LEAST_PROBABILITY = 1e-3
BELIEVED_MISFIT = 0.03
_FELT = 5.0  # deviations of the static gain from zero: what is closer may be noise
_INSTANT = 0.01  # of a sample: a lag that is shorter is none


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """Responses of one series, and how much later its reports come on average than the quickest."""

    name: str
    responses: tuple[Response, ...]
    mean_lateness_s: float = 0.0
    mean_lateness_std_s: float = 0.0


class Delay(NamedTuple):
    """How much later the force's stamps come than those of the commands; one deviation of each.

    `delay_s` counts from the stamps as they come on average, `after_quickest_s` from the quickest of them.
    """

    delay_s: float
    std_s: float
    after_quickest_s: float
    after_quickest_std_s: float


class Deviations(NamedTuple):
    """One standard deviation of what `Dynamics` and the coefficients hold; the leading 1 has none.

    `covariance` is that of numerator, denominator, static gain, the longest lag and the mean of the delays after the
    quickest stamps, in a row.
    """

    static_gain_n: float
    lags_s: tuple[float, ...]
    lead_s: float
    numerator: Array
    denominator: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferFit:
    """A transfer function common to all series, in the `form` of `transfer_models`, and a delay for each.

    `numerator` and `denominator` are in rising powers of z^-1 at `sample_s`. `covariance` belongs to static gain,
    lags, lead (if free) and the series' delays (if free), in this order: of the noise, inflated where chi-squared
    exceeds its degrees of freedom, and of errors that runs share. `model` (n,) stands beside the responses of all
    series in a row. `misfit` is what is systematic between them, relative.
    """

    shape: Shape
    form: Form
    sample_s: float
    dynamics: Dynamics
    numerator: Array
    denominator: Array
    std: Deviations
    delays: dict[str, Delay]
    covariance: Array
    measured: tuple[Measured, ...]
    model: Complex
    chi_squared: float
    freedom: int
    misfit: float

    @property
    def time_constant_s(self) -> float:
        """The longest lag."""
        return max(self.dynamics.lags_s)

    @property
    def time_constant_std_s(self) -> float:
        """One standard deviation of that."""
        return self.std.lags_s[int(np.argmax(self.dynamics.lags_s))]

    @property
    def mean_delay(self) -> Delay:
        """The mean of the series' delays, which share the errors of gain and lags."""
        own, count = list(self.delays.values()), len(self.delays)
        shared = 0.0 if self.shape == "first" else float(self.covariance[-count:, -count:].sum())
        after_std_s = math.sqrt(max(shared, 0.0)) / count
        lateness_std_s = math.hypot(*(series.mean_lateness_std_s for series in self.measured)) / count
        return Delay(
            delay_s=sum(delay.delay_s for delay in own) / count,
            std_s=math.hypot(after_std_s, lateness_std_s),
            after_quickest_s=sum(delay.after_quickest_s for delay in own) / count,
            after_quickest_std_s=after_std_s,
        )

    @property
    def probability(self) -> float:
        """How likely noise alone makes chi-squared as large."""
        return chi_squared_exceeds(self.chi_squared, freedom=self.freedom)

    @property
    def described(self) -> bool:
        """Whether the responses are those of the model: within noise, or as well as a motor is linear."""
        return self.probability >= LEAST_PROBABILITY or self.misfit <= BELIEVED_MISFIT

    @property
    def believed(self) -> bool:
        """Whether the model describes the responses, and these tell a gain and a time constant."""
        return self.described and not self._untold

    @property
    def doubts(self) -> tuple[str, ...]:
        """Return, as sentences, where the model does not describe the responses, or these tell nothing of it."""
        if self.probability >= LEAST_PROBABILITY:
            return self._untold
        verdict = "deviations are widened" if self.described else "the motor is no such plant, or some runs are wrong"
        return (
            f"chi-squared is {self.chi_squared:.0f} for {self.freedom} degrees of freedom: the responses differ from "
            f"the model by {100 * self.misfit:.2g} % beyond their noise: {verdict}.",
            *self._untold,
        )

    @property
    def _untold(self) -> tuple[str, ...]:
        gain_n, std_n = self.dynamics.static_gain_n, self.std.static_gain_n
        if abs(gain_n) < _FELT * std_n:
            return (
                f"the static gain, {gain_n:.2g} +- {std_n:.2g} N, may be noise alone: are --channel and the motor "
                "those of the runs?",
            )
        if self.time_constant_s < _INSTANT * self.sample_s:
            return ("the responses tell no time constant, the delay alone: record sines over a wider range.",)
        return ()

    def response(self, omega_rad_s: Array, *, series: str | None = None) -> Complex:
        """Return force over commands at frequencies (n,), with a series' delay after its quickest reports, or none."""
        plain = self.dynamics.response(omega_rad_s, sample_s=self.sample_s, form=self.form)
        delay_s = 0.0 if series is None else self.delays[series].after_quickest_s
        return np.asarray(plain * np.exp(-1j * omega_rad_s * delay_s))


def measure(
    name: str, series: SineSeries, *, form: Form = "hold", settle_s: float = SETTLE_S, cutoff_hz: float = CUTOFF_HZ
) -> tuple[Measured, list[str]]:
    """Return the responses of a series' runs, and a sentence for each run that was left out."""
    responses, said = respond_all(series, form=form, settle_s=settle_s, cutoff_hz=cutoff_hz)
    measured = Measured(
        name=name,
        responses=tuple(responses),
        mean_lateness_s=series.mean_lateness_s,
        mean_lateness_std_s=series.mean_lateness_std_s,
    )
    return measured, said


def fit_transfer(measured: Sequence[Measured], *, shape: Shape = "first+delay") -> TransferFit:
    """Fit one transfer function to the responses of all series, each with its own delay.

    Its form is that in which the responses were taken. Raises FitError for too few responses, or when no transfer
    function follows them.
    """
    count = sum(len(series.responses) for series in measured)
    needed = unknowns(shape, len(measured))
    if 2 * count <= needed or not all(series.responses for series in measured):
        raise FitError(
            f"{count} frequencies are too few for a transfer function with {needed} parameters: record more sines."
        )
    if len({response.form for series in measured for response in series.responses}) > 1:
        raise FitError("responses of two forms cannot be fitted together: take all of them in one.")
    points = points_of([series.responses for series in measured])
    found = search(points, shape)
    if not (np.isfinite(found.cost) and np.all(np.isfinite(found.values)) and found.values[0] != 0):
        raise FitError("no transfer function follows these responses: look at the Bode figure.")
    return _result(measured, points, shape, found)


def fit_each(measured: Sequence[Measured], *, shape: Shape = "first+delay") -> dict[str, TransferFit]:
    """Fit a transfer function to each series for itself."""
    return {series.name: fit_transfer([series], shape=shape) for series in measured}


def fit_orders(measured: Sequence[Measured]) -> dict[Shape, TransferFit]:
    """Fit each shape that the responses suffice for."""
    count = sum(len(series.responses) for series in measured)
    fitting = [shape for shape in SHAPES if 2 * count > unknowns(shape, len(measured)) + 1]
    return {shape: fit_transfer(measured, shape=shape) for shape in fitting}


def corrected_aic(fits: dict[Shape, TransferFit]) -> dict[Shape, float]:
    """Return the corrected AIC of each shape, less the least: the smallest is to be preferred.

    Chi-squared counts in units of that of the shape that fits best, where this is above 1: what no shape follows is
    scatter (K. P. Burnham, D. R. Anderson, Model selection and multimodel inference, 2002, QAICc).
    """
    scale = max(1.0, min(fit.chi_squared / max(fit.freedom, 1) for fit in fits.values()))
    scores = {}
    for shape, fit in fits.items():
        taken = len(fit.covariance)
        correction = 1 + (taken + 1) / max(fit.freedom - 1, 1)
        scores[shape] = fit.chi_squared / scale + 2 * taken * correction
    least = min(scores.values())
    return {shape: score - least for shape, score in scores.items()}


def _result(measured: Sequence[Measured], points: Points, shape: Shape, found: Found) -> TransferFit:
    freedom = 2 * len(points.value) - len(found.values)
    inner = covariance_of(points, found)
    dynamics, model = dynamics_of(found.values, shape), model_at(points, found.values, shape)
    unit = np.ones(len(found.values))
    unit[1 : 1 + len(dynamics.lags_s)] = dynamics.lags_s  # logarithms to lags
    covariance = np.asarray(inner * np.outer(unit, unit))
    numerator, denominator = dynamics.coefficients(sample_s=points.sample_s, form=points.form)
    size = float(np.sum(np.abs(model) ** 2 * np.abs(np.linalg.det(points.whitener))))
    return TransferFit(
        shape=shape,
        form=points.form,
        sample_s=points.sample_s,
        dynamics=dynamics,
        numerator=numerator,
        denominator=denominator,
        std=_deviations(points, shape, found.values, inner=inner, covariance=covariance),
        delays=_delays(measured, found.values[dynamic_unknowns(shape) :], covariance),
        covariance=covariance,
        measured=tuple(measured),
        model=model,
        chi_squared=found.cost,
        freedom=freedom,
        misfit=math.sqrt(max(found.cost - freedom, 0.0) / size),
    )


def _deviations(points: Points, shape: Shape, values: Array, *, inner: Array, covariance: Array) -> Deviations:
    def coefficients(values: Array) -> Array:
        both = dynamics_of(values, shape).coefficients(sample_s=points.sample_s, form=points.form)
        return np.concatenate(both)

    def delivered(values: Array) -> Array:
        dynamics = dynamics_of(values, shape)
        own = values[dynamic_unknowns(shape) :]
        delay_s = float(own.mean()) if len(own) else 0.0
        return np.array([*coefficients(values), dynamics.static_gain_n, max(dynamics.lags_s), delay_s])

    outward = slopes(delivered, values)
    joint = np.asarray(outward @ inner @ outward.T)
    spread = np.sqrt(np.maximum(np.diag(joint)[:-3], 0.0))
    single = np.sqrt(np.diag(covariance))
    lags = 2 if shape == "second" else 1
    return Deviations(
        static_gain_n=float(single[0]),
        lags_s=tuple(single[1 : 1 + lags].tolist()),
        lead_s=float(single[2]) if shape == "zero" else 0.0,
        numerator=spread[: -1 - lags],
        denominator=spread[-1 - lags :],
        covariance=joint,
    )


def _delays(measured: Sequence[Measured], found: Array, covariance: Array) -> dict[str, Delay]:
    single = np.sqrt(np.diag(covariance))[len(covariance) - len(found) :]
    pairs = zip(found, single, strict=True) if len(found) else [(0.0, 0.0)] * len(measured)
    return {
        series.name: Delay(
            delay_s=float(after - series.mean_lateness_s),
            std_s=math.hypot(std, series.mean_lateness_std_s),
            after_quickest_s=float(after),
            after_quickest_std_s=float(std),
        )
        for series, (after, std) in zip(measured, pairs, strict=True)
    }
