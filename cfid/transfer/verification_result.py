"""Compare a transfer function with sine runs it was not identified from: the result of `cfid tf verify`."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, note, warning
from cfid.records.parameters import Parameter, Source
from cfid.records.result import Dependent, Figures, Result
from cfid.records.run import Run
from cfid.transfer.frequency_response import SETTLE_S
from cfid.transfer.model import DifferenceEquation
from cfid.transfer.sines.alignment import Sign, SineRun, SineSeries, align, with_end
from cfid.transfer.sines.data import SineSet, read_sines
from cfid.transfer.verification import Verification, verify_run

_LONGEST_S = 10.0  # the largest delay, of either sign


@dataclass(frozen=True, kw_only=True, eq=False)
class Function:
    """A transfer function with its delay in s after the average report and, if known, after the fastest.

    `delay_std_s` is the standard uncertainty of the delay in use, 0 where it is not known. `used` are the sha256 of the
    files that the function was identified from.
    """

    equation: DifferenceEquation
    delay_s: float = 0.0
    delay_std_s: float = 0.0
    after_quickest_s: float | None = None
    used: frozenset[str] = frozenset()

    @classmethod
    def of_coefficients(
        cls, numerator: Sequence[float], denominator: Sequence[float], *, delay_s: float = 0.0
    ) -> "Function":
        """Return H(z) from coefficients of z^0, z^-1, ... Raises ConfigError for coefficients that no motor has."""
        return cls(equation=_equation(numerator, denominator), delay_s=_delay(delay_s))

    @classmethod
    def of_quantities(
        cls, quantities: Mapping[str, Parameter], sources: Iterable[Source] = (), *, delay_s: float | None = None
    ) -> "Function":
        """Return the identified function, with its own delay or `delay_s` instead.

        Raises DataError for a missing quantity, and for coefficients that no motor has.
        """
        try:
            numerator, denominator, average = (
                quantities[f"tf.{key}"] for key in ("numerator", "denominator", "delay_s")
            )
        except KeyError as error:
            raise DataError(f"there is no {error.args[0]}: identify the transfer function again.") from None
        quickest = quantities.get("tf.delay_after_quickest_s")
        used = frozenset(source.sha256 for source in sources)
        try:
            equation = _equation(numerator.value, denominator.value)
            delay_s = None if delay_s is None else _delay(delay_s)
            average_s = _delay(math.nan if average.value is None else average.value)
        except ConfigError as error:
            raise DataError(f"{error} Identify the transfer function again.") from None
        if delay_s is not None:
            return cls(equation=equation, delay_s=delay_s, used=used)
        return cls(
            equation=equation,
            delay_s=average_s,
            delay_std_s=(average if quickest is None else quickest).std or 0.0,
            after_quickest_s=None if quickest is None else quickest.value,
            used=used,
        )

    def delay_in(self, series: SineSeries) -> tuple[float, float]:
        """Return the delay in s after the fastest reports of a series, and its standard uncertainty there."""
        if self.after_quickest_s is not None:
            return self.after_quickest_s, self.delay_std_s
        return self.delay_s + series.mean_lateness_s, math.hypot(self.delay_std_s, series.mean_lateness_std_s)


def verify(
    runs: SineSet | Sequence[Run | Path | str],
    function: Function | Result,
    *,
    sign: Sign = "auto",
    settle_s: float = SETTLE_S,
) -> Result:
    """Simulate a transfer function, or that of a result, and compare it with runs it was not identified from.

    Raises DataError for a run without a frequency, or one that is too short.
    """
    sines = runs if isinstance(runs, SineSet) else read_sines(runs)
    known = Function.of_quantities(function.quantities, function.sources) if isinstance(function, Result) else function
    turning = {
        name: moving for name, own in sines.series.items() if (moving := [run for run in own if run.sine.periods])
    }
    still = [run.name for run in sines.runs if not run.sine.periods]
    if not turning:
        raise DataError(f"{still[0]}: has no frequency, and nothing to compare: leave it out.")
    whole = [with_end(recorded) for recorded in turning.values()]
    compared = [one for recorded, _ in whole for one in _compared(align(recorded, sign=sign), known, settle_s)]
    keys = _distinct(own.name.partition(" (")[2].removesuffix(")").removesuffix(".csv") for _, own in compared)
    names = _distinct(own.name for _, own in compared)
    found = [(_quantities(f"tf.verify.{key}", own), own) for key, (_, own) in zip(keys, compared, strict=True)]
    return Result(
        command="tf verify",
        section="tf verify",
        method="default",
        quantities={key: quantity for quantities, _ in found for key, quantity in quantities.items()},
        wanted=("tf.verify.*",),
        merits={
            "runs": {
                name: {
                    "off": own.off,
                    "off_std": own.off_std,
                    "unfiltered_fit_percent": Dependent(own.unfiltered_fit_percent, *quantities),
                }
                for name, (quantities, own) in zip(names, found, strict=True)
            }
        },
        findings=(
            *sines.findings,
            *(note("sine-without-frequency", f"{name} has no frequency and is left out.", "tf.*") for name in still),
            *(finding for _, lost in whole for finding in lost),
            *_reused(known, sines),
            *(finding for quantities, own in found for finding in own.findings(tuple(quantities))),
        ),
        sources=sines.sources,
        lines=tuple(Dependent(_line(own), *quantities) for quantities, own in found),
        drawings=lambda: _figures(compared),
    )


def _compared(series: SineSeries, known: Function, settle_s: float) -> list[tuple[SineRun, Verification]]:
    delay_s, std_s = known.delay_in(series)
    return [
        (
            run,
            verify_run(
                run, known.equation, after_quickest_s=delay_s, delay_std_s=std_s, form="thesis", settle_s=settle_s
            ),
        )
        for run in series.runs
    ]


def _quantities(key: str, own: Verification) -> dict[str, Parameter]:
    return {
        f"{key}.fit_percent": Parameter(value=own.fit_percent),
        f"{key}.residual_rms_n": Parameter(value=own.residual_rms_n),
        f"{key}.late_s": Parameter(value=own.late_s, std=own.late_std_s),
        f"{key}.gain_ratio": Parameter(value=own.gain_ratio, std=own.gain_ratio_std),
    }


def _reused(known: Function, sines: SineSet) -> list[Finding]:
    again = [source.path for source in sines.sources if source.sha256 in known.used]
    text = "the transfer function was identified from it: this verifies nothing."
    return [warning("verification-reuses-run", f"{again[0]}: {text}", "tf.verify.*")] if again else []


def _line(own: Verification) -> str:
    return (
        f"{own.name}: fit {own.fit_percent:.1f} % ({own.unfiltered_fit_percent:.1f} % with the vibration), residual "
        f"{1e3 * own.residual_rms_n:.2g} mN rms; measured {1e3 * own.late_s:+.2f} +- {1e3 * own.late_std_s:.2g} ms "
        f"later and {own.gain_ratio:.4f} +- {own.gain_ratio_std:.2g} times as large as simulated"
    )


def _figures(compared: Sequence[tuple[SineRun, Verification]]) -> Figures:
    from cfid.transfer.figures import verification_figure

    names = _distinct(f"tf_verify_l{run.sine.periods}" for run, _ in compared)
    return {name: verification_figure(run, own) for name, (run, own) in zip(names, compared, strict=True)}


def _distinct(names: Iterable[str]) -> list[str]:
    """Return the names, numbered where one is repeated: files in different folders may have the same name."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return found


