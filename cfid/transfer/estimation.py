"""Fit a transfer function with delay to frequency responses: maximum likelihood, and findings.

The delay counts from the time stamps of the commands and may be negative: these stamps are late by the radio's latency,
those of the load cell by a network's. It is never bounded.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.linear import propagated, std_of
from cfid.findings import Finding, rejection, warning
from cfid.transfer.delay_scatter import scatter_findings, search_with_scatter
from cfid.transfer.frequency_response import SETTLE_S, Response, respond
from cfid.transfer.likelihood import (
    Found,
    Shape,
    StackedResponses,
    covariance_of,
    dynamic_unknowns,
    dynamics_of,
    model_at,
    unknowns,
)
from cfid.transfer.model import Complex, Dynamics, Form
from cfid.transfer.sines.alignment import SineSeries
from cfid.transfer.uneven import Uneven, uneven_rates

Array = npt.NDArray[np.float64]

LEAST_PROBABILITY = 1e-3
MISFIT_LIMIT = 0.03
_DISTINCT = 5.0  # standard uncertainties of the static gain from zero: with less, it may be noise
_INSTANT = 0.01  # of a sample: a shorter lag counts as none


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredSeries:
    """Responses of one series, and the mean delay of its reports relative to the fastest, in s.

    `findings` are about runs without a response, which are left out.
    """

    name: str
    responses: tuple[Response, ...]
    mean_lateness_s: float = 0.0
    mean_lateness_std_s: float = 0.0
    findings: tuple[Finding, ...] = ()


class Delay(NamedTuple):
    """The delay of the force's stamps relative to those of the commands, in s, with standard uncertainties.

    `delay_s` counts from the average arrival of the stamps, `after_quickest_s` from the fastest.
    """

    delay_s: float
    std_s: float
    after_quickest_s: float
    after_quickest_std_s: float


class Uncertainties(NamedTuple):
    """Standard uncertainties of the values of `Dynamics` and of the coefficients; the leading 1 has none.

    `covariance` is that of numerator, denominator, static gain, the longest lag and the mean of the delays after the
    fastest stamps, in this order.
    """

    static_gain_n: float
    lags_s: tuple[float, ...]
    lead_s: float
    numerator: Array
    denominator: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferFit:
    """A transfer function common to all series, in one `form` of `model`, and a delay for each.

    `numerator` and `denominator` are in rising powers of z^-1 at `sample_s`. `covariance` belongs to static gain, lags,
    lead (if free) and the series' delays (if free), in this order; it contains the noise, inflated where chi-squared
    exceeds its degrees of freedom, and errors that runs share. `model` (n,) are the model's values for the responses of
    all series in a row. `misfit` is the systematic relative difference between them. `delay_scatter_s` is the scatter
    of delays from run to run; `uneven` describes a motor that slows down and speeds up at different rates, if it does.
    """

    shape: Shape
    form: Form
    sample_s: float
    dynamics: Dynamics
    numerator: Array
    denominator: Array
    std: Uncertainties
    delays: dict[str, Delay]
    covariance: Array
    measured: tuple[MeasuredSeries, ...]
    model: Complex
    chi_squared: float
    degrees_of_freedom: int
    misfit: float
    delay_scatter_s: float = 0.0
    uneven: Uneven | None = None

    @property
    def time_constant_s(self) -> float:
        """The longest lag, in s."""
        return max(self.dynamics.lags_s)

    @property
    def time_constant_std_s(self) -> float:
        """The standard uncertainty of the longest lag, in s."""
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
        """The probability that noise alone makes chi-squared at least as large; 1 without degrees of freedom."""
        return float(chdtrc(self.degrees_of_freedom, self.chi_squared)) if self.degrees_of_freedom > 0 else 1.0

    @property
    def described(self) -> bool:
        """Whether the model describes the responses: within noise, or as well as a motor is linear."""
        return self.probability >= LEAST_PROBABILITY or self.misfit <= MISFIT_LIMIT

    @property
    def has_gain(self) -> bool:
        """Whether the static gain can be distinguished from noise."""
        return abs(self.dynamics.static_gain_n) >= _DISTINCT * self.std.static_gain_n

    @property
    def has_time_constant(self) -> bool:
        """Whether the responses determine a time constant and the delay."""
        return self.time_constant_s >= _INSTANT * self.sample_s

    @property
    def accepted(self) -> bool:
        """Whether the model describes the responses, and they determine its gain and its time constant."""
        return self.described and self.has_gain and self.has_time_constant

    def findings(self, keys: Sequence[str]) -> tuple[Finding, ...]:
        """Return findings against the transfer function with the quantities `keys`."""
        found = [] if self.probability >= LEAST_PROBABILITY else [self._misfit(keys)]
        found += scatter_findings(self.delay_scatter_s, keys)
        found += self.uneven.findings(keys) if self.uneven is not None else ()
        gain_n, std_n = self.dynamics.static_gain_n, self.std.static_gain_n
        if not self.has_gain:
            noise = (
                f"the static gain, {gain_n:.2g} N with a standard uncertainty of {std_n:.2g} N, may be noise alone: "
                "are the channel and the motor those of the runs?"
            )
            found.append(rejection("transfer-gain-is-noise", noise, *keys))
        elif not self.has_time_constant:
            instant = "the responses determine the delay alone, no time constant: record sines over a wider range."
            of_lag = [key for key in keys if not key.endswith(("static_gain_n", "delay_s", "delay_after_quickest_s"))]
            found.append(rejection("transfer-no-time-constant", instant, *of_lag))
        return tuple(found)

    def _misfit(self, keys: Sequence[str]) -> Finding:
        differ = (
            f"chi-squared is {self.chi_squared:.0f} for {self.degrees_of_freedom} degrees of freedom: the responses "
            f"differ from the model by {100 * self.misfit:.2g} % beyond their noise"
        )
        if self.described:
            return warning("transfer-scatter", f"{differ}: the standard uncertainties are widened.", *keys)
        limit = f"(limit {100 * MISFIT_LIMIT:.0f} %): the motor is no such plant, or some runs are wrong."
        return rejection("transfer-misfit", f"{differ} {limit}", *keys)

    def response(self, omega_rad_s: Array, *, series: str | None = None) -> Complex:
        """Return force over commands at frequencies (n,), with a series' delay after its fastest reports, or none."""
        plain = self.dynamics.response(omega_rad_s, sample_s=self.sample_s, form=self.form)
        delay_s = 0.0 if series is None else self.delays[series].after_quickest_s
        return np.asarray(plain * np.exp(-1j * omega_rad_s * delay_s))


