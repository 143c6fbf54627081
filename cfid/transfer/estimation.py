"""Fit a transfer function with delay to the responses of sine runs: maximum likelihood, its findings, and its shape.

The cost is the sum of |H_k - G(f_k)|^2 over variances, for all series at once; it is chi-squared if the model holds (R.
Pintelon, J. Schoukens, System identification: a frequency domain approach, 2012). The delay counts from the time stamps
of the commands and may be negative: these stamps are late by the radio's latency, those of the load cell by a
network's. It is never bounded. Three errors of clocks are nuisance parameters: the start of each run, what all runs on
one clock share, and the rate of the load cell's clock.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq, least_squares
from scipy.special import chdtrc

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.linear import fit_linear, gain_of, propagated, std_of
from cfid.findings import Finding, note, rejection, warning
from cfid.transfer.alignment import RecordedSine, Sign, SineSeries, align, with_end
from cfid.transfer.frequency_response import Response, respond
from cfid.transfer.model import Array, Complex, TransferFunction
from cfid.transfer.plan import CUTOFF_HZ, above_cutoff

Shape = Literal["first", "first+delay", "second", "zero"]

SHAPES: tuple[Shape, ...] = ("first", "first+delay", "second", "zero")
LEAST_PROBABILITY = 1e-3
MISFIT_LIMIT = 0.03

_CLOCK_STD = 3e-4  # of a load cell's clock before the sines are seen: that of a resonator without a crystal
_EXACT = 1e-4  # of a response: no plant is linear more exactly than this
_SCANNED_S = np.arange(-0.2, 0.2, 0.002)  # delays, as initial values
_SCANNED_LAGS_S = np.geomspace(0.002, 2.0, 60)
_SECOND_LAG = (0.03, 0.3)  # of the first lag, as initial values
_SCATTER = 4.0  # the least decrease of the deviance by delays that differ from run to run
_DISTINCT = 5.0  # standard uncertainties of the static gain from zero: with less, it may be noise
_INSTANT = 0.01  # of a sample: a shorter lag counts as none
_BETTER = 10.0  # of corrected AIC
_UNEVEN_IN_STD, _UNEVEN = 3.0, 0.05  # the least difference of rates: in its standard uncertainty, and of the rate


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredSeries:
    """Responses of one series, and the mean delay of its reports relative to the fastest, in s.

    `findings` are about runs without a response, which are left out. `skew` is the excess of the load cell's clock over
    the host's, with its standard uncertainty, by the frequencies of the sines.
    """

    name: str
    responses: tuple[Response, ...]
    mean_lateness_s: float = 0.0
    mean_lateness_std_s: float = 0.0
    skew: float = 0.0
    skew_std: float = 1e-9
    findings: tuple[Finding, ...] = ()


class Delay(NamedTuple):
    """The delay of the force's stamps relative to those of the commands, in s, with standard uncertainties.

    `delay_s` counts from the average arrival of the stamps, `after_quickest_s` from the fastest.
    """

    delay_s: float
    std_s: float
    after_quickest_s: float
    after_quickest_std_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferFit:
    """A transfer function common to all series, and a delay for each.

    `values` are static gain, lags, lead (if free) and the series' delays after the fastest reports (if free), and
    `covariance` is theirs: it contains the noise, inflated where chi-squared exceeds its degrees of freedom, and errors
    that runs share. `joint` is the covariance of numerator, denominator, static gain, the longest lag and the mean of
    these delays; the `mean_delay` of series shares the errors of gain and lags. `model` (n,) are the model's values for
    the responses of all series in a row. `misfit` is the systematic relative difference between them.
    `delay_scatter_s` is the scatter of delays from run to run; `lag_ratio` is the downward time constant over the
    upward one, 1 unless they clearly differ.
    """

    shape: Shape
    function: TransferFunction
    values: Array
    covariance: Array
    joint: Array
    delays: Mapping[str, Delay]
    mean_delay: Delay
    measured: tuple[MeasuredSeries, ...]
    model: Complex
    chi_squared: float
    degrees_of_freedom: int
    misfit: float
    delay_scatter_s: float = 0.0
    lag_ratio: float = 1.0

    @property
    def gain_n(self) -> float:
        """The static gain in N per unit of the command."""
        return float(self.values[0])

    @property
    def std(self) -> Array:
        """The standard uncertainties of `values`."""
        return std_of(self.covariance)

    @property
    def lags_s(self) -> Array:
        """The lags in s."""
        return self.values[1 : 1 + _lags(self.shape)]

    @property
    def time_constant_s(self) -> float:
        """The longest lag, in s."""
        return float(self.lags_s.max())

    @property
    def time_constant_std_s(self) -> float:
        """The standard uncertainty of the longest lag, in s."""
        return float(self.std[1 + int(self.lags_s.argmax())])

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
        return abs(self.gain_n) >= _DISTINCT * float(self.std[0])

    @property
    def has_time_constant(self) -> bool:
        """Whether the responses determine a time constant and the delay."""
        return self.time_constant_s >= _INSTANT * self.function.sample_s

    @property
    def accepted(self) -> bool:
        """Whether the model describes the responses, and they determine its gain and its time constant."""
        return self.described and self.has_gain and self.has_time_constant

    def findings(self, keys: Sequence[str]) -> tuple[Finding, ...]:
        """Return findings against the transfer function with the quantities `keys`."""
        findings = []
        if self.probability < LEAST_PROBABILITY:
            differ = (
                f"chi-squared is {self.chi_squared:.0f} for {self.degrees_of_freedom} degrees of freedom: the "
                f"responses differ from the model by {100 * self.misfit:.2g} % beyond their noise"
            )
            limit = f"(limit {100 * MISFIT_LIMIT:.0f} %): the motor is no such plant, or some runs are wrong."
            if self.described:
                text = f"{differ}: the standard uncertainties are widened."
                findings.append(warning("transfer-scatter", text, *keys))
            else:
                findings.append(rejection("transfer-misfit", f"{differ} {limit}", *keys))
        if self.delay_scatter_s:
            text = (
                f"delays differ by {1e3 * self.delay_scatter_s:.1f} ms from run to run (standard deviation), as where "
                "the radio's shortest latency wanders: the standard uncertainties contain it."
            )
            findings.append(warning("transfer-delays-scatter", text, *keys))
        if self.lag_ratio != 1:
            text = (
                "the sines' second harmonic shows a motor whose time constant is "
                f"{self.lag_ratio:.2f} times as long downwards as upwards: no linear transfer function follows it, "
                "and the standard uncertainties contain by how much it misses. `cfid fit dynamics` gives both time "
                "constants."
            )
            findings.append(warning("transfer-uneven-lag", text, *keys))
        if not self.has_gain:
            text = (
                f"the static gain, {self.gain_n:.2g} N with a standard uncertainty of {self.std[0]:.2g} N, may be "
                "noise alone: are the channel and the motor those of the runs?"
            )
            findings.append(rejection("transfer-gain-is-noise", text, *keys))
        elif not self.has_time_constant:
            text = "the responses determine the delay alone, no time constant: record sines over a wider range."
            of_lag = [key for key in keys if not key.endswith(("static_gain_n", "delay_s", "delay_after_quickest_s"))]
            findings.append(rejection("transfer-no-time-constant", text, *of_lag))
        return tuple(findings)

    def function_at(self, values: Array) -> TransferFunction:
        """Return the transfer function of gain, lags and lead, without a delay."""
        return _function(values, self.shape, self.function.sample_s)

    def response(self, omega_rad_s: Array) -> Complex:
        """Return force over commands at frequencies (n,), of the force itself at any instant, without delay."""
        return _plant(self.values, self.shape, omega_rad_s, self.function.sample_s)


class _Data(NamedTuple):
    """Responses of all series in a row (n,), the series of each, and matrices (n, 2, 2) that whiten their residuals.

    `shared` (m, n) is the change of each response by one standard uncertainty of each error that several runs share.
    `since_s` (n,) is the time that each run's load cell had run, and `skews` (s, 2) are the excess of its clock in each
    series, before the fit, and the standard uncertainty.
    """

    responses: list[Response]
    omega: Array
    value: Complex
    series: npt.NDArray[np.intp]
    whitener: Array
    shared: Complex
    sample_s: float
    since_s: Array
    skews: Array


class _Solution(NamedTuple):
    """Gain, lags, lead and delays if free, and clocks (p,); the residuals' Jacobian (2n + s, p), and their square."""

    values: Array
    jacobian: Array
    cost: float


