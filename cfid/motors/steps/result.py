"""How rotors follow steps of the command, in the contract's keys."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, isnan
from pathlib import Path
from statistics import median

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import CfidError, FitError
from cfid.findings import Finding, note, rejection, warning
from cfid.motors.delays import command_between_rows, delay_text, negative_delay
from cfid.motors.steps.checks import off_the_map
from cfid.motors.steps.data import SpeedRecord, of_run, of_table
from cfid.motors.steps.estimation import StepFit, fit_steps
from cfid.motors.steps.model import CommandStep, followed
from cfid.motors.steps.rotor_model import RotorModel, fit_rotor_model
from cfid.recordings.stand import StandTable, read_stand, stand_of
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result
from cfid.records.run import Run, run_at

_SLOWEST_S = 1.0  # largest time constant of a rotor, as in `fit flight`
_FEWEST_BETWEEN = 2  # rising steps between speeds: the rotor model has two coefficients for rising
_SLOWER, _SURE = 1.2, 4.0  # a slow start: times the model's time constant, and standard uncertainties beyond it
_ROWS = "dynamics.time_constant_s"
_WAYS = {"dynamics.rising": True, "dynamics.falling": False}


def fit(recording: SpeedRecord | StandTable | Run | Path | str) -> Result:
    """Return a first-order lag for each step of the command, and the rotor model of four coefficients for all.

    A run has speeds that the vehicle reported, or a load cell's vibration; a thrust stand's table has speeds over time.
    Raises DataError for a recording that cannot be read, FitError where no step can be followed.
    """
    record = _record(recording)
    try:
        steps, left_out = _steps(record)
        time_s, speed, blur_s = record.time_s, record.speed_rad_s, record.blur_s
        found = fit_steps(time_s=time_s, value=speed, steps=steps, blur_s=blur_s, battery=record.battery)
        odd = off_the_map(steps, [one.lag for one in found], [one.accepted for one in found])
        if odd.any():
            left_out += _odd(steps, odd)
            steps = tuple(step for step, off in zip(steps, odd, strict=True) if not off)
            found = fit_steps(time_s=time_s, value=speed, steps=steps, blur_s=blur_s, battery=record.battery)
        starts = _slow_starts(record, found)
        model = _rotor_model(record, [step for step in steps if step not in starts])
    except CfidError as error:
        raise type(error)(f"{record.path}: {error}") from None

    late_s = (
        hypot(record.command_row_s, record.age_s) / 12**0.5
    )  # commands changed, and speeds were read, at any time within a row
    lags = [replace(one, delay_std_s=hypot(one.delay_std_s, late_s)) for one in found]
    model = replace(model, delay_std_s=hypot(model.delay_std_s, late_s))

    def drawings() -> Figures:
        from cfid.motors.steps.figures import dynamics_figure

        drawn = dynamics_figure(record.time_s, record.speed_rad_s, lags, model, title=record.name)
        return {f"fit_dynamics_{record.name}": drawn}

    accepted = [lag for lag in lags if lag.accepted]
    lost = _without_lag(lags)
    coefficients = {"dynamics.rising": list(model.rising), "dynamics.falling": list(model.falling)}
    return Result(
        command="fit dynamics",
        method="default",
        quantities=_quantities(lags, model),
        wanted=tuple(key for key in _WAYS if key not in lost) if accepted else ("dynamics.*",),
        covariances=covariance_between(coefficients, model.covariance),
        merits={
            "steps": len(lags),
            "rejected": len(lags) - len(accepted),
            "explained": model.explained,
            "rms": model.rms,
        },
        findings=(
            *record.findings,
            *left_out,
            *_between_rows(record),
            *_supplied(record, lags),
            *(finding for lag in lags for finding in _of_row(lag)),
            *(negative_delay(model.delay_s, model.delay_std_s, _ROWS) if accepted else ()),
            *_started(starts, lags),
            *lost.values(),
            *_implausible(accepted),
            *(model.findings if accepted else ()),
        ),
        sources=record.sources,
        lines=tuple(Dependent(_line(lag), _ROWS) for lag in accepted),
        drawings=drawings,
    )


def _record(recording: SpeedRecord | StandTable | Run | Path | str) -> SpeedRecord:
    if isinstance(recording, SpeedRecord):
        return recording
    read = recording if isinstance(recording, StandTable | Run) else run_at(Path(recording))
    read = read or stand_of(read_stand(Path(str(recording))))
    return of_table(read) if isinstance(read, StandTable) else of_run(read)


def _steps(record: SpeedRecord) -> tuple[tuple[CommandStep, ...], tuple[Finding, ...]]:
    """Return the steps that the speeds show, and a finding about the others."""
    steps = record.steps
    seen = followed(steps, time_s=record.time_s, value=record.speed_rad_s)
    if steps and not seen:
        raise FitError(f"of {counted(len(steps), 'step')} none has enough speeds for a fit: hold each command longer.")
    missed = len(steps) - len(seen)
    text = f"{missed} of {len(steps)} steps have too few speeds for a fit."
    return seen, (warning("steps-left-out", text, "dynamics.*"),) if missed else ()


def _odd(steps: Sequence[CommandStep], odd: npt.NDArray[np.bool_]) -> tuple[Finding, ...]:
    first = steps[int(np.argmax(odd))]
    text = (
        f"{counted(int(odd.sum()), 'step')} of {len(steps)} left out, whose speed is far off that of the other "
        f"commands (first: command {first.command_from:.0f} to {first.command_to:.0f} at {first.at_s:.4g} s)."
    )
    return (warning("steps-off-the-map", text, "dynamics.*"),)


def _rotor_model(record: SpeedRecord, steps: Sequence[CommandStep]) -> RotorModel:
    return fit_rotor_model(
        time_s=record.time_s,
        value=record.speed_rad_s,
        steps=steps,
        blur_s=record.blur_s,
        command_row_s=record.command_row_s,
        battery=record.battery,
    )


def _slow_starts(record: SpeedRecord, lags: Sequence[StepFit]) -> tuple[CommandStep, ...]:
    """Return the steps from standstill, if rotors start slower than the model of the steps between speeds says.

    A speed controller that starts a brushless motor follows another law than one that regulates it: one model of both
    would be neither.
    """
    rising = [lag for lag in lags if lag.accepted and lag.rising]
    starts = [lag for lag in rising if lag.step.command_from == 0]
    if not starts or len(rising) - len(starts) < _FEWEST_BETWEEN:
        return ()
    model = _rotor_model(record, [lag.step for lag in lags if lag.step not in [start.step for start in starts]])
    slower = 0
    for lag in starts:
        at = np.array([1.0, (lag.from_rad_per_s + 3 * lag.to_rad_per_s) / 2])
        rate, rate_std = float(at @ model.rising), float(np.sqrt(at @ model.covariance[:2, :2] @ at))
        std = hypot(rate_std, lag.time_constant_std_s / lag.time_constant_s**2)
        slower += rate * lag.time_constant_s > _SLOWER and rate - 1 / lag.time_constant_s > _SURE * std
    return tuple(lag.step for lag in starts) if slower > len(starts) / 2 else ()


def _started(starts: Sequence[CommandStep], lags: Sequence[StepFit]) -> tuple[Finding, ...]:
    """Return a warning about slow starts from standstill."""
    if not starts:
        return ()
    rising = [lag for lag in lags if lag.accepted and lag.rising]
    slow_s = median(lag.time_constant_s for lag in rising if lag.step in starts)
    between_s = median(lag.time_constant_s for lag in rising if lag.step not in starts)
    text = (
        f"the rotor's time constant is {1e3 * slow_s:.0f} ms from standstill, and {1e3 * between_s:.0f} ms between "
        f"speeds: the rotor model is of the latter, without {counted(len(starts), 'start')}."
    )
    return (warning("rotor-starts-slowly", text, "dynamics.rising"),)


def _between_rows(record: SpeedRecord) -> tuple[Finding, ...]:
    row_s = record.command_row_s
    return (note("lag-command-between-rows", command_between_rows(row_s), _ROWS),) if row_s else ()


def _supplied(record: SpeedRecord, lags: Sequence[StepFit]) -> tuple[Finding, ...]:
    """Return a finding on the rotor's supply: a battery that fell, or a supply whose voltage was not recorded."""
    if record.battery is None:
        text = (
            "no voltage was recorded: time constants and rotor model are right with a supply of constant voltage. On a "
            "battery that falls by 5 % under the rotor they may be 15 % off."
        )
        return (warning("steps-supply-unknown", text, "dynamics.*"),)
    most = max(lags, key=lambda lag: 0.0 if lag.battery is None else lag.battery.fell)
    if most.battery is None:
        return ()
    share = most.battery.fell / (1 + most.battery.fell)  # of the voltage at standstill
    text = (
        f"the battery's voltage fell by up to {100 * share:.1f} % under the rotor ({_name(most)}), and by "
        f"the steady speeds the speed of a command goes with its power {most.battery.power:.2f} +- "
        f"{most.battery.power_std:.2f} (0: it does not, 1: in proportion): time constants and rotor model are those "
        "with a supply of constant voltage."
    )
    return (note("steps-battery-sagged", text, "dynamics.*"),)


