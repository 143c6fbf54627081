"""Records a staircase of motor commands: with the load cell, or with an instrument that shows speed or weight."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cfid.console.live import LiveLine
from cfid.console.recording import Found, Rig, effort_of
from cfid.console.recording import record as record_instruments
from cfid.console.run_summary import Judge
from cfid.console.signals import NOT_READ, quick
from cfid.console.vehicle import LOG_MS, confirm, reach, refuse
from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.motors.plan import WAIT_S, Expected, StaircasePlan, expected_of
from cfid.records.rig_file import LoadCellDevice
from cfid.records.run import Label
from cfid.rig.hand_held import Readings, Scales, Ut372, find_ut372
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Instrument, Say
from cfid.rig.loadcell import ready_loadcell
from cfid.rig.motor_commands import MotorCommands, four
from cfid.rig.motors import STILL
from cfid.rig.questions import LATE, UNDO, Answer, Questions
from cfid.rig.ready_vehicle import ReadyVehicle
from cfid.rig.run import Plan, Procedure
from cfid.rig.text_lines import ready_lines

Instruments = Callable[[ReadyVehicle, ExitStack, Say], list[Instrument]]
Tell = Callable[[str], None]  # takes the procedure's progress, for the live line
Ask = Callable[[int], Awaitable[float | Answer | None]]  # a reading; None leaves it out
Resumed = Callable[[int], Awaitable[object]]  # done when the operator resumes a command after a pause
Undone = Callable[[], Awaitable[bool]]  # whether the operator takes the last reading back before the end

_RESTS_ON = {  # the facts of the rig that a fit takes with a run, by its kind
    "thrust": ("loadcell",),
    "speed": ("tachometer",),
    "scales": ("scales",),
    "wind": ("loadcell", "tachometer", "wind"),
}
_ROWS_A_SECOND = 200  # of the vehicle's log and the instruments together
_LAST = "Enter ends, u undoes {value:g}"
_FZ = 3  # among the columns of a load cell's rows, `t` the first
_WRONG_STEPS = 2  # consecutive ones, after which the operator is warned
_LEAST_COMMAND = 8000  # a smaller one gives too little thrust to be sure
_FEWEST_BLOCKS = 12
_UNFELT = "no thrust is felt"
_DRIFT = 0.05  # of a step's height, as the fit allows in a window
_SURE = 4.0  # standard uncertainties


@dataclass(frozen=True, kw_only=True)
class StaircaseRecording:
    """A staircase to record on a rig, as the operator wants it.

    With a `question`, it is asked at each command. Without `preflight`, no look at the signals precedes the staircase.
    One in wind is not `calm`, and its noise has no limit. `requested` goes into run.toml with the staircase.
    """

    kind: str
    staircase: StaircasePlan
    rig: Rig
    uri: str | None
    preflight: bool
    note: str | None
    judge: Judge
    question: str | None = None
    calm: bool = True
    requested: Mapping[str, Any] = field(default_factory=dict)
    found: Found | None = None


def record_forces(wanted: StaircaseRecording, *, rate_hz: int | None) -> None:
    """Record load cell, commands and the vehicle's log during a staircase. Raises ConfigError or DeviceError."""
    _record(wanted, cell=wanted.rig.devices.loadcell.sampled_at(rate_hz))


def record_speed(wanted: StaircaseRecording, *, tachometer: str, port: str | None) -> None:
    """Record rotor speeds in a staircase; `tachometer` is `typed`, `ut372`, `lines`, the RPM `deck` or `brushless`.

    Raises ConfigError or DeviceError.
    """
    rig = wanted.rig

    def instruments(crazyflie: ReadyVehicle, held: ExitStack, say: Say) -> list[Instrument]:
        if tachometer == "ut372":
            return [crazyflie.usual_log(LOG_MS), Ut372(port or find_ut372(rig.hardware))]
        if tachometer == "lines":
            sender = rig.devices.tachometer
            if sender is None:
                raise ConfigError("`tachometer` lines: rig.toml has no table [devices.tachometer] that names it.")
            lines = ready_lines("tachometer", sender, rig.hardware, held, say=say, patient=False)
            return [crazyflie.usual_log(LOG_MS), lines]
        if tachometer == "typed":
            return [crazyflie.usual_log(LOG_MS)]
        return [crazyflie.speed_log(LOG_MS, deck=tachometer == "deck")]

    wanted = replace(
        wanted,
        rig=_with_markers(rig) if tachometer == "lines" else rig,
        question="RPM at command {command}" if tachometer == "typed" else None,
        requested={"tachometer": tachometer},
    )
    _record(wanted, instruments=instruments)