def measure(name: str, series: SineSeries) -> MeasuredSeries:
    """Return the responses of a series' runs, without runs that have none. Raises FitError when none is left.

    The load cell's clock may run faster than the host's, with which it agrees at its first stamp: the sines'
    frequencies by its stamps show by how much.
    """
    responses, findings, errors = [], [], []
    for run in series.runs:
        try:
            responses.append(respond(run))
        except FitError as error:
            errors.append(error)
            findings.append(warning("sine-without-response", f"{error} The run is left out.", "tf.*"))
    if errors and not responses:
        raise errors[0]
    weights = np.array([response.skew_std for response in responses]) ** -2.0
    total = float(weights.sum()) + _CLOCK_STD**-2
    return MeasuredSeries(
        name=name,
        responses=tuple(responses),
        mean_lateness_s=series.mean_lateness_s,
        mean_lateness_std_s=series.mean_lateness_std_s,
        skew=float(weights @ [response.skew for response in responses]) / total,
        skew_std=total**-0.5,
        findings=tuple(findings),
    )


def unknowns(shape: Shape, series_count: int) -> int:
    """Return the number of free parameters."""
    return _dynamic(shape) + (0 if shape == "first" else series_count)


def fit_transfer(measured: Sequence[MeasuredSeries], *, shape: Shape = "first+delay") -> TransferFit:
    """Fit one transfer function to the responses of all series, each with its own delay.

    Raises FitError for too few responses, or when no transfer function follows them.
    """
    count = sum(len(series.responses) for series in measured)
    needed = unknowns(shape, len(measured))
    if 2 * count <= needed or not all(series.responses for series in measured):
        raise FitError(
            f"{counted(count, 'frequency is', 'frequencies are')} too few for a transfer function with "
            f"{needed} parameters: record more sines."
        )
    data, solution, scatter_s = _solve_with_scatter(measured, shape)
    values, dynamic = solution.values[:needed], _dynamic(shape)
    if not (np.isfinite(solution.cost) and np.all(np.isfinite(values)) and values[0] != 0):
        raise FitError("no transfer function follows these responses: look at the Bode figure.")
    excess, raised = _excess_of_rise(data, lag_s=float(values[1 : 1 + _lags(shape)].max()))
    data = data._replace(shared=np.vstack([data.shared, raised * data.value]))
    freedom = 2 * len(data.value) - needed
    covariance = _covariance(data, solution)[:needed, :needed]

    def delivered(values: Array) -> Array:
        function = _function(values, shape, data.sample_s)
        delay_s = float(values[dynamic:].mean()) if len(values) > dynamic else 0.0
        lag_s = float(values[1 : 1 + _lags(shape)].max())
        return np.array([*function.numerator, *function.denominator, values[0], lag_s, delay_s])

    model = _model(data, solution.values, shape)
    size = float(np.sum(np.abs(model) ** 2 * np.abs(np.linalg.det(data.whitener))))
    joint = propagated(delivered, values, covariance)
    after_s = values[dynamic:] if needed > dynamic else np.zeros(len(measured))
    after_std_s = std_of(covariance)[dynamic:] if needed > dynamic else after_s
    delays = [
        _delay(float(after), float(std), series.mean_lateness_s, series.mean_lateness_std_s)
        for series, after, std in zip(measured, after_s, after_std_s, strict=True)
    ]
    mean = _delay(
        float(after_s.mean()),
        math.sqrt(max(float(joint[-1, -1]), 0.0)),
        sum(series.mean_lateness_s for series in measured) / len(measured),
        math.hypot(*(series.mean_lateness_std_s for series in measured)) / len(measured),
    )
    return TransferFit(
        shape=shape,
        function=replace(
            _function(values, shape, data.sample_s),
            delay_s=mean.delay_s,
            delay_std_s=mean.after_quickest_std_s,
            after_quickest_s=mean.after_quickest_s,
        ),
        values=values,
        covariance=covariance,
        joint=joint,
        delays={series.name: delay for series, delay in zip(measured, delays, strict=True)},
        mean_delay=mean,
        measured=tuple(measured),
        model=model,
        chi_squared=solution.cost,
        degrees_of_freedom=freedom,
        misfit=math.sqrt(max(solution.cost - freedom, 0.0) / size),
        delay_scatter_s=scatter_s,
        lag_ratio=(1 + excess) / (1 - excess),
    )


