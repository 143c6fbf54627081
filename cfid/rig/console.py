"""The thesis' console (C.2.1), with keys: what is typed becomes commands for the motors, and a stop always works."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from twisted.internet.defer import DeferredQueue

from cfid.errors import ConfigError
from cfid.rig.keyboard import DOWN, UP, Keyboard, edited
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.motors import MOTORS, STILL, Four, Limits

HELP = (
    "1 3 20000        motors 1 and 3 to 20000         1 20000, 3 15000   each its own\n"
    "a 20000          all motors                      18000              the motors named last\n"
    "up, down         500 more, 500 less\n"
    "space, Enter, s  stop                            q                  stop and quit"
)
STEP = 500  # of the arrow keys

_STOPS = {"", "s", "p", "stop"}
_QUITS = {"q", "quit", "exit"}
_ALL = {"a", "all"}


@dataclass(frozen=True)
class Order:
    """What the motors shall do, and which of them the arrow keys are for from now on."""

    commands: Four
    chosen: tuple[int, ...]
    quit: bool = False


def order(line: str, before: Order, limits: Limits) -> Order:
    """Return what a typed line orders. Raises ConfigError for one that makes no sense, or beyond the limits."""
    word = line.strip().lower()
    if word in _QUITS:
        return Order(STILL, before.chosen, quit=True)
    if word in _STOPS:
        return Order(STILL, before.chosen)
    chosen: list[int] = []
    commands = dict(zip(MOTORS, before.commands, strict=True))
    for part in word.split(","):
        motors, command = _part(part, before.chosen)
        limits.check(command, command)
        commands |= dict.fromkeys(motors, command)
        chosen += motors
    m1, m2, m3, m4 = commands.values()
    return Order((m1, m2, m3, m4), tuple(chosen))


def nudged(before: Order, key: str, limits: Limits) -> Order:
    """Return what an arrow key orders: a little more or less for the motors named last, within the limits."""
    more = STEP if key == UP else -STEP
    m1, m2, m3, m4 = (
        min(max(command + more, 0), limits.largest_command) if motor in before.chosen else command
        for motor, command in zip(MOTORS, before.commands, strict=True)
    )
    return Order((m1, m2, m3, m4), before.chosen)


async def run_console(
    commands: MotorCommands, limits: Limits, *, loop: Any, tell: Callable[[str], None], say: Callable[[str], None]
) -> None:
    """Obey the keyboard until the operator quits or the input ends.

    At a terminal nonsense is answered with a sentence; in a script it raises ConfigError, which stops the motors.
    """
    heard: DeferredQueue[str | None] = DeferredQueue()
    keyboard = Keyboard(heard.put, loop=loop, keys=True)
    now, typed = Order(STILL, ()), ""
    keyboard.open()
    try:
        while not now.quit:
            tell(f"{_shown(now)} > {typed}")
            key = await heard.get()
            if key is None:
                return
            line, typed = (key, "") if not keyboard.keys or _at_once(typed, key) else edited(typed, key)
            try:
                if key in (UP, DOWN) and keyboard.keys:
                    now = nudged(now, key, limits)
                elif line is not None:
                    now = order(line, now, limits)
                else:
                    continue
            except ConfigError as error:
                if not keyboard.keys:
                    raise
                say(str(error))
                continue
            await commands.set(now.commands)
    finally:
        keyboard.close()


def _part(part: str, before: tuple[int, ...]) -> tuple[tuple[int, ...], int]:
    """Return motors and command of `1 3 20000`, `a 20000` or `20000`."""
    *named, last = part.split() or [""]
    try:
        command = int(last)
        motors = MOTORS if named and named[0] in _ALL else tuple(int(word) for word in named) or before
    except ValueError:
        raise ConfigError(f"'{part.strip()}' is no order. There are:\n{HELP}") from None
    if not motors:
        raise ConfigError(f"'{part.strip()}' names no motor: `1 3 20000` does.")
    for motor in motors:
        if motor not in MOTORS:
            raise ConfigError(f"'{part.strip()}': motors are 1 to 4, not {motor}.")
    return motors, command


def _at_once(typed: str, key: str) -> bool:
    """Return whether a key is an order by itself: a stop waits for no Enter."""
    return not typed and key.lower() in (" ", "s", "q")


def _shown(now: Order) -> str:
    return "  ".join(f"m{motor} {command}" for motor, command in zip(MOTORS, now.commands, strict=True))
