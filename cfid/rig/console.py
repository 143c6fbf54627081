"""The thesis' console (C.2.1) with single keys: turns typed lines into motor commands; a stop always works."""

from collections import deque
from dataclasses import dataclass

from twisted.internet.defer import CancelledError, Deferred

from cfid.errors import ConfigError
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Say
from cfid.rig.keyboard import DOWN, ESCAPE, UP, Keyboard, edited
from cfid.rig.motor_commands import MotorCommands
from cfid.rig.motors import STILL, Four, Limits
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
_STOP_KEYS = {"s", "p", "q", ESCAPE}  # at once, whatever has been typed so far
_LETTERS = set("0123456789 ,alAL")  # of an order


@dataclass(frozen=True)
class Order:
    """The motors' commands, and the motors that the arrow keys change from now on."""

    commands: Four
    chosen: tuple[int, ...]
    quit: bool = False


def order(line: str, before: Order, limits: Limits) -> Order:
    """Return the order in a typed line. Raises ConfigError for an invalid one, or one beyond the limits."""
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
    """Return the order of an arrow key: slightly more or less for the motors named last, within the limits.

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
    """Executes what the keyboard orders. A stop overtakes every order that is still waiting."""

    def __init__(self, commands: MotorCommands, limits: Limits, *, hardware: Hardware, tell: Say, say: Say) -> None:
        """Take motors that are off; `tell` shows their commands and the typed text, `say` prints a message."""
        self._commands, self._limits, self._tell, self._say = commands, limits, tell, say
        self._keyboard = Keyboard(self._take, hardware=hardware, keys=True)
        self._waiting: deque[str | None] = deque()  # lines, arrows and stops; None for the end of the input
        self._woken: Deferred[None] = Deferred()
        self._doing: Deferred[None] | None = None
        self._overtaken = False  # a stop cancelled the order in progress
        self._now, self._typed = Order(STILL, ()), ""

    async def run(self) -> None:
        """Execute orders until the operator quits or the input ends.

        At a terminal an invalid order stops the motors and prints a message; in a script it raises ConfigError.
        """
        self._keyboard.open()  # discards what was typed before: the operator had not yet read what the keys do
        self._say(HELP)
        try:
            while not self._now.quit:
                self._show()
                if not self._waiting:
                    self._woken = Deferred()
                    await self._woken
                typed = self._waiting.popleft()
                if typed is None:
                    return
                await self._execute(self._order_of(typed))
        finally:
            self._keyboard.close()

    def _take(self, typed: str | None) -> None:
        if typed is None and self._keyboard.keys:  # Ctrl-D, or the terminal hung up
            self._stop("q")
        elif not self._keyboard.keys or typed is None or typed in (UP, DOWN):
            self._add(typed)
        elif self._stops(typed):
            self._typed = ""
            self._stop(typed)
        else:
            line, self._typed = edited(self._typed, typed, allowed=_LETTERS)
            if line is not None:
                self._add(line) if line.strip() else self._stop("")
        self._show()

    def _stops(self, key: str) -> bool:
        """Return whether a key stops at once, even in a half-typed order; a single space separates numbers."""
        return key.lower() in _STOP_KEYS or (key == " " and (not self._typed or self._typed.endswith(" ")))

    def _stop(self, key: str) -> None:
        self._waiting.clear()
        if self._doing is not None:
            self._overtaken = True
            self._doing.cancel()
        self._add("q" if key.lower() == "q" else "")

    def _add(self, typed: str | None) -> None:
        self._waiting.append(typed)
        if not self._woken.called:
            self._woken.callback(None)

    async def _execute(self, new: Order) -> None:
        try:
            self._limits.check_four(new.commands)
        except ConfigError as error:  # one motor that stops may leave the others too slow
            self._say(f"{error} The motors are stopped.")
            new = Order(STILL, new.chosen)
        self._now = new
        self._doing = Deferred.fromCoroutine(self._commands.set(new.commands))
        try:
            await self._doing
        except CancelledError:
            if not self._overtaken:
                raise
        finally:
            self._doing, self._overtaken = None, False

    def _order_of(self, typed: str) -> Order:
        if typed in (UP, DOWN):
            return self._nudged(typed)
        try:
            return order(typed, self._now, self._limits)
        except ConfigError as error:
            if not self._keyboard.keys:
                raise
            self._say(f"{error} The motors are stopped.")
            return Order(STILL, self._now.chosen)

    def _nudged(self, key: str) -> Order:
        """Combine all waiting arrow keys into one order."""
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
        raise ConfigError(f"'{part.strip()}' is not an order. Orders are:\n{HELP}") from None
    if not motors:
        raise ConfigError(f"'{part.strip()}' names no motor: `1 3 20000` does.")
    for motor in motors:
        if motor not in MOTORS:
            raise ConfigError(f"'{part.strip()}': motors are 1 to 4, not {motor}.")
    return motors, command