def _lags(shape: Shape) -> int:
    return 2 if shape == "second" else 1


def _dynamic(shape: Shape) -> int:
    """Return the number of free parameters that are not delays."""
    return 2 if shape.startswith("first") else 3


def _function(values: Array, shape: Shape, sample_s: float) -> TransferFunction:
    """Return the transfer function of gain, lags and lead, without a delay."""
    gain_n, *lags_s = values[: 1 + _lags(shape)]
    lead_s = float(values[2]) if shape == "zero" else 0.0
    return TransferFunction.of_lags(gain_n, lags_s, lead_s=lead_s, sample_s=sample_s)


def _plant(values: Array, shape: Shape, omega: Array, sample_s: float) -> Complex:
    """Return the held plant's response at frequencies (n,), with the hold's attenuation and without delay."""
    half = omega * sample_s / 2
    plant = values[0] * np.sinc(half / np.pi) * np.exp(-1j * half)
    for lag_s in values[1 : 1 + _lags(shape)]:
        plant = plant / (1 + 1j * omega * lag_s)
    return np.asarray(plant * (1 + 1j * omega * values[2]) if shape == "zero" else plant)


def _model(data: _Data, values: Array, shape: Shape) -> Complex:
    """Return the model's responses (n,), each with its series' delay."""
    plant = _plant(values, shape, data.omega, data.sample_s)
    late_s = values[-len(data.skews) :][data.series] * data.since_s
    if shape != "first":
        late_s = late_s + values[_dynamic(shape) :][data.series]
    return np.asarray(plant * np.exp(-1j * data.omega * late_s))


