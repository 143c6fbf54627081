"""What the operator types, heard by the loop while everything else goes on: whole lines, or single keys."""

import os
import sys
from collections.abc import Callable
from typing import Any

UP, DOWN = "up", "down"

_ENTER = ("\n", "\r")
_BACKSPACE = ("\x7f", "\b")
_ESCAPES = {"\x1b[A": UP, "\x1b[B": DOWN, "\x1bOA": UP, "\x1bOB": DOWN}


class Keyboard:
    """Standard input. With `keys` and on a terminal each key is heard at once, else a line at a time.

    `hear` is called with a line (without its end) or, with `keys`, with a key: a letter, `up`, `down`;
    None when the input has ended.
    """

    def __init__(self, hear: Callable[[str | None], None], *, loop: Any, keys: bool = False) -> None:
        """Take what hears; nothing is read yet."""
        self._hear, self._loop = hear, loop
        self.keys = keys and sys.stdin.isatty()
        self._restore: Callable[[], None] = lambda: None
        self._rest = ""
        self._open = False

    def open(self) -> None:
        """Begin to listen."""
        if self.keys:
            self._restore = _single_keys(sys.stdin.fileno())
        self._open = True
        self._loop.addReader(self)

    def close(self) -> None:
        """Listen no more, and leave the terminal as it was."""
        if self._open:
            self._open = False
            self._loop.removeReader(self)
            self._restore()

    def fileno(self) -> int:
        """Return what the loop waits for."""
        return sys.stdin.fileno()

    def logPrefix(self) -> str:  # noqa: N802 - Twisted's name
        """Name it to Twisted."""
        return "keyboard"

    def doRead(self) -> None:  # noqa: N802 - Twisted's name
        """Read what was typed."""
        typed = os.read(self.fileno(), 4096).decode(errors="replace")
        if not typed:
            self.close()
            self._hear(None)
            return
        if self.keys:
            for key in _split_keys(typed):
                self._hear(key)
            return
        *lines, self._rest = (self._rest + typed).split("\n")
        for line in lines:
            self._hear(line.strip())

    def connectionLost(self, reason: object) -> None:  # noqa: N802 - Twisted's name
        """Take the terminal's end as the end of the input."""
        self.close()
        self._hear(None)


def edited(typed: str, key: str) -> tuple[str | None, str]:
    """Return the line that a key completes, None while it is not, and what is typed of the next."""
    if key in _ENTER:
        return typed, ""
    if key in _BACKSPACE:
        return None, typed[:-1]
    return None, typed + key if len(key) == 1 and key.isprintable() else typed


def _split_keys(typed: str) -> list[str]:
    keys: list[str] = []
    while typed:
        length = 3 if typed[:3] in _ESCAPES else 1
        keys.append(_ESCAPES.get(typed[:length], typed[:length]))
        typed = typed[length:]
    return keys


def _single_keys(handle: int) -> Callable[[], None]:
    """Let a terminal hand over each key, and return what puts it back."""
    import termios
    import tty

    before = termios.tcgetattr(handle)
    tty.setcbreak(handle)
    return lambda: termios.tcsetattr(handle, termios.TCSADRAIN, before)
