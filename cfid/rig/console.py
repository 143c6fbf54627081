"""The thesis' console (C.2.1), with keys: what is typed becomes commands for the motors, and a stop always works."""

from collections import deque
from dataclasses import dataclass
from typing import Any

from twisted.internet.defer import CancelledError, Deferred

from cfid.errors import ConfigError
from cfid.rig.keyboard import DOWN, ESCAPE, UP, Keyboard, edited
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.motors import STILL, Four, Limits
from cfid.rig.recorder import Say
from cfid.units import MOTORS

HELP = (
    "1 3 20000        motors 1 and 3 to 20000         1 20000, 3 15000   each its own\n"
    "a 20000          all motors                      18000              the motors named last\n"
    "up, down         500 more, 500 less\n"
    "space, Enter, s  stop (s at any time)            q, Ctrl-D          stop and quit"
)
STEP = 500  # of the arrow keys

_STOPS = {"", "s", "p", "stop"}
_QUITS = {"q", "quit", "exit"}
_ALL = {"a", "all"}
_STOP_KEYS = {"s", "p", "q", ESCAPE}  # at once, wherever the line stands
_LETTERS = set("0123456789 ,alAL")  # of an order


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
    limits.check_four((m1, m2, m3, m4))
    return Order((m1, m2, m3, m4), tuple(chosen))


def nudged(before: Order, key: str, limits: Limits) -> Order:
    """Return what an arrow key orders: a little more or less for the motors named last, within the limits.

    From zero they step to the slowest command that the vehicle's rotors allow, and from there back to zero.
    """
    turning = [motor for motor, command in zip(MOTORS, before.commands, strict=True) if command]
    slowest = limits.slowest_command(sorted({*turning, *before.chosen}))

    def step(command: int) -> int:
        if key == UP:
            return min(max(command + STEP, slowest), limits.largest_command)
        return command - STEP if command - STEP >= slowest else 0

    m1, m2, m3, m4 = (
        max(step(command), 0) if motor in before.chosen else command
        for motor, command in zip(MOTORS, before.commands, strict=True)
    )
    return Order((m1, m2, m3, m4), before.chosen)


class Console:
    """Obeys the keyboard. A stop goes before everything that was typed and is not done yet."""

    def __init__(self, commands: MotorCommands, limits: Limits, *, loop: Any, tell: Say, say: Say) -> None:
        """Take motors that stand; `tell` shows them and what is typed, `say` says a sentence."""
        self._commands, self._limits, self._tell, self._say = commands, limits, tell, say
        self._keyboard = Keyboard(self._hear, loop=loop, keys=True)
        self._waiting: deque[str | None] = deque()  # lines, arrows and stops; None for the end of the input
        self._woken: Deferred[None] = Deferred()
        self._doing: Deferred[None] | None = None
        self._overtaken = False  # what was being done, by a stop
        self._now, self._typed = Order(STILL, ()), ""

    async def run(self) -> None:
        """Obey until the operator quits or the input ends.

        At a terminal nonsense stops the motors and is answered with a sentence; in a script it raises ConfigError.
        """
        self._keyboard.open()  # what was typed before is discarded: nobody had read yet what the keys do
        self._say(HELP)
        try:
            while not self._now.quit:
                self._show()
                if not self._waiting:
                    self._woken = Deferred()
                    await self._woken
                heard = self._waiting.popleft()
                if heard is None:
                    return
                await self._obey(self._wanted(heard))
        finally:
            self._keyboard.close()

    def _hear(self, heard: str | None) -> None:
        if heard is None and self._keyboard.keys:  # Ctrl-D, or the terminal hung up
            self._stop("q")
        elif not self._keyboard.keys or heard is None or heard in (UP, DOWN):
            self._add(heard)
        elif self._stops(heard):
            self._typed = ""
            self._stop(heard)
        else:
            line, self._typed = edited(self._typed, heard, allowed=_LETTERS)
            if line is not None:
                self._add(line) if line.strip() else self._stop("")
        self._show()

    def _stops(self, key: str) -> bool:
        """Return whether a key stops at once, whatever is half typed; a single space separates numbers."""
        return key.lower() in _STOP_KEYS or (key == " " and (not self._typed or self._typed.endswith(" ")))

    def _stop(self, key: str) -> None:
        self._waiting.clear()
        if self._doing is not None:
            self._overtaken = True
            self._doing.cancel()
        self._add("q" if key.lower() == "q" else "")

    def _add(self, heard: str | None) -> None:
        self._waiting.append(heard)
        if not self._woken.called:
            self._woken.callback(None)

    async def _obey(self, wanted: Order) -> None:
        try:
            self._limits.check_four(wanted.commands)
        except ConfigError as error:  # one motor that stops may leave the others too slow
            self._say(f"{error} The motors are stopped.")
            wanted = Order(STILL, wanted.chosen)
        self._now = wanted
        self._doing = Deferred.fromCoroutine(self._commands.set(wanted.commands))
        try:
            await self._doing
        except CancelledError:
            if not self._overtaken:
                raise
        finally:
            self._doing, self._overtaken = None, False

    def _wanted(self, heard: str) -> Order:
        if heard in (UP, DOWN):
            return self._nudged(heard)
        try:
            return order(heard, self._now, self._limits)
        except ConfigError as error:
            if not self._keyboard.keys:
                raise
            self._say(f"{error} The motors are stopped.")
            return Order(STILL, self._now.chosen)

    def _nudged(self, key: str) -> Order:
        """Take together all arrow keys that wait."""
        found = nudged(self._now, key, self._limits)
        while self._waiting and self._waiting[0] in (UP, DOWN):
            found = nudged(found, str(self._waiting.popleft()), self._limits)
        return found

    def _show(self) -> None:
        shown = "  ".join(f"m{motor} {command}" for motor, command in zip(MOTORS, self._now.commands, strict=True))
        self._tell(f"{shown} > {self._typed}")


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