def _stacked(measured: Sequence[MeasuredSeries], *, scatter_s: float = 0.0) -> _Data:
    """Put the responses of all series in a row; `scatter_s` is the standard deviation of delays from run to run."""
    responses = [response for series in measured for response in series.responses]
    value = np.array([response.value for response in responses])
    omega = np.array([response.frequency_rad_s for response in responses])
    along = np.stack([-value.imag, value.real], axis=1)  # the direction in which a late start moves the response
    turned = along * (omega * np.hypot([response.start_std_s for response in responses], scatter_s))[:, None]
    noise = np.array([response.covariance for response in responses])
    noise = noise + ((_EXACT * np.abs(value)) ** 2)[:, None, None] * np.eye(2)
    numbers = np.repeat(np.arange(len(measured)), [len(series.responses) for series in measured])
    shared: dict[tuple[int, str], Array] = {}
    for place, (number, response) in enumerate(zip(numbers.tolist(), responses, strict=True)):
        for name, shift_s in response.shared_s.items():
            shared.setdefault((number, name), np.zeros(len(responses)))[place] = shift_s
    return _Data(
        responses=responses,
        omega=omega,
        value=value,
        series=numbers,
        whitener=np.linalg.inv(np.linalg.cholesky(noise + turned[:, :, None] * turned[:, None, :])),
        shared=np.array([*shared.values()]).reshape(-1, len(responses)) * -1j * omega * value,
        sample_s=float(np.mean([response.sample_s for response in responses])),
        since_s=np.array([response.since_s for response in responses]),
        skews=np.array([[series.skew, series.skew_std] for series in measured]),
    )


