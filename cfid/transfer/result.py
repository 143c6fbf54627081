"""Transfer functions as `cfid tf identify` tells them: parameters of the contract, lines for a person, figures."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cfid.records.covariances import Covariance
    from cfid.records.parameters import Parameter
    from cfid.records.tables.table import Array
    from cfid.transfer.estimation import TransferFit
    from cfid.transfer.identification import Identified
    from cfid.transfer.thesis import ThesisFit
    from cfid.transfer.thesis_options import AsThesis

_HELD = {
    "hold": "each command is held for a sample and felt from then on, hence the numerator's z^-1",
    "thesis": "as (3.15): the force at a sample has felt that sample's command, hence no z^-1, and a sample more delay",
}


def fit_parameters(found: "Identified") -> "dict[str, Parameter]":
    """Return the joint transfer function, that of each series, and the responses they came from."""
    from cfid.records.parameters import Parameter

    parameters = {
        **_of_fit("tf", found.fit),
        "tf.sample_time_s": Parameter(value=found.fit.sample_s, unit="s"),
        **_delays("tf", found.fit),
    }
    if len(found.fit.dynamics.lags_s) > 1:
        lags, std = found.fit.dynamics.lags_s, found.fit.std.lags_s
        parameters["tf.lags_s"] = Parameter(value=list(lags), std=list(std), unit="s")
    if found.fit.shape == "zero":
        parameters["tf.lead_s"] = Parameter(value=found.fit.dynamics.lead_s, std=found.fit.std.lead_s, unit="s")
    for name, fit in found.each.items():
        parameters |= _of_fit(f"tf.series.{name}", fit) | _delays(f"tf.series.{name}", fit)
    rows = [
        {"series": series.name, **_row(response.periods, response.frequency_rad_s, response.value), "std": response.std}
        for series in found.fit.measured
        for response in series.responses
    ]
    return {**parameters, "tf.frequency_response": Parameter(value=rows, unit="N")}


def fit_covariances(found: "Identified") -> "tuple[Covariance, ...]":
    """Return the covariance of the joint transfer function's numbers."""
    from cfid.records.covariances import covariance_between

    fit = found.fit
    values = {
        "tf.numerator": fit.numerator.tolist(),
        "tf.denominator": fit.denominator.tolist(),
        "tf.static_gain_n": fit.dynamics.static_gain_n,
        "tf.time_constant_s": fit.time_constant_s,
        "tf.delay_s": fit.mean_delay.delay_s,
    }
    covariance = fit.std.covariance.copy()
    covariance[-1, -1] = fit.mean_delay.std_s**2  # with how late stamps come on average
    return covariance_between(values, covariance)


def thesis_parameters(found: "AsThesis") -> "dict[str, Parameter]":
    """Return the same of the thesis' calculation, which has no deviations, and takes the delay to be zero."""
    from cfid.records.parameters import Parameter
    from cfid.transfer.sines.reports import SAMPLE_S

    parameters = {
        **_of_thesis("tf", found.joint),
        "tf.sample_time_s": Parameter(value=SAMPLE_S, unit="s"),
    }
    for name, fit in found.each.items():
        parameters |= _of_thesis(f"tf.series.{name}", fit)
    rows = [
        {"series": name, **_row(own.periods, own.omega_rad / SAMPLE_S, own.value), "std": None}
        for name, fit in found.each.items()
        for own in fit.responses
    ]
    return {**parameters, "tf.frequency_response": Parameter(value=rows, unit="N")}


def fit_quality(found: "Identified") -> dict[str, Any]:
    """Return the figures that judge a fit."""
    fit = found.fit
    return {
        "shape": fit.shape,
        "form": fit.form,
        "frequencies": len(fit.model),
        "chi_squared": fit.chi_squared,
        "degrees_of_freedom": fit.freedom,
        "probability": fit.probability,
        "misfit": fit.misfit,
        "corrected_aic": found.aicc,
        "series": {
            name: {
                "mean_lateness_s": series.mean_lateness_s,
                "clock_skew": [line.skew for line in series.lines],
                "runs": len(series.runs),
            }
            for name, series in found.aligned.items()
        },
    }


