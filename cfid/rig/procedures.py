"""Drives the motors while everything records: staircases, sines and pings, each a coroutine."""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any

from twisted.internet.defer import Deferred

from cfid.rig.crossings import Crossings
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.motors import STILL, Four
from cfid.rig.pings import Pings
from cfid.rig.recorder import sleep
from cfid.units import MOTORS
from cfid.wire.app import SAMPLES_PER_S, SineRequest

Tell = Callable[[str], None]  # takes the procedure's progress, for the live line
Ask = Callable[[int], Awaitable[float | None]]  # returns the operator's reading at a command; None leaves it out

SINE_REST_S = 1.0  # from the motors' stop to the vehicle's report of it


@dataclass(frozen=True, kw_only=True)
class StaircasePlan:
    """Commands in turn for some of the motors, each held, with a pause (motors off) before, between and after."""

    steps: tuple[int, ...]
    motors: tuple[int, ...]
    hold_s: float
    rest_s: float

    @property
    def duration_s(self) -> float:
        """How long it takes."""
        return self.rest_s + len(self.steps) * (self.hold_s + self.rest_s)

    @property
    def asked(self) -> dict[str, Any]:
        """Its entry in run.toml."""
        return {"steps": self.steps, "motors": self.motors, "hold_s": self.hold_s, "rest_s": self.rest_s}

    def commands(self, step: int) -> Four:
        """Return the commands of the four motors at a step."""
        return four(step, self.motors)


def four(command: int, motors: Sequence[int]) -> Four:
    """Return the four commands: `command` for some of the motors 1 to 4, zero for the others."""
    m1, m2, m3, m4 = (command if motor in motors else 0 for motor in MOTORS)
    return m1, m2, m3, m4


async def run_staircase(stairs: StaircasePlan, commands: MotorCommands, *, loop: Any, tell: Tell) -> None:
    """Hold each command, then pause (section 3.3.1); other times are recorded as pauses."""
    await sleep(loop, stairs.rest_s)
    for count, step in enumerate(stairs.steps):
        left_s = (len(stairs.steps) - count) * (stairs.hold_s + stairs.rest_s)
        tell(f"command {step} ({count + 1} of {len(stairs.steps)}), {clock(left_s)} left")
        await commands.set(stairs.commands(step))
        await sleep(loop, stairs.hold_s)
        await commands.set(STILL)
        await sleep(loop, stairs.rest_s)


async def nothing() -> None:
    """Do nothing: the end of a procedure stops the motors."""


async def hold(commands: MotorCommands, command: int, motors: Sequence[int], *, for_s: float | None, loop: Any) -> None:
    """Hold one command for `for_s` seconds, or until the procedure is cancelled."""
    await commands.set(four(command, motors))
    await (Deferred[None]() if for_s is None else sleep(loop, for_s))


async def read_at_steps(
    stairs: StaircasePlan,
    commands: MotorCommands,
    note: Callable[[int, float], None],
    ask: Ask,
    *,
    loop: Any,
    tell: Tell,
) -> None:
    """Hold each command until the operator has read an instrument, then pause (sections 3.3.1 and 3.3.2)."""
    for count, step in enumerate(stairs.steps):
        tell(f"command {step} ({count + 1} of {len(stairs.steps)})")
        await commands.set(stairs.commands(step))
        await sleep(loop, stairs.hold_s)
        value = await ask(step)
        if value is not None:
            note(step, value)
        await commands.set(STILL)
        await sleep(loop, stairs.rest_s)


async def play_sine(request: SineRequest, crossings: Crossings, *, before_s: float, loop: Any, tell: Tell) -> None:
    """Pause, which gives the load cell's bias, then play one sine to its end (section 3.4.2)."""
    await sleep(loop, before_s)
    tell(f"playing, {clock(request.samples / SAMPLES_PER_S + SINE_REST_S)} left")
    await crossings.play(request)


async def ping_often(pings: Pings, *, count: int, every_s: float, loop: Any, tell: Tell) -> None:
    """Ping on a grid, one at a time (C.2.6)."""
    began_s = loop.seconds()
    for number in range(count):
        tell(f"ping {number + 1} of {count}, {clock((count - number) * every_s)} left")
        await pings.ping()
        await sleep(loop, max(began_s + (number + 1) * every_s - loop.seconds(), 0.0))


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
