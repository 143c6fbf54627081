"""How rotors follow a command that always changes, in the contract's keys."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import CfidError, FitError
from cfid.findings import Finding, note, rejection, warning
from cfid.motors.lag.data import RotorLog
from cfid.motors.lag.estimation import LagFit, fit_lag, joined
from cfid.motors.lag.figures import lag_figure
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]

_THRUST = "thrust of all rotors"
_ROWS = "dynamics.time_constant_s"
_NO_LAG = "no rotor is described by a first-order lag: see the warnings."
_OF_ACCELERATION = (
    "the log has no rotor speeds: the lag is that of the acceleration along z behind the commands. It contains the "
    "accelerometer's filter and the air's forces in flight, so that it gives the order of magnitude and no rotor model."
)


def fit(record: RotorLog) -> Result:
    """Return time constants of rising and falling speed and the delay behind the command: the rotors' mean, and each.

    Raises FitError where no rotor runs for long enough, DataError where nothing shows how it follows.
    """
    try:
        fits, seen, left_out = _fits(record)
    except CfidError as error:
        raise type(error)(f"{record.path}: {str(error).removeprefix(f'{record.path}: ')}") from None
    accepted = {name: one for name, one in fits.items() if one.accepted} or fits
    rates, covariance = _mean_rates(list(accepted.values()))
    delay_s = float(np.mean([one.lag.delay_s for one in accepted.values()]))
    delay_std_s = float(np.sqrt(sum(one.std_s.delay_s**2 for one in accepted.values())) / len(accepted))
    rates_std = np.sqrt(np.diag(covariance))
    coefficients = {"dynamics.rising": [rates[0], 0.0], "dynamics.falling": [rates[1], 0.0]}
    whole = np.zeros((4, 4))
    whole[::2, ::2] = covariance

    def drawings() -> Figures:
        return {f"fit_dynamics_{record.name}": lag_figure(fits, title=record.name)}

    return Result(
        command="fit dynamics",
        method="default",
        quantities={
            "dynamics.rising": Parameter(value=coefficients["dynamics.rising"], std=[float(rates_std[0]), np.nan]),
            "dynamics.falling": Parameter(value=coefficients["dynamics.falling"], std=[float(rates_std[1]), np.nan]),
            "dynamics.delay_s": Parameter(value=delay_s, std=delay_std_s),
            _ROWS: Parameter(value=_rows(fits, seen)),
            "dynamics.map": Parameter(value=_maps(record, fits)),
        },
        wanted=("dynamics.*",) if record.speeds else (_ROWS,),
        covariances=covariance_between(coefficients, whole),
        merits={
            "rotors": list(fits),
            "rejected": sum(not one.accepted for one in fits.values()),
            "explained": {name: one.explained for name, one in fits.items()},
            "rms": {name: one.rms for name, one in fits.items()},
        },
        findings=(
            *record.findings,
            *left_out,
            *_about(record, fits, seen.unseen_s),
            *(() if any(one.accepted for one in fits.values()) else (rejection("no-lag-fits", _NO_LAG, "dynamics.*"),)),
        ),
        sources=(record.log.source,),
        lines=(
            *filter(None, [record.log.understood]),
            *(Dependent(_line(name, one), _ROWS) for name, one in fits.items()),
        ),
        drawings=drawings,
        folder=record.path.parent,
    )


class _Seen(NamedTuple):
    """The interval of commands that change between rows, 0 for others, and from where to where each rotor's went."""

    unseen_s: float
    commands: Mapping[str, tuple[float, float]]


