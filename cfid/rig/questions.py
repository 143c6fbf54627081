"""Asks the operator for readings of an instrument while motors run and everything records."""

from collections.abc import Callable
from enum import Enum
from typing import Any, Final

from twisted.internet.defer import DeferredQueue

from cfid.errors import ConfigError
from cfid.rig.keyboard import Keyboard, edited

_UNDO = ("u", "undo")


class Answer(Enum):
    """What an operator answers instead of a number."""

    UNDO = "take the last reading back"


UNDO: Final = Answer.UNDO


class Questions:
    """Asks for numbers, one after the other. At a terminal `tell` shows the typed text; a script answers in lines."""

    def __init__(self, *, loop: Any, tell: Callable[[str], None], say: Callable[[str], None]) -> None:
        """Take the functions that show questions and print messages."""
        self._tell, self._say = tell, say
        self._typed: DeferredQueue[str | None] = DeferredQueue()
        self._keyboard = Keyboard(self._typed.put, loop=loop, keys=True)

    def open(self) -> None:
        """Listen to the keyboard from now on."""
        self._keyboard.open()

    def close(self) -> None:
        """Stop listening."""
        self._keyboard.close()

    async def number(self, what: str) -> float | Answer | None:
        """Return the number typed, None for an empty line, which means no reading, UNDO for u or undo.

        Asks again after an invalid line. Raises ConfigError when the input ends, or when a script's line is invalid.
        """
        while self._keyboard.keys and self._typed.pending:  # typed before the question
            await self._typed.get()
        while True:
            line = await self._line(what)
            if not line:
                return None
            if line.lower() in _UNDO:
                return UNDO
            try:
                value = float(line.replace(",", "."))
            except ValueError:
                value = -1.0
            if 0 <= value < float("inf"):
                return value
            wrong = f"'{line}' is not a reading: type a number, nothing where there is none, u to take the last back."
            if not self._keyboard.keys:
                raise ConfigError(wrong)
            self._say(wrong)

    async def _line(self, what: str) -> str:
        typed = ""
        while True:
            self._tell(f"{what} > {typed}")
            key = await self._typed.get()
            if key is None:
                raise ConfigError(f"{what}: standard input ended before the reading was typed.")
            if not self._keyboard.keys:
                return key
            line, typed = edited(typed, key)
            if line is not None:
                return line.strip()
