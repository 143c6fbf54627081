"""Records a staircase of motor commands: with the load cell, or with an instrument that shows speed or weight."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from cfid.console.live import LiveLine
from cfid.console.options import positive
from cfid.console.quick_look import NOT_READ, quick
from cfid.console.recording import Found, KeepOptions, Rig, effort_of, nothing_found, record
from cfid.console.vehicle import ExperimentOptions, confirm, reach, refuse
from cfid.console.verdicts import Judge
from cfid.errors import ConfigError
from cfid.motors.during import Steps
from cfid.motors.plan import LONGEST_WAIT_S, WAIT_S, StaircasePlan
from cfid.motors.staircase.record import procedure_of
from cfid.motors.typed import Expected, expected_of
from cfid.records.run import Label
from cfid.rig.hand_held import Readings, Scales, Ut372, find_ut372
from cfid.rig.instrument import Instrument, Say
from cfid.rig.loadcell import ready_loadcell
from cfid.rig.ready_vehicle import ReadyVehicle
from cfid.rig.run import Plan, Procedure
from cfid.rig.text_lines import ready_lines

_ROWS_A_SECOND = 200  # of the vehicle's log and the instruments together


def record_forces(
    kind: str,
    staircase: StaircasePlan,
    rig: Rig,
    *,
    vehicle: ExperimentOptions,
    log_ms: int,
    rate_hz: int | None,
    keep: KeepOptions,
    note: str | None,
    judge: Judge,
    question: str | None = None,
    wait: float | None = None,
    calm: bool = True,
    requested: Mapping[str, Any] | None = None,
    found: Found = nothing_found,
) -> None:
    """Record load cell, commands and the vehicle's log during a staircase; a `question` is asked at each command.

    `wait` is how long a command is held for its answer, None for the usual time. A staircase in wind is not `calm`, and
    its noise has no limit. `requested` goes into run.toml with the staircase. Raises ConfigError or DeviceError.
    """
    staircase = _waiting(staircase, wait, question)
    cell = rig.devices.loadcell.sampled_at(rate_hz)
    live = LiveLine(quiet=keep.quiet)
    with ExitStack() as held:
        loadcell = ready_loadcell(cell, rig.hardware, held, say=live.say, patient=False)
        crazyflie = reach(vehicle, rig, held)
        crazyflie.limits.refuse_idling(staircase.motors)
        effort = _effort(staircase, rig, rate_hz=cell.rate_hz + 1000 / log_ms)

        def looked_at() -> list[Instrument]:
            return [loadcell, crazyflie.usual_log(log_ms)]

        refuse(crazyflie, staircase.motors, staircase.steps)
        effort += NOT_READ if vehicle.no_preflight else _quick(looked_at, staircase, rig, calm=calm)
        confirm(crazyflie, staircase.motors, staircase.steps, yes=vehicle.yes, effort=effort, ring=live.ring)
        parts: list[Instrument] = [crazyflie.commands(), loadcell, *crazyflie.watch(log_ms)]
        if question is not None:
            parts.append(Readings("rpm"))
        procedure = procedure_of(staircase, question, live, _expected(staircase, rig, "rpm"), tare=True)
        plan = _plan(kind, staircase, rig, note=note, procedure=procedure, requested=requested or {})
        counts_per_n = (loadcell.record.model_extra or {}).get("counts_per_n")  # None for a cell that sends lines
        plan = replace(plan, asks=question is not None, tare_s=staircase.rest_s)
        if calm and counts_per_n:
            plan = replace(plan, notice=Steps(counts_per_n))
        record(f"log {kind}", plan, parts, live, keep, hardware=rig.hardware, judge=judge, found=found)


def _quick(
    devices: Callable[[], Sequence[Instrument]], staircase: StaircasePlan, rig: Rig, *, calm: bool = True
) -> str:
    return quick(devices, staircase.held, rig.hardware, mass_kg=rig.campaign.rig.vehicle.mass_kg, calm=calm)


def record_speed(
    staircase: StaircasePlan,
    rig: Rig,
    *,
    tachometer: str,
    port: str | None,
    wait: float | None,
    vehicle: ExperimentOptions,
    log_ms: int,
    keep: KeepOptions,
    note: str | None,
    judge: Judge,
) -> None:
    """Record rotor speeds in a staircase; `tachometer` is `typed`, `ut372`, `lines`, the RPM `deck` or `brushless`.

    Raises ConfigError or DeviceError.
    """

    def instrument(crazyflie: ReadyVehicle, held: ExitStack, say: Say) -> list[Instrument]:
        if tachometer == "ut372":
            return [crazyflie.usual_log(log_ms), Ut372(port or find_ut372(rig.hardware))]
        if tachometer == "lines":
            sender = rig.devices.tachometer
            if sender is None:
                raise ConfigError("`tachometer` lines: rig.toml has no table [devices.tachometer] that names it.")
            return [
                crazyflie.usual_log(log_ms),
                ready_lines("tachometer", sender, rig.hardware, held, say=say, patient=False),
            ]
        if tachometer == "typed":
            return [crazyflie.usual_log(log_ms)]
        return [crazyflie.speed_log(log_ms, deck=tachometer == "deck")]

    question = "RPM at command {command}" if tachometer == "typed" else None
    _record_readings(
        "speed",
        staircase,
        _counting(rig) if tachometer == "lines" else rig,
        instrument=instrument,
        value="rpm",
        question=question,
        wait=wait,
        requested={"tachometer": tachometer},
        vehicle=vehicle,
        keep=keep,
        note=note,
        judge=judge,
    )


def record_scales(
    staircase: StaircasePlan,
    rig: Rig,
    *,
    port: str | None,
    wait: float | None,
    baud: int,
    vehicle: ExperimentOptions,
    log_ms: int,
    keep: KeepOptions,
    note: str | None,
    judge: Judge,
) -> None:
    """Record what scales at a serial port show during a staircase, or else what the operator types.

    Without a port, the scales that rig.toml names are used if they send lines. Raises ConfigError or DeviceError.
    """

    sender = rig.devices.scales if port is None else None

    def instrument(crazyflie: ReadyVehicle, held: ExitStack, say: Say) -> list[Instrument]:
        log = crazyflie.usual_log(log_ms)
        if sender is not None:
            return [log, ready_lines("scales", sender, rig.hardware, held, say=say, patient=False)]
        return [log] if port is None else [log, Scales(port, baud)]

    question = "grams at command {command}" if port is None and sender is None else None
    _record_readings(
        "scales",
        staircase,
        rig,
        instrument=instrument,
        value="grams",
        question=question,
        wait=wait,
        requested={},
        vehicle=vehicle,
        keep=keep,
        note=note,
        judge=judge,
    )


def _counting(rig: Rig) -> Rig:
    """Return the rig with the markers of its tachometer that sends lines in place of those of a hand-held one."""
    sender, stated = rig.devices.tachometer, rig.campaign.rig
    if sender is None:
        return rig
    tachometer = stated.tachometer.model_copy(update={"markers": sender.markers})
    stated = stated.model_copy(update={"tachometer": tachometer})
    return rig._replace(campaign=rig.campaign.model_copy(update={"rig": stated}))


def _record_readings(
    kind: str,
    staircase: StaircasePlan,
    rig: Rig,
    *,
    instrument: Callable[[ReadyVehicle, ExitStack, Say], list[Instrument]],
    value: str,
    question: str | None,
    wait: float | None,
    requested: Mapping[str, Any],
    vehicle: ExperimentOptions,
    keep: KeepOptions,
    note: str | None,
    judge: Judge,
) -> None:
    """Record an instrument that is logged automatically or, with a question, one that the operator reads."""
    staircase = _waiting(staircase, wait, question)
    live = LiveLine(quiet=keep.quiet)
    with ExitStack() as held:
        crazyflie = reach(vehicle, rig, held)
        parts: list[Instrument] = [
            crazyflie.commands(),
            *instrument(crazyflie, held, live.say),
            crazyflie.supervisor_log(),
        ]
        if question is not None:
            parts.append(Readings(value))
        effort = _effort(staircase, rig, rate_hz=_ROWS_A_SECOND)
        refuse(crazyflie, staircase.motors, staircase.steps)
        effort += NOT_READ if vehicle.no_preflight else _quick(lambda: [crazyflie.usual_log()], staircase, rig)
        confirm(crazyflie, staircase.motors, staircase.steps, yes=vehicle.yes, effort=effort, ring=live.ring)
        procedure = procedure_of(staircase, question, live, _expected(staircase, rig, value), tare=False)
        plan = _plan(kind, staircase, rig, note=note, procedure=procedure, requested=requested)
        record(f"log {kind}", plan, parts, live, keep, hardware=rig.hardware, judge=judge)


def _waiting(staircase: StaircasePlan, wait: float | None, question: str | None) -> StaircasePlan:
    """Return a staircase whose commands wait so long for typed readings. Raises ConfigError where none are typed."""
    if question is not None:
        return replace(staircase, wait_s=WAIT_S if wait is None else positive(wait, "`wait`", most=LONGEST_WAIT_S))
    if wait is not None:
        raise ConfigError(f"`wait` {wait:g}: no reading is typed here.")
    return staircase


def _effort(staircase: StaircasePlan, rig: Rig, *, rate_hz: float) -> str:
    return effort_of(staircase.duration_s, rig.campaign.runs_folder, rate_hz=rate_hz)


def _plan(
    kind: str,
    staircase: StaircasePlan,
    rig: Rig,
    *,
    note: str | None,
    procedure: Procedure,
    requested: Mapping[str, Any],
) -> Plan:
    return Plan(
        runs_folder=rig.campaign.runs_folder,
        kind=kind,
        label=Label(note=note),
        procedure=procedure,
        lasts_s=staircase.duration_s if staircase.wait_s is None else None,  # nobody knows how long typing takes
        facts=rig.campaign.rig.facts,
        requested={**staircase.to_run(), **requested},
        simulated=rig.simulated,
    )


def _expected(staircase: StaircasePlan, rig: Rig, column: str) -> Expected | None:
    stated = rig.campaign.rig
    markers, platform = stated.facts.tachometer.markers, stated.vehicle.platform
    return expected_of(column, motors=len(staircase.motors), markers=markers, platform=platform)