def record_scales(wanted: StaircaseRecording, *, port: str | None, baud: int) -> None:
    """Record what scales at a serial port show during a staircase, or else what the operator types.

    Without a port, the scales that rig.toml names are used if they send lines. Raises ConfigError or DeviceError.
    """
    sender = wanted.rig.devices.scales if port is None else None

    def instruments(crazyflie: ReadyVehicle, held: ExitStack, say: Say) -> list[Instrument]:
        log = crazyflie.usual_log(LOG_MS)
        if sender is not None:
            return [log, ready_lines("scales", sender, wanted.rig.hardware, held, say=say, patient=False)]
        return [log] if port is None else [log, Scales(port, baud)]

    question = "grams at command {command}" if port is None and sender is None else None
    _record(replace(wanted, question=question), instruments=instruments, reading="grams")


def _with_markers(rig: Rig) -> Rig:
    """Return the rig with the markers of its tachometer that sends lines in place of those of a hand-held one."""
    sender, stated = rig.devices.tachometer, rig.campaign.rig
    if sender is None:
        return rig
    tachometer = stated.tachometer.model_copy(update={"markers": sender.markers})
    stated = stated.model_copy(update={"tachometer": tachometer})
    return rig._replace(campaign=rig.campaign.model_copy(update={"rig": stated}))


def _record(
    wanted: StaircaseRecording,
    *,
    cell: LoadCellDevice | None = None,
    instruments: Instruments | None = None,
    reading: str = "rpm",
) -> None:
    """Record commands, the load cell or other instruments, the vehicle's states, and readings that are typed."""
    rig, question = wanted.rig, wanted.question
    staircase, stated = wanted.staircase, rig.campaign.rig
    if question is not None:
        staircase = replace(staircase, wait_s=WAIT_S)
    live = LiveLine()
    with ExitStack() as held:
        loadcell = None if cell is None else ready_loadcell(cell, rig.hardware, held, say=live.say, patient=False)
        crazyflie = reach(wanted.uri, rig, held)
        if loadcell is not None:
            crazyflie.limits.refuse_idling(staircase.motors)
            measuring: list[Instrument] = [loadcell, crazyflie.usual_log(LOG_MS)]
        else:
            measuring = instruments(crazyflie, held, live.say) if instruments else []
        parts = [crazyflie.commands(), *measuring, crazyflie.supervisor_log()]
        if question is not None:
            parts.append(Readings(reading))

        def looked_at() -> Sequence[Instrument]:
            return [crazyflie.usual_log()] if loadcell is None else [loadcell, crazyflie.usual_log(LOG_MS)]

        rate_hz = _ROWS_A_SECOND if cell is None else cell.rate_hz + 1000 / LOG_MS
        effort = effort_of(staircase.duration_s, rig.campaign.runs_folder, rate_hz=rate_hz)
        refuse(crazyflie, staircase.motors, staircase.steps)
        if not wanted.preflight:
            effort += NOT_READ
        else:
            supply = rig.devices.crazyflie.supply
            effort += quick(looked_at, staircase.held, rig.hardware, stated.check, supply=supply, calm=wanted.calm)
        confirm(crazyflie, staircase.motors, staircase.steps, effort=effort, ring=live.ring)
        markers, platform = stated.facts.tachometer.markers, stated.vehicle.platform
        expected = expected_of(reading, motors=len(staircase.motors), markers=markers, platform=platform)
        plan = Plan(
            runs_folder=rig.campaign.runs_folder,
            kind=wanted.kind,
            label=Label(note=wanted.note),
            procedure=procedure_of(staircase, question, live, expected, tare=loadcell is not None),
            lasts_s=staircase.duration_s if staircase.wait_s is None else None,  # nobody knows how long typing takes
            asks=question is not None,
            facts=stated.facts.of(*_RESTS_ON[wanted.kind]),
            requested={**staircase.to_run(), **wanted.requested},
            simulated=rig.simulated,
        )
        if loadcell is not None:
            plan = replace(plan, tare_s=staircase.rest_s)
            counts_per_n = (loadcell.record.model_extra or {}).get("counts_per_n")  # None for a cell that sends lines
            if wanted.calm and counts_per_n:
                plan = replace(plan, notice=Steps(counts_per_n))
        record_instruments(
            f"log {wanted.kind}",
            plan,
            parts,
            live,
            hardware=rig.hardware,
            judge=wanted.judge,
            found=wanted.found,
        )


