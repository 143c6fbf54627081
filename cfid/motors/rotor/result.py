"""How rotors follow their commands, in the contract's keys: rates, delay, map, and a time constant for each step."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.linear import propagated, slopes, std_of
from cfid.findings import Finding, note, rejection, warning
from cfid.motors.rotor.data import Followed, followed
from cfid.motors.rotor.estimation import (
    C0,
    C2,
    DELAY,
    FALL,
    FALL_SHARE,
    RISE,
    RISE_SHARE,
    START,
    RotorFit,
    fit_rotor,
)
from cfid.motors.rotor.model import RotorRecord
from cfid.recordings.limits import other_scale
from cfid.recordings.recording import Recording
from cfid.recordings.stand import StandTable
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result
from cfid.records.run import Run
from cfid.units import COVERAGE_95, FULL_COMMAND

Array = npt.NDArray[np.float64]

SPEED_POLY = "motor.speed_poly"
_ROWS = "dynamics.time_constant_s"
_WAYS = ("dynamics.rising", "dynamics.falling")
_PLACES = {_WAYS[0]: [0, 1], _WAYS[1]: [2, 3], "dynamics.delay_s": [4], SPEED_POLY: [5, 6, 7]}

_EXPLAINED = 0.9  # of the variance, r^2
_LOOSE = 0.2  # the standard uncertainty of a rate
_SPLIT = 0.2  # of a rate: from there on, a recording does not show which part goes with the speed
_COARSE = 0.5  # of a time constant: the largest interval of a command that changes in most rows
_APART = 2.0  # time constants between readings, which then do not show how fast a rotor settled
_SLOWEST_S = 1.0  # largest time constant of a rotor, as in `fit flight`
_NOTABLE_DRIFT = 0.02  # of the speed
_SAG = 0.05  # of a time constant: what a battery whose voltage is unknown changes
_BETWEEN_ROWS = 0.1  # of the interval between rows: time constants of commands that change in most of them


class _Rotor(NamedTuple):
    name: str
    record: RotorRecord
    fit: RotorFit
    reasons: tuple[Finding, ...]


def fit(
    recording: Followed | Recording | StandTable | Run | Path | str,
    *,
    rotor: int | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
) -> Result:
    """Return rates of rising and falling speed, delay and map of the rotors of a recording, and their mean.

    Parameters and errors are those of `followed`. Raises FitError where no rotor can be followed.
    """
    if not isinstance(recording, Followed):
        recording = followed(recording, rotor=rotor, from_s=from_s, to_s=to_s)
    rotors, left_out = _fits(recording)
    accepted = [one for one in rotors if not one.reasons] or rotors
    values, covariance = _mean(accepted)
    std = std_of(covariance)
    at_rad_s = float(np.mean([one.fit.at_rad_s for one in accepted]))
    there = [way for way in range(2) if any(one.fit.ways[way] for one in accepted)]
    rates = {way: _rate(values, covariance, way, at_rad_s) for way in there}
    ways = [way for way, (rate, own_std) in rates.items() if own_std < _LOOSE * rate] or there
    shown = [_WAYS[way] for way in ways] + ["dynamics.delay_s"] + [SPEED_POLY] * recording.is_log
    quantities = {key: Parameter(value=values[_PLACES[key]].tolist(), std=std[_PLACES[key]].tolist()) for key in shown}
    quantities["dynamics.delay_s"] = Parameter(value=float(values[4]), std=float(std[4]))
    places = [place for key in shown for place in _PLACES[key]]

    def drawings() -> Figures:
        from cfid.motors.rotor.figures import rotor_figure

        fits = {one.name: one.fit for one in rotors}
        reasons = [f"{one.name}: {finding.text}" for one in rotors for finding in one.reasons]
        return {f"fit_dynamics_{recording.name}": rotor_figure(fits, reasons, title=recording.name)}

    return Result(
        command="fit dynamics",
        prints_lines=True,
        method="default",
        quantities={
            **quantities,
            _ROWS: Parameter(value=[row for one in rotors for row in _rows(one, is_log=recording.is_log)]),
            "dynamics.map": Parameter(value=[_map(one) for one in rotors if not one.reasons]),
        },
        wanted=tuple(_WAYS[way] for way in ways),
        covariances=covariance_between(
            {key: quantities[key].value for key in shown}, covariance[np.ix_(places, places)]
        ),
        merits={
            "rotors": [one.name for one in rotors],
            "rejected": sum(bool(one.reasons) for one in rotors),
            "explained": {one.name: one.fit.explained for one in rotors},
            "rms": {one.name: one.fit.rms for one in rotors},
        },
        findings=(
            *recording.findings,
            *left_out,
            *_of_rotors(rotors),
            *(() if accepted[0].reasons else _of_rates(rates, covariance, at_rad_s)),
            *_of_delay(values[4], std[4]),
            *(_of_map(accepted, values) if recording.is_log else ()),
        ),
        sources=recording.sources,
        lines=(*recording.lines, *(Dependent(_line(one), _ROWS) for one in rotors)),
        drawings=drawings,
    )


def _fits(recording: Followed) -> tuple[list[_Rotor], list[Finding]]:
    """Return the fit of each rotor, and findings about rotors without one."""
    rotors, left_out, failed = [], [], None
    for number, record in recording.rotors.items():
        name = f"rotor {number}" if number else "the rotors that ran"
        try:
            fit = fit_rotor(record)
        except FitError as error:
            failed = error
            left_out.append(warning("lag-rotor-left-out", str(error), "dynamics.*").at(name))
            continue
        rotors.append(_Rotor(name, record, fit, tuple(_reasons(record, fit))))
    if not rotors:
        raise FitError(f"{recording.path}: {failed}")
    return rotors, left_out


def _reasons(record: RotorRecord, fit: RotorFit) -> Iterator[Finding]:
    """Yield why a rotor's fit is rejected."""
    keys = ("dynamics.*", SPEED_POLY)
    shown = [rate for rate, way in zip((RISE, FALL), fit.ways, strict=True) if way and fit.std[rate] < _LOOSE]
    taus_s = [math.exp(-fit.values[rate]) for rate in shown]
    if fit.explained < _EXPLAINED:
        text = (
            f"the rotor model explains only {100 * max(fit.explained, 0):.0f} % of the speed (limit "
            f"{100 * _EXPLAINED:.0f} %): is it the speed of another rotor, or does its sensor stand still?"
        )
        yield rejection("rotor-model-misfit", text, *keys)
    elif taus_s and max(taus_s) > _SLOWEST_S:
        text = (
            f"the time constant is {max(taus_s):.3g} s (limit {_SLOWEST_S:g} s), and rotors have 0.01 to 0.3 s: is "
            "the time in another unit?"
        )
        yield rejection("implausible", text, *keys)
    elif taus_s and max(fit.interval_s / _APART, record.straight * record.row_s / _COARSE) > min(taus_s):
        what, row_s = ("command", record.row_s) if record.straight else ("speed", fit.interval_s)
        text = (
            f"the {what} was recorded every {1e3 * row_s:.0f} ms, and the time constant is {1e3 * min(taus_s):.0f} ms: "
            "record faster."
        )
        yield rejection("lag-log-too-slow", text, *keys)


