"""Compose the lines that are printed about a transfer function in addition to the table of its quantities."""

from cfid.records.result import Dependent
from cfid.transfer.estimation import TransferFit
from cfid.transfer.identification import Identified
from cfid.transfer.model import Array
from cfid.units import COVERAGE_95

_FORMS = {
    "hold": "each command is held for a sample and takes effect from then on, hence the numerator's z^-1",
    "thesis": "as (3.15): the force at a sample includes the effect of that sample's command, hence no z^-1, and a "
    "sample more delay",
}


def fit_lines(found: Identified) -> list[str | Dependent]:
    """Return lines on H(z), chi-squared and the shapes' scores, each series, and the delays."""
    fit = found.fit
    aicc = ", ".join(f"{shape} {score:+.1f}" for shape, score in found.aicc.items())
    each = [_series_line(name, own) for name, own in found.each.items()]
    return [
        *convention_lines(fit.numerator, fit.denominator, form=fit.form, sample_s=fit.sample_s),
        f"chi-squared {fit.chi_squared:.1f} for {fit.degrees_of_freedom} degrees of freedom (probability "
        f"{fit.probability:.2g}): the model {'describes' if fit.described else 'does not describe'} {len(fit.model)} "
        "frequencies",
        *([f"corrected AIC above the best: {aicc}"] if aicc else []),
        *(each if len(found.each) > 1 else []),
        *(Dependent(_delay_line(name, found), "tf.delay_s") for name in fit.delays),
    ]


def convention_lines(numerator: Array, denominator: Array, *, form: str, sample_s: float) -> list[Dependent]:
    """Return H(z) in rising powers of z^-1, and its convention."""
    lines = (
        f"H(z) = ({_polynomial(numerator)}) / ({_polynomial(denominator)}), N of thrust over units of the command",
        f"coefficients of z^0, z^-1, ... at {1e3 * sample_s:.5g} ms, leading 1; {_FORMS[form]}",
    )
    return [Dependent(line, "tf.numerator", "tf.denominator") for line in lines]


def _series_line(name: str, fit: TransferFit) -> Dependent:
    delay = fit.delays[name]
    line = (
        f"{name} for itself: static gain {fit.dynamics.static_gain_n:.4g} +- {fit.std.static_gain_n:.2g} N, time "
        f"constant {1e3 * fit.time_constant_s:.2f} +- {1e3 * fit.time_constant_std_s:.2g} ms, delay "
        f"{1e3 * delay.delay_s:.2f} +- {1e3 * delay.std_s:.2g} ms, chi-squared {fit.chi_squared:.1f} of "
        f"{fit.degrees_of_freedom}"
    )
    return Dependent(line, *(f"tf.series.{name}.{key}" for key in ("static_gain_n", "time_constant_s", "delay_s")))


def _delay_line(name: str, found: Identified) -> str:
    delay, series = found.fit.delays[name], found.aligned[name]
    skews = ", ".join(f"{1e6 * line.skew:+.0f} ppm" for line in series.lines)
    clocks = f"; the vehicle's clock is off by {skews}" if skews else "; no stamps of the vehicle"
    return (
        f"{name}: force comes {_later(delay.delay_s, delay.std_s)} than its command as stamped on average, "
        f"{_later(delay.after_quickest_s, delay.after_quickest_std_s)} than as stamped at the quickest{clocks}"
    )


def _later(delay_s: float, std_s: float) -> str:
    zero = "consistent with zero: " if abs(delay_s) <= COVERAGE_95 * std_s else ""
    return f"{zero}{1e3 * abs(delay_s):.2f} ms {'later' if delay_s >= 0 else 'earlier'}"


def _polynomial(coefficients: Array) -> str:
    terms = [
        f"{value:+.7g}" + (f" z^-{power}" if power else "")
        for power, value in enumerate(coefficients.tolist())
        if value != 0
    ]
    return " ".join(terms).removeprefix("+").replace(" +", " + ").replace(" -", " - ") or "0"
