"""Records a staircase of motor commands: with the load cell, or with an instrument that shows speed or weight."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from cfid.console.live import LiveLine
from cfid.console.quick_look import NOT_READ, quick
from cfid.console.recording import Found, KeepOptions, Rig, effort_of, nothing_found, record
from cfid.console.vehicle import ExperimentOptions, confirm, reach, refuse
from cfid.console.verdicts import Judge
from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.motors.during import Steps
from cfid.motors.plan import StaircasePlan
from cfid.motors.typed import Expected, expected_of
from cfid.records.run import Label
from cfid.rig.device import Device
from cfid.rig.hand_held import Readings
from cfid.rig.log import Plan, Procedure
from cfid.rig.loop import Loop
from cfid.rig.motor_commands import MotorCommands, four
from cfid.rig.motors import STILL
from cfid.rig.questions import UNDO, Answer, Questions
from cfid.rig.ready_instruments import ready_instrument, ready_scales, ready_tachometer, typed_readings
from cfid.rig.ready_sensors import ready_loadcell
from cfid.rig.ready_vehicle import ReadyVehicle
from cfid.rig.recorder import Say, sleep

_ROWS_A_SECOND = 200  # of the vehicle's log and what instruments add
_LAST = "Enter ends, u undoes {value:g}"

Tell = Callable[[str], None]  # takes the procedure's progress, for the live line
Ask = Callable[[int], Awaitable[float | Answer | None]]  # the operator's reading at a command; None leaves it out
Undone = Callable[[], Awaitable[bool]]  # whether the operator takes the last reading back before the end


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
    calm: bool = True,
    requested: Mapping[str, Any] | None = None,
    found: Found = nothing_found,
) -> None:
    """Record load cell, commands and the vehicle's log during a staircase; a `question` is put at each command.

    In a wind it is not `calm`: noise has no limit then. `requested` goes into run.toml with the staircase. Raises
    ConfigError or DeviceError.
    """
    _, devices, simulated = rig
    cell = devices.loadcell.sampled_at(rate_hz)
    live = LiveLine(quiet=keep.quiet)
    with ExitStack() as held:
        loadcell = ready_loadcell(cell, held, buffered=True, bias=False, say=live.say, patient=False)
        crazyflie = reach(vehicle, devices, held, simulated=simulated)
        crazyflie.limits.refuse_idling(staircase.motors)
        effort = _effort(staircase, rig, rate_hz=cell.rate_hz + 1000 / log_ms)
        refuse(crazyflie, staircase.motors, staircase.steps)
        looked_at = [loadcell, crazyflie.usual_log(log_ms)]
        effort += NOT_READ if vehicle.no_preflight else _quick(looked_at, staircase, rig, calm=calm)
        confirm(crazyflie, staircase.motors, staircase.steps, yes=vehicle.yes, effort=effort, ring=live.ring)
        parts = [crazyflie.commands(), loadcell, *crazyflie.watch(log_ms)]
        if question is not None:
            parts.append(typed_readings("rpm"))
        procedure = _procedure(staircase, question, live, _expected(staircase, rig, "rpm"), tare=True)
        plan = _plan(kind, staircase, rig, note=note, procedure=procedure, requested=requested or {}, question=question)
        counts_per_n = (loadcell.record.model_extra or {}).get("counts_per_n")  # None of a cell that sends lines
        notice = Steps(counts_per_n) if calm and counts_per_n else None
        plan = replace(plan, notice=notice, asks=question is not None, tare_s=staircase.rest_s)
        record(f"log {kind}", plan, parts, live, keep, judge=judge, found=found)


def _quick(devices: Sequence[Device], staircase: StaircasePlan, rig: Rig, *, calm: bool = True) -> str:
    return quick(devices, staircase.held, mass_kg=rig[0].rig.vehicle.mass_kg, calm=calm)


def record_speed(
    staircase: StaircasePlan,
    rig: Rig,
    *,
    tachometer: str,
    port: str | None,
    vehicle: ExperimentOptions,
    log_ms: int,
    keep: KeepOptions,
    note: str | None,
    judge: Judge,
) -> None:
    """Record rotor speeds in a staircase: `typed`, a `ut372`'s, `lines`, the RPM `deck`'s or of `brushless` motors.

    Raises ConfigError or DeviceError.
    """

    def instrument(crazyflie: ReadyVehicle, held: ExitStack, say: Say) -> list[Device]:
        if tachometer == "ut372":
            return [crazyflie.usual_log(log_ms), ready_tachometer(port)]
        if tachometer == "lines":
            sender = rig[1].tachometer
            if sender is None:
                raise ConfigError("`tachometer` lines: rig.toml has no table [devices.tachometer] that names it.")
            return [crazyflie.usual_log(log_ms), ready_instrument("tachometer", sender, held, say=say)]
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
    baud: int,
    vehicle: ExperimentOptions,
    log_ms: int,
    keep: KeepOptions,
    note: str | None,
    judge: Judge,
) -> None:
    """Record during a staircase what scales at a serial port show, or else what the operator types.

    Without a port, scales that send lines are those of rig.toml. Raises ConfigError or DeviceError.
    """

    sender = rig[1].scales if port is None else None

    def instrument(crazyflie: ReadyVehicle, held: ExitStack, say: Say) -> list[Device]:
        log = crazyflie.usual_log(log_ms)
        if sender is not None:
            return [log, ready_instrument("scales", sender, held, say=say)]
        return [log] if port is None else [log, ready_scales(port, baud=baud)]

    question = "grams at command {command}" if port is None and sender is None else None
    _record_readings(
        "scales",
        staircase,
        rig,
        instrument=instrument,
        value="grams",
        question=question,
        requested={},
        vehicle=vehicle,
        keep=keep,
        note=note,
        judge=judge,
    )


def _counting(rig: Rig) -> Rig:
    """Return the rig with the markers that its tachometer of lines counts in place of those of a hand-held one."""
    campaign, devices, simulated = rig
    if devices.tachometer is None:
        return rig
    tachometer = campaign.rig.tachometer.model_copy(update={"markers": devices.tachometer.markers})
    stated = campaign.rig.model_copy(update={"tachometer": tachometer})
    return campaign.model_copy(update={"rig": stated}), devices, simulated


def _record_readings(
    kind: str,
    staircase: StaircasePlan,
    rig: Rig,
    *,
    instrument: Callable[[ReadyVehicle, ExitStack, Say], list[Device]],
    value: str,
    question: str | None,
    requested: Mapping[str, Any],
    vehicle: ExperimentOptions,
    keep: KeepOptions,
    note: str | None,
    judge: Judge,
) -> None:
    """Record an instrument that records by itself, or, with a question, one that the operator reads."""
    _, devices, simulated = rig
    live = LiveLine(quiet=keep.quiet)
    with ExitStack() as held:
        crazyflie = reach(vehicle, devices, held, simulated=simulated)
        parts = [crazyflie.commands(), *instrument(crazyflie, held, live.say), crazyflie.supervisor_log()]
        if question is not None:
            parts.append(typed_readings(value))
        effort = _effort(staircase, rig, rate_hz=_ROWS_A_SECOND)
        refuse(crazyflie, staircase.motors, staircase.steps)
        effort += NOT_READ if vehicle.no_preflight else _quick([crazyflie.usual_log()], staircase, rig)
        confirm(crazyflie, staircase.motors, staircase.steps, yes=vehicle.yes, effort=effort, ring=live.ring)
        procedure = _procedure(staircase, question, live, _expected(staircase, rig, value), tare=False)
        plan = _plan(kind, staircase, rig, note=note, procedure=procedure, requested=requested, question=question)
        record(f"log {kind}", plan, parts, live, keep, judge=judge)


def _effort(staircase: StaircasePlan, rig: Rig, *, rate_hz: float) -> str:
    return effort_of(staircase.duration_s, rig[0].runs_folder, rate_hz=rate_hz)


def _plan(
    kind: str,
    staircase: StaircasePlan,
    rig: Rig,
    *,
    note: str | None,
    procedure: Procedure,
    requested: Mapping[str, Any],
    question: str | None,
) -> Plan:
    campaign, _, simulated = rig
    return Plan(
        runs_folder=campaign.runs_folder,
        kind=kind,
        label=Label(note=note),
        procedure=procedure,
        lasts_s=staircase.duration_s if question is None else None,  # nobody knows how long typing takes
        facts=campaign.rig.facts,
        requested={**staircase.to_run(), **requested},
        simulated=simulated,
    )


def _expected(staircase: StaircasePlan, rig: Rig, column: str) -> Expected | None:
    stated = rig[0].rig
    markers, platform = stated.facts.tachometer.markers, stated.vehicle.platform
    return expected_of(column, motors=len(staircase.motors), markers=markers, platform=platform)


def _procedure(
    staircase: StaircasePlan, question: str | None, live: LiveLine, expected: Expected | None, *, tare: bool
) -> Procedure:
    """Return the staircase; the operator is asked at each command, and again where an answer is not `expected`.

    A `tare` is a pause before the first command, and then no question is put about rotors that stand.
    """
    if question is None:
        return lambda there, loop: run_staircase(staircase, there["commands"], loop=loop, tell=live.task)

    live.left(_steps_left(len(staircase.steps)))

    async def read(there: Mapping[str, Any], loop: Loop) -> None:
        questions = Questions(loop=loop, tell=live.ask, say=live.tell)
        readings: Readings = there["readings"]

        async def ask(command: int) -> float | Answer | None:
            if tare and not command:
                return None

            def fault(value: float) -> str:
                if expected is None:
                    return ""
                return expected.fault(value, readings.values, command=command, commands=readings.commands)

            live.ring()
            undo = f" (u undoes {readings.values[-1]:g})" if readings.values else ""
            answer = await questions.number(question.format(command=command) + undo, fault)
            live.ask("")
            return answer

        async def undone() -> bool:
            live.ring()
            found = bool(readings.values) and await questions.undone(_LAST.format(value=readings.values[-1]))
            live.ask("")
            return found

        questions.open()
        try:
            if tare:
                await sleep(loop, staircase.rest_s)
            await read_at_steps(staircase, there["commands"], readings, ask, undone, loop=loop, live=live)
        finally:
            questions.close()

    return read


def _taken_back(command: int, value: float, *, held: str = "after this one") -> str:
    return f"taken back: {value:g} at command {command}, which is held again {held}."


def _steps_left(count: int) -> str:
    return f"{counted(count, 'step')} left"


async def run_staircase(staircase: StaircasePlan, commands: MotorCommands, *, loop: Any, tell: Tell) -> None:
    """Hold each command, then pause (section 3.3.1); other times are recorded as pauses."""
    await sleep(loop, staircase.rest_s)
    for count, step in enumerate(staircase.steps):
        tell(f"command {step} ({count + 1} of {len(staircase.steps)})")
        await commands.set(four(step, staircase.motors))
        await sleep(loop, staircase.hold_s)
        commands.whole = count + 1 == len(staircase.steps)  # whatever ends it from now on, no step is lost
        await commands.set(STILL)
        await sleep(loop, staircase.rest_s)


async def read_at_steps(
    staircase: StaircasePlan,
    commands: MotorCommands,
    readings: Readings,
    ask: Ask,
    undone: Undone,
    *,
    loop: Any,
    live: LiveLine,
) -> None:
    """Hold each command until the operator has read an instrument, then pause (sections 3.3.1 and 3.3.2).

    A command whose reading is taken back is held again after the present one, that of the last reading at the end.
    """
    left = list(staircase.steps)
    while left:
        live.left(_steps_left(len(left)))
        step = left.pop(0)
        live.task(f"command {step}")
        await commands.set(four(step, staircase.motors))
        await sleep(loop, staircase.hold_s)
        while (value := await ask(step)) is UNDO:
            back = readings.withdraw()
            live.tell("there is no reading to take back." if back is None else _taken_back(*back))
            left = left if back is None else [back[0], *left]
            live.left(_steps_left(1 + len(left)))
        if isinstance(value, float):
            readings.add(step, value)
        readings.whole = not left  # Ctrl-C ends it from now on as Enter does
        await commands.set(STILL)
        await sleep(loop, staircase.rest_s)
        if left:
            continue
        live.left("all steps read")
        live.task("motors off")
        if await undone() and (back := readings.withdraw()) is not None:
            readings.whole = False
            live.tell(_taken_back(*back, held="now"))
            left = [back[0]]