def _parameters(values: Array, at_rad_s: float, full: float) -> Array:
    """Return rising k1 and k2, falling k1 and k2, delay, and the map of the command, highest power first (8,)."""
    rates: list[float] = []
    for rate, share in ((RISE, RISE_SHARE), (FALL, FALL_SHARE)):
        size = math.exp(values[rate])
        rates += [size * (1 - values[share]), size * values[share] / (2 * at_rad_s)]
    poly = values[C0 : C2 + 1][::-1] / full ** np.array([2, 1, 0])
    return np.array([*rates, values[DELAY], *poly])


def _causes(rotor: _Rotor) -> Array:
    """Return how far parameters (16, m) are off by one standard uncertainty of each cause that all rotors share."""
    record, fit = rotor.record, rotor.fit
    causes = [*fit.shared.T]
    for size, place in (
        (record.row_s / math.sqrt(12), [DELAY]),
        (record.age_s / math.sqrt(12), [DELAY]),
        (0.0 if fit.supply else _SAG, [RISE, FALL]),
    ):
        cause = np.zeros(len(fit.values))
        cause[place] = size
        causes.append(cause)
    between = np.zeros(len(fit.values))
    if record.straight:
        between[[RISE, FALL]] = _BETWEEN_ROWS * record.row_s * np.exp(fit.values[[RISE, FALL]])
    return np.array([*causes, between]).T


