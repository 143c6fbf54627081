"""Asks the operator for readings of an instrument while motors run and everything records."""

from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from typing import Final, NoReturn

from twisted.internet.defer import CancelledError, Deferred, DeferredQueue

from cfid.errors import ConfigError
from cfid.rig.hardware import Hardware
from cfid.rig.keyboard import Keyboard, edited

_UNDO = ("u", "undo")
_UNUSED = "not used: every step is read"


class Answer(Enum):
    """An operator's answer that is not a number."""

    UNDO = "take the last reading back"
    LATE = "no answer in time"


UNDO: Final = Answer.UNDO
LATE: Final = Answer.LATE


class Questions:
    """Asks for numbers, one after the other. At a terminal `tell` shows the typed text; a script answers in lines."""

    def __init__(self, *, hardware: Hardware, tell: Callable[[str], None], say: Callable[[str], None]) -> None:
        """Take the functions that show questions and print messages."""
        self._tell, self._say, self._hardware = tell, say, hardware
        self._typed: DeferredQueue[str | None] = DeferredQueue()
        self._keyboard = Keyboard(self._typed.put, hardware=hardware, keys=True)

    def open(self) -> None:
        """Listen to the keyboard from now on."""
        self._keyboard.open()

    def close(self) -> None:
        """Stop listening."""
        self._keyboard.close()

    async def number(
        self, what: str, fault: Callable[[float], str] = lambda value: "", *, within_s: float | None = None
    ) -> float | Answer | None:
        """Return the number typed, None for an empty line, which means no reading, UNDO for u or undo.

        LATE if nothing was typed `within_s`; a line that was begun is forgotten.

        Asks again after an invalid line, and once after a number for which `fault` returns a reason: typed again, it
        counts. For a script, the reason is only printed, and its number counts. Raises ConfigError when the input ends,
        or when a script's line is invalid.
        """
        answer = Deferred.fromCoroutine(self._number(what, fault))
        is_late = False

        def end() -> None:
            nonlocal is_late
            is_late = True
            answer.cancel()

        timer = None if within_s is None else self._hardware.later(within_s, end)
        try:
            return await answer
        except CancelledError:
            if not is_late:
                raise
            return LATE
        finally:
            if timer is not None and timer.active():
                timer.cancel()

    async def _number(self, what: str, fault: Callable[[float], str]) -> float | Answer | None:
        questioned: float | None = None
        line = await self.line(what)
        while True:
            if not line:
                return None
            if line.lower() in _UNDO:
                return UNDO
            value = _reading(line)
            if value is None:
                wrong = (
                    f"'{line}' is not a reading: type a number, nothing where there is none, u to take the last back."
                )
                if not self._keyboard.keys:
                    raise ConfigError(wrong)
                self._say(wrong)
            else:
                reason = fault(value)
                if not reason or value == questioned:
                    return value
                if not self._keyboard.keys:
                    self._say(reason)
                    return value
                self._say(f"{reason} Type it again to keep it, or the right one.")
                questioned = value
            line = await self._line(what)

    async def undone(self, what: str) -> bool:
        """Return whether u or undo is typed rather than Enter; the end of the input counts as Enter.

        A script is not waited for: only the lines that it has already written count.
        """
        with suppress(ConfigError):
            await self._forget_typed(what)
            while self._keyboard.keys or self._typed.pending:
                line = await self._line(what)
                if line.lower() in _UNDO:
                    return True
                if not line and self._keyboard.keys:
                    return False
                if line:
                    self._say(f"'{line}' is {'neither Enter nor u' if self._keyboard.keys else _UNUSED}.")
        return False

    async def line(self, what: str) -> str:
        """Return the next line that is typed. Raises ConfigError when the input ends."""
        await self._forget_typed(what)
        return await self._line(what)

    async def _forget_typed(self, what: str) -> None:
        """Forget what was typed at a terminal before the question. Raises ConfigError when the input ended."""
        while self._keyboard.keys and self._typed.pending:
            if await self._typed.get() is None:
                await self._end(what)

    async def _line(self, what: str) -> str:
        typed = ""
        while True:
            self._tell(f"{what} > {typed}")
            key = await self._typed.get()
            if key is None:
                await self._end(what)
            elif not self._keyboard.keys:
                return key
            else:
                line, typed = edited(typed, key)
                if line is not None:
                    return line.strip()

    async def _end(self, what: str) -> NoReturn:
        """Raise ConfigError, since the input has ended; a terminal that was closed ends the recording as SIGHUP does.

        The kernel sends that signal to the terminal's own session, and its shell may pass it on later or never.
        """
        if self._keyboard.hung_up:
            self._hardware.hang_up()
            await self._hardware.sleep(0)  # in which the loop takes the request, unless the signal is ignored
        raise ConfigError(f"{what}: standard input ended before the reading was typed.")


def _reading(line: str) -> float | None:
    """Return the number in a line, with a decimal point or comma; None for no number, or a negative one."""
    try:
        value = float(line.replace(",", "."))
    except ValueError:
        return None
    return value if 0 <= value < float("inf") else None
