"""`cfid fit dynamics`: how fast rotors follow their commands, from steps."""

from collections.abc import Iterable
from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.options import Delivery, LoadCellOptions, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.errors import CfidError, ConfigError, DataError, FitError
from cfid.findings import Finding, note, rejection, warning
from cfid.motors.vibration.data import quiet_channels
from cfid.records.covariances import covariance_between
from cfid.records.result import Result

if TYPE_CHECKING:
    from cfid.motors.steps.estimation import CommandStep, RotorModel, StepFit
    from cfid.records.parameters import Parameter, Source

_NO_LAG = "no step is described by a first-order lag."
_BLUR_S, _STEP_S = 0.1, 0.02  # of a speed from vibration
_SURE = 0.02  # of a speed: where its standard uncertainty is larger, within a step, it is left out


class Course(NamedTuple):
    """Speeds (n,) in rad/s at times (n,) in seconds, and the commands (m,) that hold from times (m,) on."""

    name: str
    path: Path
    time_s: Any
    speed_rad_s: Any
    command_time_s: Any
    command: Any
    blur_s: float
    findings: tuple[Finding, ...]
    sources: "tuple[Source, ...]"


@flat
def dynamics(
    *,
    runs: Annotated[
        list[str] | None,
        typer.Argument(metavar="RUN ...", help="Runs with steps: speeds reported, or in the vibration."),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="A thrust stand's CSV file with speeds over time.")] = None,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
) -> None:
    """Fit a first-order lag to each step of the command, and the rotor model of four coefficients to all.

    Example: [bold]cfid fit dynamics 2026-11-21_083012_speed[/bold]
    """
    from cfid.motors.steps.estimation import fit_rotor_model, fit_steps

    workplace = open_workplace(rig)
    courses = [] if table is None else [_of_table(table, reading)]
    courses += [_of_run(find_recording(word, workplace), reading, scale) for word in runs or []]
    if not courses:
        raise ConfigError("nothing to fit: give a RUN with steps, or --table FILE.")
    if len(courses) > 1:
        raise ConfigError("several runs have several clocks: give one at a time.")
    course = courses[0]
    try:
        steps, missed = _steps(course)
        values = {"time_s": course.time_s, "value": course.speed_rad_s, "steps": steps, "blur_s": course.blur_s}
        lags, model = fit_steps(**values), fit_rotor_model(**values)
    except CfidError as error:
        raise type(error)(f"{course.path}: {error}") from None
    _tell(course._replace(findings=(*course.findings, *missed)), lags, model, workplace, delivery)


def _steps(course: Course) -> "tuple[tuple[CommandStep, ...], list[Finding]]":
    """Return the steps that the speeds show, and a finding on the others."""
    import numpy as np

    from cfid.motors.steps.estimation import command_steps, followed

    place = np.searchsorted(course.command_time_s, course.time_s, side="right") - 1
    held = np.where(place >= 0, course.command[np.maximum(place, 0)], 0.0)
    steps = command_steps(time_s=course.time_s, command=held)
    seen = followed(steps, time_s=course.time_s, value=course.speed_rad_s)
    if steps and not seen:
        raise FitError(f"of {len(steps)} steps none shows speeds enough to follow it: hold each command longer.")
    missed = len(steps) - len(seen)
    text = f"{missed} of {len(steps)} steps show too few speeds to be followed."
    return seen, [warning("steps-left-out", text, "dynamics.*")] if missed else []


def _recording(notes: Iterable[str]) -> tuple[Finding, ...]:
    return tuple(warning("recording", text) for text in notes)


def _of_table(path: Path, reading: ReadingOptions) -> Course:
    from cfid.records.tables.stand import read_stand_table

    table = read_stand_table(path, rate_hz=reading.rate_hz, skip_lines=reading.skip_lines)
    speed = table.square_mean_speed_rad_s
    if table.time_s is None or speed is None:
        raise DataError(f"{path}: no speeds over time: steps cannot be followed.")
    return Course(
        path.stem, path, table.time_s, speed, table.time_s, table.command, 0.0, _recording(table.notes),
        (table.source,),
    )  # fmt: skip