def _of_row(lag: StepFit) -> Sequence[Finding]:
    """Return why a step's row was rejected, as warnings, since the key has other rows."""
    return [replace(one, severity="warning", where=(_name(lag),)) for one in lag.findings]


def _without_lag(lags: Sequence[StepFit]) -> dict[str, Finding]:
    """Return a rejection for each key whose steps no lag describes, or for all keys where a lag describes no step."""
    if not any(lag.accepted for lag in lags):
        return {"dynamics.*": rejection("no-lag-fits", "no step is described by a first-order lag.", "dynamics.*")}
    lost = {key: way for key, way in _WAYS.items() if not any(lag.accepted for lag in lags if lag.rising == way)}
    return {
        key: rejection("no-lag-fits", f"no {key.partition('.')[2]} step is described by a first-order lag.", key)
        for key, way in lost.items()
        if any(lag.rising == way for lag in lags)
    }


def _implausible(lags: Sequence[StepFit]) -> tuple[Finding, ...]:
    """Reject steps with time constants that no quadrocopter's rotor has: their times are in another unit."""
    middle_s = median(lag.time_constant_s for lag in lags) if lags else _SLOWEST_S
    if middle_s <= _SLOWEST_S:
        return ()
    text = (
        f"the steps' time constants are {middle_s:.3g} s in the middle (limit {_SLOWEST_S:g} s), and rotors "
        "have 0.01 to 0.3 s: is the time column in another unit?"
    )
    return (rejection("implausible", text, "dynamics.*"),)


def _name(lag: StepFit) -> str:
    return f"command {lag.step.command_from:.0f} to {lag.step.command_to:.0f}"


def _line(lag: StepFit) -> str:
    delay = "" if isnan(lag.delay_std_s) else f", {delay_text(lag.delay_s, lag.delay_std_s)}"
    return f"{_name(lag)}: {1e3 * lag.time_constant_s:.0f} +- {1e3 * lag.time_constant_std_s:.1f} ms{delay}"


def _quantities(lags: Sequence[StepFit], model: RotorModel) -> dict[str, Parameter]:
    rows = [
        {
            "cmd_from": lag.step.command_from,
            "cmd_to": lag.step.command_to,
            "rising": lag.rising,
            "time_constant_s": lag.time_constant_s,
            "std_s": lag.time_constant_std_s,
            "delay_s": None if isnan(lag.delay_std_s) else lag.delay_s,
            "accepted": lag.accepted,
        }
        for lag in lags
    ]
    return {
        "dynamics.rising": Parameter(value=list(model.rising), std=list(model.rising_std)),
        "dynamics.falling": Parameter(value=list(model.falling), std=list(model.falling_std)),
        _ROWS: Parameter(value=rows),
    }