def _with_causes(rotor: _Rotor) -> Array:
    """Return the covariance (16, 16) of a rotor's parameters."""
    fit, causes = rotor.fit, _causes(rotor)
    return np.asarray(fit.covariance - fit.shared @ fit.shared.T + causes @ causes.T)


def _mean(rotors: list[_Rotor]) -> tuple[Array, Array]:
    """Return the means of the rotors' parameters (8,) and their covariance (8, 8)."""
    values, own, causes = np.zeros(8), np.zeros((8, 8)), []
    for rotor in rotors:
        fit = rotor.fit
        values += _parameters(fit.values, fit.at_rad_s, rotor.record.full) / len(rotors)
        outward = slopes(partial(_parameters, at_rad_s=fit.at_rad_s, full=rotor.record.full), fit.values)
        own += outward @ (fit.covariance - fit.shared @ fit.shared.T) @ outward.T / len(rotors) ** 2
        causes.append(outward @ _causes(rotor))
    shared = np.mean(causes, axis=0)
    return values, own + shared @ shared.T


def _of_rotors(rotors: list[_Rotor]) -> Iterator[Finding]:
    """Yield why rotors are rejected, as warnings where the keys have other rotors, and what is notable about them."""
    some = any(not one.reasons for one in rotors)
    for one in rotors:
        for reason in one.reasons:
            yield replace(reason, severity="warning", where=(one.name,)) if some and len(rotors) > 1 else reason
        fit = one.fit
        if fit.own_start and not one.reasons:
            start_s, between_s = math.exp(-fit.values[RISE] - fit.values[START]), math.exp(-fit.values[RISE])
            text = (
                f"the time constant is {1e3 * start_s:.0f} ms from standstill, and {1e3 * between_s:.0f} ms between "
                "speeds: the rotor model is of the latter."
            )
            yield warning("rotor-starts-slowly", text, "dynamics.rising")
        if abs(fit.drift) > _NOTABLE_DRIFT and fit.ways == (True, True) and not one.reasons:
            text = (
                f"the speed of the same command{' at the same voltage' * fit.supply} changed by "
                f"{100 * fit.drift:+.1f} % from begin to end; the map holds on average."
            )
            yield note("lag-map-drifts", text, SPEED_POLY, "dynamics.map").at(one.name)
    if not all(one.fit.supply for one in rotors):
        text = (
            "no voltage was recorded: time constants are right with a supply of constant voltage. A battery that gives "
            f"way under load makes them too short; their uncertainty contains {100 * _SAG:.0f} % for that."
        )
        yield warning("lag-voltage-unknown", text, "dynamics.*")


def _rate(values: Array, covariance: Array, way: int, at_rad_s: float) -> tuple[float, float]:
    """Return how fast a small change of a speed fades, in 1/s, and its standard uncertainty."""
    at, place = np.array([1.0, 2 * at_rad_s]), _PLACES[_WAYS[way]]
    return float(at @ values[place]), math.sqrt(at @ covariance[np.ix_(place, place)] @ at)


def _of_rates(rates: Mapping[int, tuple[float, float]], covariance: Array, at_rad_s: float) -> Iterator[Finding]:
    """Yield what a recording does not show: the rate of a way, or how the rate grows with the speed."""
    split, known = [], any(std < _LOOSE * rate for rate, std in rates.values())
    for way, (rate, std) in rates.items():
        if not std < _LOOSE * rate:
            text = (
                f"the time constant of {_WAYS[way].partition('.')[2]} speed is known only to {100 * std / rate:.0f} % "
                f"(limit {100 * _LOOSE:.0f} %): command larger changes that way, or more of them."
            )
            yield note("lag-not-excited", text) if known else rejection("lag-not-excited", text, _WAYS[way])
        elif 2 * at_rad_s * math.sqrt(covariance[2 * way + 1, 2 * way + 1]) > _SPLIT * rate:
            split.append(_WAYS[way])
    if split:
        text = (
            f"the recording shows rates at about {at_rad_s:.0f} rad/s, and hardly how they grow with the speed: hold "
            "commands for a second each, between low and high speeds."
        )
        yield note("rotor-model-not-excited", text, *split)


def _of_delay(delay_s: float, std_s: float) -> Iterator[Finding]:
    if delay_s < -COVERAGE_95 * std_s:
        text = (
            f"the speed changes {-1e3 * delay_s:.1f} ± {1e3 * std_s:.2g} ms before the time stamp of its "
            "command: stamps of commands or speeds are off by that much, by the link or the log, not by the motor."
        )
        yield note("rotor-delay-negative", text, "dynamics.delay_s")