def _whitened(data: _Data, apart: Complex) -> Array:
    """Return differences of responses (n,) over their uncertainties, real and imaginary parts alternating (2n,)."""
    return np.asarray((data.whitener @ np.stack([apart.real, apart.imag], axis=1)[:, :, None]).ravel())


def _solve(data: _Data, shape: Shape, *, polar: bool = False) -> _Solution:
    """Return the parameters with the least cost; `polar` compares sizes and phases, which no late start mixes."""
    solutions = [_minimise(data, shape, guess, polar=polar) for guess in _guesses(data, shape)]
    return min(solutions, key=lambda solution: solution.cost)


def _minimise(data: _Data, shape: Shape, guess: Array, *, polar: bool) -> _Solution:
    """Return the least-squares solution from a start; lags, which are positive, go by their logarithms."""
    clocks, lags = len(data.skews), slice(1, 1 + _lags(shape))
    unit = np.array([guess[0], *np.ones(len(guess) - 1 - clocks), *np.full(clocks, _CLOCK_STD)])

    def values_at(scaled: Array) -> Array:
        values = scaled * unit
        values[lags] = np.exp(np.clip(scaled[lags], -20, 20))
        return np.asarray(values)

    def residual(scaled: Array) -> Array:
        values = values_at(scaled)
        model = _model(data, values, shape)
        apart = data.value * np.log(data.value / model) if polar else data.value - model
        return np.concatenate([_whitened(data, apart), (values[-clocks:] - data.skews[:, 0]) / data.skews[:, 1]])

    start = guess / unit
    start[lags] = np.log(guess[lags])
    found = least_squares(residual, start, jac="3-point", x_scale="jac", xtol=1e-10, ftol=1e-10, gtol=1e-10)
    values = values_at(found.x)
    slope = unit.copy()
    slope[lags] = values[lags]
    return _Solution(values, found.jac / slope, 2 * float(found.cost))


def _guesses(data: _Data, shape: Shape) -> list[Array]:
    """Return starting points: the best lag and delay of a grid for each series, with the gain that belongs to it."""
    best = []
    for number in range(int(data.series.max()) + 1):
        rows = data.series == number
        omega, weight = data.omega[rows], np.abs(np.linalg.det(data.whitener[rows]))
        scanned_s = np.zeros(1) if shape == "first" else _SCANNED_S
        plants = np.array([_plant(np.array([1.0, lag_s]), "first", omega, data.sample_s) for lag_s in _SCANNED_LAGS_S])
        matched = ((plants.conj() * weight) @ (data.value[rows] * np.exp(1j * omega * scanned_s[:, None])).T).real
        power = (np.abs(plants) ** 2 @ weight)[:, None]
        lag, delay = np.unravel_index(int((matched**2 / power).argmax()), matched.shape)
        best.append((float(matched[lag, delay] / power[lag, 0]), float(_SCANNED_LAGS_S[lag]), float(scanned_s[delay])))
    gain_n, lag_s = np.mean([one[0] for one in best]), np.mean([one[1] for one in best])
    delays = [] if shape == "first" else [one[2] for one in best]
    more: list[list[float]] = [[]]
    if shape == "second":
        more = [[float(lag_s * share)] for share in _SECOND_LAG]
    elif shape == "zero":
        more = [[0.0]]
    return [np.array([gain_n, lag_s, *extra, *delays, *data.skews[:, 0]]) for extra in more]


def _covariance(data: _Data, solution: _Solution) -> Array:
    """Return the covariance of the parameters (p, p): noise, inflated by its scatter, and shared errors."""
    inverse = gain_of(solution.jacobian)
    count, taken = solution.jacobian.shape
    covariance = inverse @ inverse.T * max(1.0, solution.cost / max(count - taken, 1))
    for turned in data.shared:
        moved = inverse[:, : 2 * len(data.value)] @ _whitened(data, turned)
        covariance += np.outer(moved, moved)
    return np.asarray(covariance)


