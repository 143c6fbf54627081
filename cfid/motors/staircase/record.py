"""Drives motors through a staircase; where the operator reads an instrument, each command is held until the reading."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from cfid.console.live import LiveLine
from cfid.counted import counted
from cfid.motors.plan import StaircasePlan
from cfid.motors.typed import Expected
from cfid.rig.hand_held import Readings
from cfid.rig.hardware import Hardware
from cfid.rig.motor_commands import MotorCommands, four
from cfid.rig.motors import STILL
from cfid.rig.questions import LATE, UNDO, Answer, Questions
from cfid.rig.run import Procedure

_LAST = "Enter ends, u undoes {value:g}"

Tell = Callable[[str], None]  # takes the procedure's progress, for the live line
Ask = Callable[[int], Awaitable[float | Answer | None]]  # a reading; None leaves it out
Resumed = Callable[[int], Awaitable[object]]  # done when the operator resumes a command after a pause
Undone = Callable[[], Awaitable[bool]]  # whether the operator takes the last reading back before the end


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
            found = bool(readings.values) and await questions.undone(_LAST.format(value=readings.values[-1]))
            live.ask("")
            return found

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