def fit_lines(found: "Identified") -> list[str]:
    """Return the function as a formula, its verdict, what the delay is made of, and each series for itself."""
    fit = found.fit
    aicc = ", ".join(f"{shape} {score:+.1f}" for shape, score in found.aicc.items())
    each = [_series_line(name, own) for name, own in found.each.items()] if len(found.each) > 1 else []
    return [
        *convention_lines(fit.numerator, fit.denominator, form=fit.form, sample_s=fit.sample_s),
        f"chi-squared {fit.chi_squared:.1f} for {fit.freedom} degrees of freedom (probability {fit.probability:.2g}): "
        f"the model {'describes' if fit.described else 'does not describe'} {len(fit.model)} frequencies",
        *([f"corrected AIC above the best: {aicc}"] if aicc else []),
        *each,
        *(_delay_line(name, found) for name in fit.delays),
    ]


def convention_lines(numerator: "Array", denominator: "Array", *, form: str, sample_s: float) -> list[str]:
    """Return H(z) in rising powers of z^-1 and how it is meant."""
    over, under = _polynomial(numerator), _polynomial(denominator)
    return [
        f"H(z) = ({over}) / ({under}), N of thrust over units of the command",
        f"coefficients of z^0, z^-1, ... at {1e3 * sample_s:.5g} ms, leading 1; {_HELD[form]}",
    ]


def _of_fit(key: str, fit: "TransferFit") -> "dict[str, Parameter]":
    std = fit.std
    found = {
        "numerator": (fit.numerator.tolist(), std.numerator.tolist(), "N"),
        "denominator": (fit.denominator.tolist(), std.denominator.tolist(), "1"),
        "time_constant_s": (fit.time_constant_s, fit.time_constant_std_s, "s"),
        "static_gain_n": (fit.dynamics.static_gain_n, std.static_gain_n, "N"),
    }
    return _keyed(key, found)


def _of_thesis(key: str, fit: "ThesisFit") -> "dict[str, Parameter]":
    found = {
        "numerator": (fit.numerator.tolist(), None, "N"),
        "denominator": (fit.denominator.tolist(), None, "1"),
        "time_constant_s": (fit.time_constant_s, None, "s"),
        "static_gain_n": (fit.static_gain_n, None, "N"),
        "delay_s": (0.0, None, "s"),
    }
    return _keyed(key, found)


def _keyed(key: str, found: Mapping[str, tuple[Any, Any, str]]) -> "dict[str, Parameter]":
    from cfid.records.parameters import Parameter

    return {f"{key}.{name}": Parameter(value=value, std=std, unit=unit) for name, (value, std, unit) in found.items()}


def _delays(key: str, fit: "TransferFit") -> "dict[str, Parameter]":
    """Return the delay from stamps as they come on average and from the quickest; of several series the mean."""
    from cfid.records.parameters import Parameter

    mean = fit.mean_delay
    return {
        f"{key}.delay_s": Parameter(value=mean.delay_s, std=mean.std_s, unit="s"),
        f"{key}.delay_after_quickest_s": Parameter(
            value=mean.after_quickest_s, std=mean.after_quickest_std_s, unit="s"
        ),
    }


def _row(periods: int, frequency_rad_s: float, value: complex) -> dict[str, Any]:
    from cmath import phase

    return {"l": periods, "frequency_rad_s": frequency_rad_s, "magnitude": abs(value), "phase_rad": phase(value)}


def _series_line(name: str, fit: "TransferFit") -> str:
    delay = fit.delays[name]
    return (
        f"{name} for itself: static gain {fit.dynamics.static_gain_n:.4g} +- {fit.std.static_gain_n:.2g} N, time "
        f"constant {1e3 * fit.time_constant_s:.2f} +- {1e3 * fit.time_constant_std_s:.2g} ms, delay "
        f"{1e3 * delay.delay_s:.2f} +- {1e3 * delay.std_s:.2g} ms, chi-squared {fit.chi_squared:.1f} of {fit.freedom}"
    )


def _delay_line(name: str, found: "Identified") -> str:
    delay, series = found.fit.delays[name], found.aligned[name]
    skews = ", ".join(f"{1e6 * line.skew:+.0f} ppm" for line in series.lines)
    clocks = f"; the vehicle's clock is off by {skews}" if skews else "; no stamps of the vehicle"
    return (
        f"{name}: force comes {_later(delay.delay_s)} than its command as stamped on average, "
        f"{_later(delay.after_quickest_s)} than as stamped at the quickest{clocks}"
    )


def _later(delay_s: float) -> str:
    return f"{1e3 * abs(delay_s):.2f} ms {'later' if delay_s >= 0 else 'earlier'}"


def _polynomial(coefficients: "Array") -> str:
    terms = [
        f"{value:+.7g}" + (f" z^-{power}" if power else "")
        for power, value in enumerate(coefficients.tolist())
        if value != 0
    ]
    return " ".join(terms).removeprefix("+").replace(" +", " + ").replace(" -", " - ") or "0"