def _solve_with_scatter(measured: Sequence[MeasuredSeries], shape: Shape) -> tuple[_Data, _Solution, float]:
    """Return the data, their solution, and the scatter of delays from run to run in s, zero unless significant.

    Where the radio's shortest latency changes between runs, responses are rotated by angles that grow with frequency;
    noise changes their sizes as much. The scatter explains the rotations that were seen (R. C. Paule, J. Mandel,
    Consensus values and weighting factors, Journal of Research of the National Bureau of Standards 87, 1982).
    """
    data = _stacked(measured)
    alone = data, _solve(data, shape), 0.0
    freedom = 2 * len(data.value) - unknowns(shape, len(measured))
    if shape == "first" or chdtrc(freedom, alone[1].cost) > LEAST_PROBABILITY:
        return alone
    solution, scatter_s, taken = alone[1], 0.0, unknowns(shape, len(measured)) - 1
    for _ in range(3):
        scatter_s = _delay_scatter_s(data.responses, _model(data, solution.values, shape), taken)
        data = _stacked(measured, scatter_s=scatter_s)
        solution = _solve(data, shape, polar=True)
    return (data, solution, scatter_s) if _deviance(data, solution) + _SCATTER < _deviance(*alone[:2]) else alone


def _delay_scatter_s(responses: Sequence[Response], model: Complex, taken: int) -> float:
    """Return the standard deviation in s of delays (n,) about a model beyond the uncertainties that are known."""
    omega = np.array([response.frequency_rad_s for response in responses])
    late_s = np.angle(model / np.array([response.value for response in responses])) / omega
    known = (np.array([response.polar_std[1] for response in responses]) / omega) ** 2
    freedom = len(late_s) - taken

    def excess(variance: float) -> float:
        return float(np.sum(late_s**2 / (known + variance))) - freedom

    if freedom < 1 or excess(0.0) <= 0:
        return 0.0
    return math.sqrt(brentq(excess, 0.0, float(np.sum(late_s**2)) / freedom))


def _deviance(data: _Data, solution: _Solution) -> float:
    """Return minus twice the logarithm of the likelihood, less a constant, with the noise inflated by its scatter."""
    count = len(solution.jacobian)
    inflation = max(1.0, solution.cost / max(count - len(solution.values), 1))
    determined = float(np.sum(np.log(np.abs(np.linalg.det(data.whitener)))))
    return count * math.log(inflation) + solution.cost / inflation - 2 * determined


def _excess_of_rise(data: _Data, *, lag_s: float) -> tuple[float, Array]:
    """Return the excess e of the upward rate over the mean rate, and the part that it adds to each response (n,).

    Both are zero unless the second harmonics show it. With rates r (1 + e) up and r (1 - e) down, a speed that follows
    a sine gets a second harmonic in quadrature to that of the thrust, which is proportional to the square of the speed.
    Its mean rises by 2 e / pi of the amplitude by which it lags behind the command, and the thrust of the sine with it:
    more at high frequencies, as with a shorter time constant.
    """
    even = 0.0, np.zeros(len(data.value))
    if len(data.value) < 3:
        return even
    lagged, size = lag_s * data.omega, np.abs(data.value)
    second = np.array([response.second for response in data.responses])
    weight = np.tile(size / [response.std for response in data.responses], 2)
    of_rates = -4 / (3 * math.pi) * lagged / (1 + 2j * lagged)
    rows = np.vstack([np.stack([size, of_rates.real], axis=1), np.stack([0 * size, of_rates.imag], axis=1)])
    fit = fit_linear(rows * weight[:, np.newaxis], np.append(second.real, second.imag) * weight, noise_known=False)
    (bent, excess), excess_std = fit.values.tolist(), float(fit.std[1])
    if not max(_UNEVEN_IN_STD * excess_std, _UNEVEN) <= abs(excess) < 1:
        return even
    return excess, excess * 8 / math.pi * lagged * bent * size