def _of_run(path: Path, reading: ReadingOptions, scale: LoadCellOptions) -> Course:
    """Take the speeds that the vehicle reported, else those in the load cell's vibration."""
    import numpy as np

    from cfid.records.tables.times import run_at
    from cfid.records.tables.vehicle import VEHICLE_LOG, holds, read_commands, read_rows, told_speeds_rad_s

    run = run_at(path)
    if run is None:
        raise DataError(f"{path}: no run folder; steps need the commands that a run has.")
    log, commands = read_commands(run)
    command = commands.max(axis=1)
    rows = read_rows(run, VEHICLE_LOG) if holds(run, VEHICLE_LOG) else None
    ran = [motor for motor in (1, 2, 3, 4) if commands[:, motor - 1].any()]
    told = {} if rows is None else told_speeds_rad_s(rows)
    if rows is not None and ran and all(motor in told for motor in ran):
        speed = np.mean([told[motor] for motor in ran], axis=0)
        begin_s = rows.time_s[0]
        return Course(
            run.folder.name, run.folder, rows.time_s - begin_s, speed, log.time_s - begin_s, command, 0.0, (),
            (rows.source, log.source),
        )  # fmt: skip
    return _of_vibration(run, log, command, reading, scale)


def _of_vibration(run: Any, log: Any, command: Any, reading: ReadingOptions, scale: LoadCellOptions) -> Course:
    import numpy as np

    from cfid.motors.vibration.ridge import speed_ridge
    from cfid.records.tables.vehicle import begin_s
    from cfid.records.tables.wrench import LOADCELL, read_wrench

    record = read_wrench(run.folder, scale.reading(reading))
    ridge = speed_ridge(
        time_s=record.time_s,
        wrench=quiet_channels(record),
        window_s=_BLUR_S,
        step_s=_STEP_S,
    )
    sure = ridge.std_rad_per_s < _SURE * ridge.speed_rad_per_s  # and not NaN
    speed = np.where(sure, ridge.speed_rad_per_s, np.nan)
    text = "this vehicle reports no speed: it is estimated from the load cell's vibration, and not of standing rotors."
    began_s = begin_s(run.device_file(LOADCELL))
    return Course(
        run.folder.name, run.folder, ridge.time_s, speed, log.time_s - began_s, command, _BLUR_S,
        (*_recording(record.notes), note("speed-from-vibration", text, "dynamics.*")), (record.source, log.source),
    )  # fmt: skip


def _tell(
    course: Course, lags: "tuple[StepFit, ...]", model: "RotorModel", workplace: Workplace, delivery: Delivery
) -> None:
    def drawings() -> dict[str, Any]:
        from cfid.motors.steps.figures import dynamics_figure

        drawn = dynamics_figure(course.time_s, course.speed_rad_s, lags, model, title=course.name)
        return {f"fit_dynamics_{course.name}": drawn}

    rejected = [lag for lag in lags if not lag.accepted]
    deliver(
        Result(
            command="fit dynamics",
            method="default",
            quantities=_parameters(lags, model),
            covariances=covariance_between(
                {"dynamics.rising": list(model.rising), "dynamics.falling": list(model.falling)}, model.covariance
            ),
            quality={"steps": len(lags), "rejected": len(rejected), "explained": model.explained, "rms": model.rms},
            wanted=("dynamics.*",),
            findings=(
                *course.findings,
                *(
                    replace(one, severity="warning", text=f"{_step(lag)}: {one.text}")  # of its row alone
                    for lag in rejected
                    for one in lag.findings
                ),
                *(model.findings if len(rejected) < len(lags) else (rejection("no-lag-fits", _NO_LAG, "dynamics.*"),)),
            ),
            sources=course.sources,
            lines=tuple(
                f"{_step(lag)}: {1e3 * lag.time_constant_s:.0f} +- {1e3 * lag.time_constant_std_s:.1f} ms{_delay(lag)}"
                for lag in lags
                if lag.accepted
            ),
            drawings=drawings,
            folder=workplace.figures_beside([course.path]),
        ),
        delivery,
        workplace.campaign,
    )


def _step(lag: "StepFit") -> str:
    return f"command {lag.step.command_from:.0f} to {lag.step.command_to:.0f}"


def _delay(lag: "StepFit") -> str:
    return "" if isnan(lag.delay_std_s) else f", delay {1e3 * lag.delay_s:.0f} ms"


def _parameters(lags: "tuple[StepFit, ...]", model: "RotorModel") -> "dict[str, Parameter]":
    from cfid.records.parameters import Parameter

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
    unit = "1/s, 1/rad"
    return {
        "dynamics.rising": Parameter(value=list(model.rising), std=list(model.rising_std), unit=unit),
        "dynamics.falling": Parameter(value=list(model.falling), std=list(model.falling_std), unit=unit),
        "dynamics.time_constant_s": Parameter(value=rows, unit="s"),
    }
