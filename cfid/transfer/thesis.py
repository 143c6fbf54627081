"""Identify a transfer function by the thesis method (section 3.4.3, appendix C.2.5), with its constants as settings.

Times are used as stamped: the latencies of radio and load cell are neglected, which the thesis regrets and which biases
its time constant. Nothing here corrects for that.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.findings import Finding, note, rejection, warning
from cfid.transfer.alignment import RecordedSine, Sign
from cfid.transfer.model import TransferFunction
from cfid.transfer.plan import SAMPLE_S

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

_BIAS_SAMPLES = 1000
_ROUNDING = 1e-4  # of a sample, by which stamps of a Unix time may exceed the last whole sample


@dataclass(frozen=True, kw_only=True)
class ThesisSettings:
    """The constants of C.2.5: N_T, two weights (squared in the fit), the last l of the first, and the last l used.

    `denominator` and `numerator` are A and B of eq. 3.10: their numbers of coefficients, including the leading 1.
    """

    settle_samples: int = 500
    weight_low: float = 2.0
    weight_high: float = 0.5
    low_up_to: int = 15
    count_up_to: int = 100
    denominator: int = 2
    numerator: int = 1


FIRST_SERIES = ThesisSettings()
SECOND_SERIES = ThesisSettings(settle_samples=1800, weight_low=2.5, low_up_to=50, count_up_to=200)
_SETTINGS = {8000: SECOND_SERIES}  # by N; others are those of the first series


@dataclass(frozen=True, kw_only=True)
class ThesisResponse:
    """One run's estimate by FFT (eq. 3.9): N from its stamps, and the number of transformed samples (eq. 3.8).

    `elsewhere` states that the force's largest peak is not at the input's frequency; C.2.5 divides by it nevertheless.
    """

    name: str
    periods: int
    omega_rad: float
    value: complex
    samples: int
    fft_samples: int
    elsewhere: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class ThesisFit:
    """The transfer function of a series; the thesis has no uncertainties. `findings` are about single runs."""

    function: TransferFunction
    responses: tuple[ThesisResponse, ...]
    weights: Array
    findings: tuple[Finding, ...]

    def rejections(self, keys: Sequence[str]) -> tuple[Finding, ...]:
        """Return why this is not a motor's transfer function, for its quantities `keys`."""
        elsewhere, count = sum(response.elsewhere for response in self.responses), len(self.responses)
        pole = "its slowest pole is no decay, which no motor has."
        peaks = (
            f"in {elsewhere} of {counted(count, 'run')} the force's largest peak is not at the sine: are the channel "
            "and the motor those of the runs?"
        )
        return (
            *(() if self.function.time_constant_s else (rejection("thesis-pole-no-decay", pole, *keys),)),
            *((rejection("thesis-peaks-elsewhere", peaks, *keys),) if 2 * elsewhere > count else ()),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ThesisFits:
    """One fit per series, and the least squares (eq. 3.14) of all their responses, each with the weights it had.

    The thesis itself keeps its series apart.
    """

    each: Mapping[str, ThesisFit]
    joint: ThesisFit


def fit_all(series: Mapping[str, Sequence[RecordedSine]], *, sign: Sign = "auto") -> ThesisFits:
    """Identify each series, and all of them at once; the settings of a series are those for its first run's N.

    Raises DataError and FitError with a run's name.
    """
    each = {
        name: fit_thesis([_upward(run, sign) for run in runs], _SETTINGS.get(runs[0].sine.samples, FIRST_SERIES))
        for name, runs in series.items()
    }
    fits = list(each.values())
    if len(fits) == 1:
        return ThesisFits(each=each, joint=fits[0])
    joint = _solved(
        [response for fit in fits for response in fit.responses],
        np.concatenate([fit.weights for fit in fits]),
        [finding for fit in fits for finding in fit.findings],
        FIRST_SERIES,  # only A and B, which all series have in common
    )
    return ThesisFits(each=each, joint=joint)


def fit_thesis(recorded: Sequence[RecordedSine], settings: ThesisSettings = FIRST_SERIES) -> ThesisFit:
    """Identify a series as C.2.5 does; forces are in N with the sign of thrust, and still contain the bias.

    Raises DataError for runs that the method cannot use, FitError when too few are left.
    """
    findings, responses = [], []
    for run in recorded:
        if run.sine.periods > settings.count_up_to:
            text = f"l = {run.sine.periods} is above {settings.count_up_to} and left out."
            findings.append(note("sine-too-fast", text, "tf.*").at(run.name))
        elif run.sine.periods:  # for l = 0, without the middle value, C.2.5 divides zero by zero
            response = thesis_response(run, settle_samples=settings.settle_samples)
            responses.append(response)
            if response.elsewhere:
                text = f"the force's largest peak is not at l = {response.periods}."
                findings.append(warning("thesis-peak-elsewhere", text, "tf.*").at(run.name))
    slow = np.array([response.periods <= settings.low_up_to for response in responses], dtype=bool)
    return _solved(responses, np.where(slow, settings.weight_low, settings.weight_high), findings, settings)


def thesis_response(run: RecordedSine, *, settle_samples: int = FIRST_SERIES.settle_samples) -> ThesisResponse:
    """Return one run's estimate of the frequency response.

    N is that of the run's own stamps; force is interpolated at its samples. The estimate is the ratio of the
    transforms' largest bins except the constant, wherever they are.
    """
    force, middle = run.force_n - run.force_n[:_BIAS_SAMPLES].mean(), run.sine.middle
    stamps_s = run.reports.host_s - run.reports.host_s[0]
    samples = math.ceil(stamps_s[-1] / SAMPLE_S - _ROUNDING)
    begin, end = _rows(run, samples)
    grid_s = SAMPLE_S * np.arange(samples)
    force = np.interp(grid_s, run.time_s[begin:end] - run.reports.host_s[0], force[begin:end])
    omega = 2 * np.pi * run.sine.periods / samples
    commands = (run.reports.command[0] - middle) * np.cos(omega * np.arange(samples)) + middle
    taken = _fft_samples(run, samples, settle_samples)
    window = slice(settle_samples - 1, settle_samples - 1 + taken)  # MATLAB counts from 1
    of_force, of_commands = np.fft.rfft(force[window])[1:], np.fft.rfft(commands[window])[1:]
    if not of_force.any():
        raise FitError(f"{run.name}: the load cell measured nothing while it was played: is the channel the motor's?")
    at_force, at_commands = int(np.abs(of_force).argmax()), int(np.abs(of_commands).argmax())
    return ThesisResponse(
        name=run.name,
        periods=run.sine.periods,
        omega_rad=omega,
        value=complex(of_force[at_force] / of_commands[at_commands]),
        samples=samples,
        fft_samples=taken,
        elsewhere=at_force != at_commands,
    )


def least_squares(value: Complex, omega_rad: Array, weights: Array, settings: ThesisSettings) -> tuple[Array, Array]:
    """Solve eq. 3.12 with weights (eq. 3.14) for responses (n,); return numerator (B,) and denominator (A,).

    A row is the real or imaginary part of H(Omega) times the denominator, less the numerator (eq. 3.11).
    """
    poles, zeros = np.arange(1, settings.denominator), np.arange(settings.numerator)
    if 2 * len(value) < len(poles) + len(zeros):
        raise FitError(
            f"{counted(len(value), 'frequency is', 'frequencies are')} too few for A = "
            f"{settings.denominator}, B = {settings.numerator}."
        )
    columns = np.concatenate(
        [value[:, None] * np.exp(-1j * omega_rad[:, None] * poles), -np.exp(-1j * omega_rad[:, None] * zeros)], axis=1
    )
    weighted = weights[:, None] * np.concatenate([columns, -value[:, None]], axis=1)
    rows = np.concatenate([weighted.real, weighted.imag])
    scale = np.linalg.norm(rows[:, :-1], axis=0)
    if not scale.all():
        raise FitError("all responses have weight zero: give a weight_low or weight_high above zero.")
    found = np.linalg.lstsq(rows[:, :-1] / scale, rows[:, -1], rcond=None)[0] / scale
    return found[len(poles) :], np.concatenate([[1.0], found[: len(poles)]])


def _solved(
    responses: Sequence[ThesisResponse], weights: Array, findings: Sequence[Finding], settings: ThesisSettings
) -> ThesisFit:
    value = np.array([response.value for response in responses])
    omega_rad = np.array([response.omega_rad for response in responses])
    numerator, denominator = least_squares(value, omega_rad, weights, settings)
    return ThesisFit(
        function=TransferFunction(numerator=numerator, denominator=denominator),
        responses=tuple(responses),
        weights=weights,
        findings=tuple(findings),
    )


def _upward(run: RecordedSine, sign: Sign) -> RecordedSine:
    """Return the run with force positive for thrust: motors push one way while it is played."""
    begin, end = np.searchsorted(run.time_s, run.reports.host_s[[0, -1]])
    down = sign == "-"
    if sign == "auto" and begin > 0 and end > begin:
        down = bool(run.force_n[begin:end].mean() < run.force_n[:_BIAS_SAMPLES].mean())
    return replace(run, force_n=-run.force_n) if down else run


def _rows(run: RecordedSine, samples: int) -> tuple[int, int]:
    """Return the range of the load cell's rows around the run."""
    first_s, last_s = run.reports.host_s[0], run.reports.host_s[-1]
    begin = int(np.searchsorted(run.time_s, first_s, side="right")) - 1
    end = int(np.searchsorted(run.time_s, last_s)) + 1
    if begin < 0 or end > len(run.time_s) or samples < 2:
        raise DataError(
            f"{run.name}: the load cell's record does not cover the run: it reaches from "
            f"{run.time_s[0] - first_s:.1f} to {run.time_s[-1] - first_s:.1f} s of its {last_s - first_s:.1f} s."
        )
    return begin, end


def _fft_samples(run: RecordedSine, samples: int, settle_samples: int) -> int:
    """Return N_FFT of eq. 3.8: whole periods, each rounded to samples; all samples for l = 1."""
    left = samples - settle_samples
    if run.sine.periods == 1:
        taken = left
    else:
        period = math.floor(run.sine.samples / run.sine.periods + 0.5)  # MATLAB rounds halves up
        taken = left // period * period
    if taken < 3:
        raise DataError(
            f"{run.name}: no whole period is left of its {samples} samples after the first {settle_samples}."
        )
    return taken