def _delay(after_quickest_s: float, after_std_s: float, lateness_s: float, lateness_std_s: float) -> Delay:
    std_s = math.hypot(after_std_s, lateness_std_s)
    return Delay(after_quickest_s - lateness_s, std_s, after_quickest_s, after_std_s)


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """One transfer function for all series, and one for each of several; the shapes' corrected AIC above the least.

    `used` are the runs of the `aligned` series, in the same order. `findings` are those about runs, series and shapes;
    each fit has its own.
    """

    fit: TransferFit
    each: dict[str, TransferFit]
    aicc: dict[Shape, float]
    aligned: dict[str, SineSeries]
    used: dict[str, list[RecordedSine]]
    findings: tuple[Finding, ...]


def identify(
    series: Mapping[str, Sequence[RecordedSine]],
    *,
    shape: Shape | Literal["auto"] = "first+delay",
    sign: Sign = "auto",
) -> Identified:
    """Identify all series together and each of several by itself, from sines up to the cut-off.

    Shape "auto" selects the one with the least corrected AIC. Raises
    DataError and FitError with a run's name.
    """
    findings = []
    used = {}
    for name, runs in series.items():
        if above := above_cutoff([run.sine for run in runs]):
            findings.append(note("sine-too-fast", f"{above} left out.", "tf.*").at(name))
        kept, without_end = with_end([run for run in runs if run.sine.periods and not run.sine.is_above(CUTOFF_HZ)])
        findings += without_end
        if kept:
            used[name] = kept
    if not used:
        raise FitError(f"no sine run is left up to {CUTOFF_HZ:g} Hz: record slower ones.")
    aligned = {name: align(runs, sign=sign) for name, runs in used.items()}
    measured = [measure(name, runs) for name, runs in aligned.items()]
    for name, responses in zip(aligned, measured, strict=True):
        findings += [*aligned[name].findings, *responses.findings]
    fits = fit_shapes(measured)
    aicc = corrected_aic(fits) if fits else {}
    usual: Shape = "first+delay" if shape == "auto" else shape
    chosen = min(aicc, key=lambda shape: aicc[shape]) if shape == "auto" and aicc else usual
    fit = fits.get(chosen) or fit_transfer(measured, shape=chosen)
    each = {}
    for one in measured if len(measured) > 1 else []:
        try:
            each[one.name] = fit_transfer([one], shape=chosen)
        except FitError as error:
            against = rejection("series-not-fitted", str(error), f"tf.series.{one.name}.*")
            findings.append(against.at(f"{one.name} for itself"))
    if aicc.get(chosen, 0.0) >= _BETTER:
        best = min(aicc, key=lambda shape: aicc[shape])
        text = (
            f"'{best}' describes the responses clearly better than '{chosen}' (corrected AIC {aicc[chosen]:.0f} less)."
        )
        findings.append(warning("transfer-better-shape", text, "tf.*"))
    return Identified(fit=fit, each=each, aicc=aicc, aligned=aligned, used=used, findings=tuple(findings))


def fit_shapes(measured: Sequence[MeasuredSeries]) -> dict[Shape, TransferFit]:
    """Fit each shape that has fewer parameters than the responses have real and imaginary parts."""
    count = sum(len(series.responses) for series in measured)
    fitting = [shape for shape in SHAPES if 2 * count > unknowns(shape, len(measured)) + 1]
    return {shape: fit_transfer(measured, shape=shape) for shape in fitting}


def corrected_aic(fits: dict[Shape, TransferFit]) -> dict[Shape, float]:
    """Return the corrected AIC of each shape, less the least: the shape with the smallest value is preferred.

    Chi-squared is divided by that of the best-fitting shape per degree of freedom, where this is above 1: what no shape
    describes is scatter (K. P. Burnham, D. R. Anderson, Model selection and multimodel inference, 2002, QAICc).
    """
    scale = max(1.0, min(fit.chi_squared / max(fit.degrees_of_freedom, 1) for fit in fits.values()))
    scores = {}
    for shape, fit in fits.items():
        taken = len(fit.covariance)
        correction = 1 + (taken + 1) / max(fit.degrees_of_freedom - 1, 1)
        scores[shape] = fit.chi_squared / scale + 2 * taken * correction
    least = min(scores.values())
    return {shape: score - least for shape, score in scores.items()}