def measure(name: str, series: SineSeries, *, form: Form = "hold", settle_s: float = SETTLE_S) -> MeasuredSeries:
    """Return the responses of a series' runs, without runs that have none. Raises FitError when none is left."""
    responses, findings, errors = [], [], []
    for run in series.runs:
        try:
            responses.append(respond(run, settle_s=settle_s, form=form))
        except FitError as error:
            errors.append(error)
            findings.append(warning("sine-without-response", f"{error} The run is left out.", "tf.*"))
    if errors and not responses:
        raise errors[0]
    return MeasuredSeries(
        name=name,
        responses=tuple(responses),
        mean_lateness_s=series.mean_lateness_s,
        mean_lateness_std_s=series.mean_lateness_std_s,
        findings=tuple(findings),
    )


def fit_transfer(measured: Sequence[MeasuredSeries], *, shape: Shape = "first+delay") -> TransferFit:
    """Fit one transfer function to the responses of all series, each with its own delay.

    It has the form in which the responses were computed. Raises FitError for too few responses, or when no transfer
    function follows them.
    """
    count = sum(len(series.responses) for series in measured)
    needed = unknowns(shape, len(measured))
    if 2 * count <= needed or not all(series.responses for series in measured):
        raise FitError(
            f"{counted(count, 'frequency is', 'frequencies are')} too few for a transfer function with "
            f"{needed} parameters: record more sines."
        )
    if len({response.form for series in measured for response in series.responses}) > 1:
        raise FitError("responses of two forms cannot be fitted together: take all of them in one.")
    points, found, scatter_s = search_with_scatter([series.responses for series in measured], shape)
    if not (np.isfinite(found.cost) and np.all(np.isfinite(found.values)) and found.values[0] != 0):
        raise FitError("no transfer function follows these responses: look at the Bode figure.")
    alike = [response for series in measured for response in series.responses]
    uneven = uneven_rates(alike, lag_s=max(dynamics_of(found.values, shape).lags_s))
    if uneven is not None:
        points = points._replace(shared=np.vstack([points.shared, uneven.raised * points.value]))
    return replace(_result(measured, points, shape, found), delay_scatter_s=scatter_s, uneven=uneven)


def _result(measured: Sequence[MeasuredSeries], points: StackedResponses, shape: Shape, found: Found) -> TransferFit:
    degrees_of_freedom = 2 * len(points.value) - len(found.values)
    inner = covariance_of(points, found)
    dynamics, model = dynamics_of(found.values, shape), model_at(points, found.values, shape)
    unit = np.ones(len(found.values))
    unit[1 : 1 + len(dynamics.lags_s)] = dynamics.lags_s  # the derivative of a lag with respect to its logarithm
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
        std=_uncertainties(points, shape, found.values, inner=inner, covariance=covariance),
        delays=_delays(measured, found.values[dynamic_unknowns(shape) :], covariance),
        covariance=covariance,
        measured=tuple(measured),
        model=model,
        chi_squared=found.cost,
        degrees_of_freedom=degrees_of_freedom,
        misfit=math.sqrt(max(found.cost - degrees_of_freedom, 0.0) / size),
    )


def _uncertainties(
    points: StackedResponses, shape: Shape, values: Array, *, inner: Array, covariance: Array
) -> Uncertainties:
    def coefficients(values: Array) -> Array:
        both = dynamics_of(values, shape).coefficients(sample_s=points.sample_s, form=points.form)
        return np.concatenate(both)

    def delivered(values: Array) -> Array:
        dynamics = dynamics_of(values, shape)
        own = values[dynamic_unknowns(shape) :]
        delay_s = float(own.mean()) if len(own) else 0.0
        return np.array([*coefficients(values), dynamics.static_gain_n, max(dynamics.lags_s), delay_s])

    joint = propagated(delivered, values, inner)
    spread, single = std_of(joint)[:-3], std_of(covariance)
    lags = 2 if shape == "second" else 1
    return Uncertainties(
        static_gain_n=float(single[0]),
        lags_s=tuple(single[1 : 1 + lags].tolist()),
        lead_s=float(single[2]) if shape == "zero" else 0.0,
        numerator=spread[: -1 - lags],
        denominator=spread[-1 - lags :],
        covariance=joint,
    )


def _delays(measured: Sequence[MeasuredSeries], found: Array, covariance: Array) -> dict[str, Delay]:
    single = std_of(covariance)[len(covariance) - len(found) :]
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