# The procedure


def procedure_of(
    staircase: StaircasePlan, question: str | None, live: LiveLine, expected: Expected | None, *, tare: bool
) -> Procedure:
    """Return the procedure; the operator is asked at each command, and again where an answer is not `expected`.

    With `tare`, a pause precedes the first command, and no question is asked about rotors at rest.
    """
    if question is None:
        return lambda there, hardware: run_staircase(staircase, there["commands"], hardware=hardware, tell=live.task)

    live.left(_steps_left(len(staircase.steps)))

    async def read(there: Mapping[str, Any], hardware: Hardware) -> None:
        questions = Questions(hardware=hardware, tell=live.ask, say=live.tell)
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
            within_s = staircase.wait_s if command else None
            answer = await questions.number(question.format(command=command) + undo, fault, within_s=within_s)
            live.ask("")
            return answer

        async def resumed(command: int) -> None:
            live.ring()
            live.tell(
                f"command {command} was held for {staircase.wait_s:g} s more without a reading: motors paused. Enter "
                "drives it again, then type its reading."
            )
            if line := await questions.line(f"motors off; Enter resumes command {command}"):
                live.tell(f"'{line}' is not used: it was typed while motors were off. Read the instrument again.")

        async def undone() -> bool:
            live.ring()
            withdrawn = bool(readings.values) and await questions.undone(_LAST.format(value=readings.values[-1]))
            live.ask("")
            return withdrawn

        questions.open()
        try:
            if tare:
                await hardware.sleep(staircase.rest_s)
            await read_at_steps(
                staircase, there["commands"], readings, ask, undone, resumed=resumed, hardware=hardware, live=live
            )
        finally:
            questions.close()

    return read


def _taken_back(command: int, value: float, *, held: str = "after this one") -> str:
    return f"taken back: {value:g} at command {command}, which is held again {held}."


def _steps_left(count: int) -> str:
    return f"{counted(count, 'step')} left"


async def run_staircase(staircase: StaircasePlan, commands: MotorCommands, *, hardware: Hardware, tell: Tell) -> None:
    """Hold each command, then pause (section 3.3.1); other times are recorded as pauses."""
    await hardware.sleep(staircase.rest_s)
    for count, step in enumerate(staircase.steps):
        tell(f"command {step} ({count + 1} of {len(staircase.steps)})")
        await commands.set(four(step, staircase.motors))
        await hardware.sleep(staircase.hold_s)
        commands.whole = count + 1 == len(staircase.steps)  # whatever ends it from now on, no step is lost
        await commands.set(STILL)
        await hardware.sleep(staircase.rest_s)