def _equation(numerator: Sequence[float], denominator: Sequence[float]) -> DifferenceEquation:
    """Return H(z) from coefficients of z^0, z^-1, ... Raises ConfigError for coefficients that no motor has."""
    if not len(denominator) or denominator[0] != 1:
        raise ConfigError(f"denominator {_text(denominator)}: should begin with its leading 1.")
    if not any(numerator):
        raise ConfigError(f"numerator {_text(numerator)}: gives no thrust at any command: one should not be zero.")
    if not np.all(np.isfinite([*numerator, *denominator])):
        raise ConfigError(f"coefficients {_text([*numerator, *denominator])}: should be finite numbers.")
    if np.max(np.abs(np.roots(denominator)), initial=0.0) >= 1:
        raise ConfigError(f"denominator {_text(denominator)}: never settles, which no motor does: is a sign wrong?")
    return DifferenceEquation(numerator=np.array(numerator), denominator=np.array(denominator))


def _delay(delay_s: float) -> float:
    if not abs(delay_s) <= _LONGEST_S:
        raise ConfigError(f"delay_s {delay_s:g}: should be from {-_LONGEST_S:g} to {_LONGEST_S:g} s.")
    return delay_s


def _text(coefficients: Sequence[float]) -> str:
    return ",".join(f"{value:g}" for value in coefficients)