def _of_map(rotors: list[_Rotor], values: Array) -> Iterator[Finding]:
    """Yield why the rotors' mean map does not hold."""
    low, high = min(one.record.commands[0] for one in rotors), max(one.record.commands[1] for one in rotors)
    if (scale := other_scale(high)) is not None:
        text = (
            f"no command above {high:.3g}, of {FULL_COMMAND:g}: are they {scale}? Lags are the same on any scale, "
            "a map of speeds is not: scale the motors' columns."
        )
        yield rejection("commands-of-another-scale", text, SPEED_POLY)
    elif not np.all(np.polyval(np.polyder(values[_PLACES[SPEED_POLY]]), [low, high]) > 0):
        text = f"the speed map does not rise from command {low:.0f} to {high:.0f}: one speed belongs to two commands."
        yield rejection("map-not-monotone", text, SPEED_POLY)


def _rows(rotor: _Rotor, *, is_log: bool) -> list[dict[str, object]]:
    """Return a row for each step of commands that rest, or for each way of a log: the time constant nearest to it."""
    fit, covariance = rotor.fit, _with_causes(rotor)
    low, high = rotor.record.commands
    steps = [(low, high), (high, low)] if is_log else rotor.record.steps
    rows: list[dict[str, object]] = []
    for begin, end in steps:
        rising = end > begin
        if not fit.ways[not rising]:
            continue

        def time_constant(p: Array, begin: float = begin, end: float = end, rising: bool = rising) -> Array:
            *rates, _, c2, c1, c0 = _parameters(p, fit.at_rad_s, rotor.record.full)
            k1, k2 = rates[:2] if rising else rates[2:4]
            first, last = (c0 + u * (c1 + c2 * u) if u else 0.0 for u in (begin, end))
            # The exponential nearest to the way there has the rate of three quarters of it.
            mean = fit.at_rad_s if is_log else (first + 3 * last) / 4
            rest = p[START] if rising and begin == 0 else 0.0
            return np.array([1 / ((k1 + 2 * k2 * mean) * math.exp(rest))])

        tau_s = float(time_constant(fit.values)[0])
        std_s = float(std_of(propagated(time_constant, fit.values, covariance))[0])
        row: dict[str, object] = {
            "cmd_from": begin,
            "cmd_to": end,
            "rising": rising,
            "time_constant_s": tau_s,
            "std_s": std_s,
            "delay_s": float(fit.values[DELAY]),
            "accepted": not rotor.reasons and std_s < _LOOSE * tau_s,
        }
        rows.append({"rotor": int(rotor.name.split()[1]), **row} if is_log else row)
    return rows


def _map(rotor: _Rotor) -> dict[str, object]:
    """Return a row with the map of a rotor, for commands as shares of the full one."""
    fit, record, std = rotor.fit, rotor.record, rotor.fit.std
    scale = (FULL_COMMAND / record.full) ** np.arange(3)
    named = {f"c{power}": float(scale[power] * fit.values[C0 + power]) for power in range(3)}
    stds = {f"std_c{power}": float(scale[power] * std[C0 + power]) for power in range(3)}
    number = {"rotor": int(rotor.name.split()[1])} if rotor.name[-1].isdigit() else {}
    supply = {"at_v": record.at_v} if fit.supply else {}
    return {**number, "of": "rad/s", "over": f"cmd / {FULL_COMMAND}", **named, **stds, **supply}


def _line(rotor: _Rotor) -> str:
    if rotor.reasons:
        return f"{rotor.name}: rejected"
    fit = rotor.fit
    std = std_of(_with_causes(rotor))
    each = zip(("rising", "falling"), (RISE, FALL), fit.ways, strict=True)
    ways = [
        f"{name} {1e3 * (tau_s := math.exp(-fit.values[place])):.1f} ± {1e3 * tau_s * std[place]:.2g} ms"
        for name, place, there in each
        if there and std[place] < _LOOSE
    ]
    voltage = f", {rotor.record.at_v:.2f} V" if fit.supply else ""
    return (
        f"{rotor.name} at {fit.at_rad_s:.0f} rad/s{voltage}: {', '.join(ways)}, delay "
        f"{1e3 * fit.values[DELAY]:.1f} ± {1e3 * std[DELAY]:.2g} ms, explains {100 * fit.explained:.1f} %"
    )