def _fits(record: RotorLog) -> tuple[dict[str, LagFit], _Seen, tuple[Finding, ...]]:
    """Return the fit of each rotor, or of all by the acceleration, and findings about rotors without one."""
    names = {f"rotor {motor}": motor for motor in record.speeds} or {_THRUST: 0}
    fits: dict[str, list[LagFit]] = {name: [] for name in names}
    failed: dict[str, FitError] = {}
    ranges: dict[str, tuple[float, float]] = {}
    unseen_s = 0.0
    for part in record.parts():
        unseen_s = max(unseen_s, part.unseen_s)
        for name, motor in names.items():
            driven = [part.commands[motor]] if motor else list(part.commands.values())
            on = np.concatenate([value[value > 0] for _, value in driven])
            low, high = ranges.get(name, (np.inf, -np.inf))
            ranges[name] = min(low, float(on.min(initial=np.inf))), max(high, float(on.max(initial=-np.inf)))
            try:
                fits[name].append(
                    fit_lag(part.of_speed(motor), kind="speed", unseen_s=part.unseen_s)
                    if motor
                    else fit_lag(part.of_thrust(), kind="thrust", unseen_s=part.unseen_s)
                )
            except FitError as error:
                failed[name] = error
    found = {name: joined(each) for name, each in fits.items() if each}
    if not found:
        raise next(iter(failed.values()), FitError("no rows of all commands."))
    return (
        found,
        _Seen(unseen_s, ranges),
        tuple(
            warning("lag-rotor-left-out", str(error), "dynamics.*").at(name)
            for name, error in failed.items()
            if name not in found
        ),
    )


def _mean_rates(fits: list[LagFit]) -> tuple[list[float], Array]:
    """Return one over the time constants of rising and falling, means of the rotors, with their covariance (2, 2)."""
    rates = 1 / np.array([one.lag[:2] for one in fits])
    each = [np.outer(rate**2, rate**2) * one.covariance[3:5, 3:5] for rate, one in zip(rates, fits, strict=True)]
    return rates.mean(axis=0).tolist(), np.sum(each, axis=0) / len(fits) ** 2


def _about(record: RotorLog, fits: Mapping[str, LagFit], unseen_s: float) -> tuple[Finding, ...]:
    """Return why rotors are rejected, warnings for the keys that have other rotors, and what the numbers contain."""
    found = [replace(one, severity="warning", where=(name,)) for name, fit in fits.items() for one in fit.findings]
    if unseen_s:
        text = (
            f"the command was logged every {1e3 * unseen_s:.3g} ms and may have changed between: it is taken to "
            f"hold, and the delay's standard uncertainty contains {1e3 * unseen_s / 12**0.5:.2g} ms for that."
        )
        found.append(note("lag-command-between-rows", text, "dynamics.delay_s"))
    if not record.speeds:
        found.append(rejection("lag-from-acceleration", _OF_ACCELERATION, "dynamics.rising", "dynamics.falling"))
    return tuple(found)


def _rows(fits: Mapping[str, LagFit], seen: _Seen) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for name, fit in fits.items():
        low, high = seen.commands[name]
        for rising in (True, False):
            place = 0 if rising else 1
            rows.append(
                {
                    "rotor": _rotor(name),
                    "cmd_from": low if rising else high,
                    "cmd_to": high if rising else low,
                    "rising": rising,
                    "time_constant_s": fit.lag[place],
                    "std_s": _known(fit.std_s[place]),
                    "delay_s": fit.lag.delay_s,
                    "accepted": fit.accepted,
                }
            )
    return rows


def _maps(record: RotorLog, fits: Mapping[str, LagFit]) -> list[dict[str, object]]:
    over = f"cmd / {FULL_COMMAND}" if record.volts is None else f"cmd / {FULL_COMMAND} * V"
    of = "rad/s" if record.speeds else "m/s^2"
    return [{"rotor": _rotor(name), "of": of, "over": over, **_map(fit)} for name, fit in fits.items() if fit.accepted]


def _map(fit: LagFit) -> dict[str, object]:
    values = {f"c{power}": value for power, value in enumerate(fit.map)}
    return {**values, **{f"std_c{power}": _known(float(value)) for power, value in enumerate(fit.map_std)}}


def _rotor(name: str) -> int | None:
    return None if name == _THRUST else int(name[-1])


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _line(name: str, fit: LagFit) -> str:
    if not fit.accepted:
        return f"{name}: rejected"
    (rising, falling, delay), std = (1e3 * np.array(values) for values in (fit.lag, fit.std_s))
    return (
        f"{name}: rising {rising:.1f} +- {std[0]:.1f} ms, falling {falling:.1f} +- {std[1]:.1f} ms, "
        f"delay {delay:.1f} +- {std[2]:.1f} ms, explains {100 * fit.explained:.1f} %"
    )