async def read_at_steps(
    staircase: StaircasePlan,
    commands: MotorCommands,
    readings: Readings,
    ask: Ask,
    undone: Undone,
    *,
    resumed: Resumed,
    hardware: Hardware,
    live: LiveLine,
) -> None:
    """Hold each command until the operator has read an instrument, then pause (sections 3.3.1 and 3.3.2).

    A command that nobody reads within the plan's wait ends in a pause, and is held again when the operator resumes. One
    whose reading is taken back is held again after the current one, or, for the last reading, at the end.
    """
    left = list(staircase.steps)

    async def answered(step: int) -> float | Answer | None:
        """Return the answer of an operator, while the line counts down the wait."""
        end_s, count = hardware.seconds() + (staircase.wait_s or 0), _steps_left(1 + len(left))
        live.left(lambda: f"{count}, pause in {max(end_s - hardware.seconds(), 0):.0f} s" if step else count)
        return await ask(step)

    while left:
        live.left(_steps_left(len(left)))
        step = left.pop(0)
        value: float | Answer | None = LATE
        while value is LATE:
            live.task(f"command {step}")
            await commands.set(four(step, staircase.motors))
            await hardware.sleep(staircase.hold_s)
            while (value := await answered(step)) is UNDO:
                back = readings.withdraw()
                live.tell("there is no reading to take back." if back is None else _taken_back(*back))
                left = left if back is None else [back[0], *left]
            if value is LATE:
                await commands.set(STILL)
                live.left(_steps_left(1 + len(left)))
                live.task("motors off")
                await resumed(step)
        if isinstance(value, float):
            readings.add(step, value)
        readings.whole = not left  # from now on Ctrl-C ends the run as Enter does
        await commands.set(STILL)
        await hardware.sleep(staircase.rest_s)
        if left:
            continue
        live.left("all steps read")
        live.task("motors off")
        if await undone() and (back := readings.withdraw()) is not None:
            readings.whole = False
            live.tell(_taken_back(*back, held="now"))
            left = [back[0]]


class Steps:
    """Checks each step when it ends: whether its last two quarters agree, and its height above the pause before it.

    Keeps the mean of each block of rows of the current step, and warns only once.
    """

    def __init__(self, counts_per_n: float) -> None:
        """Take the load cell's scale in counts per N."""
        self._scale = 1e3 / counts_per_n
        self._command = 0
        self._means: list[float] = []
        self._tare: list[float] = []
        self._wrong: list[str] = []
        self._done = False

    def __call__(self, device: str, columns: Sequence[Any]) -> str:
        """Take new rows of the commands or the load cell; return what is wrong, "" for nothing."""
        if self._done:
            return ""
        if device == "loadcell":
            self._means.append(self._scale * float(np.mean(columns[_FZ])))
        if device != "commands":
            return ""
        command = max(int(column[-1]) for column in columns[1:])
        if command == self._command:
            return ""
        self._end_step()
        self._command, self._means = command, []
        if len(self._wrong) < _WRONG_STEPS:
            return ""
        self._done = True
        unfelt = all(text.startswith(_UNFELT) for text in self._wrong)
        advice = (
            "Look at motors, load cell and mount." if unfelt else "Hold longer (`hold`), or look at motors and mount."
        )
        return f"{' '.join(self._wrong)} {advice}"

    def _end_step(self) -> None:
        late = np.array(self._means[len(self._means) // 2 :])
        if not self._command:
            self._tare = late.tolist() or self._tare
        if self._command < _LEAST_COMMAND or len(late) < _FEWEST_BLOCKS or len(self._tare) < 2:
            return
        halves = np.array_split(late, 2)
        change, height = float(halves[1].mean() - halves[0].mean()), float(abs(late.mean() - np.mean(self._tare)))
        std = float(np.std(np.diff(late)) * np.sqrt(2 / len(late)))  # of a difference of means, from neighbours
        std = max(std, float(np.std(self._tare)) / np.sqrt(len(self._tare)))
        if height < _SURE * std:
            self._wrong.append(f"{_UNFELT} at command {self._command}: {height:.2g} mN, noise {std:.2g} mN.")
        elif abs(change) > _DRIFT * height + _SURE * std:
            self._wrong.append(
                f"command {self._command} does not settle: between the last quarters of its hold Fz changes by "
                f"{abs(change):.2g} of {height:.3g} mN (limit {100 * _DRIFT:g} %)."
            )
        else:
            self._wrong = []
